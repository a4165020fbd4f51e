"""The covariance of an unbiased estimate is exact: by algebra, by simulation, by two hundred digits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.oracles import Constant, Record, brute_force_covariance, least_squares, naive_gain, stacked
from tests.strategies import random_model, transition
from tests.theory.digits import reference
from ufirext import Model, kinematic, ufir_gain
from ufirext.gains import exact_covariance
from ufirext.gains import least_squares as general_gain
from ufirext.window import Window

# One axis of the vehicle of the time-stamped-delay paper: tau = 1 s, sigma_w = 2 m/s, sigma_v = 3.75 m.
F = np.array([[1.0, 1.0], [0.0, 1.0]])
Q = 4.0 * np.array([[0.5, 0.5], [0.5, 1.0]])
H = np.array([[1.0, 0.0]])
R = np.array([[3.75**2]])


def late_window(horizon: int, delay: int) -> Window:
    """A row at each of `horizon` steps, aimed `delay` steps after the newest."""
    steps = horizon - 1 + delay
    rows = range(horizon)
    return Window([F] * steps, [Q] * steps, [H for _ in rows], [R for _ in rows], rows, aim=steps)


def white_noise_recursion(horizon: int, delay: int) -> np.ndarray:
    """The published recursion, which takes the noise that the delay brings for white and fresh."""
    back = H @ np.linalg.matrix_power(F, -delay)
    powers = [np.linalg.matrix_power(F, i) for i in range(delay)]
    noise = R + back @ sum((A @ Q @ A.T for A in powers), start=np.zeros((2, 2))) @ back.T
    records = [Record(i, i, back, noise, np.zeros(1)) for i in range(2)]
    start = stacked(records, Constant(F), Constant(Q), 1)
    rows = np.vstack([back @ np.linalg.inv(F), back])
    G = np.linalg.inv(rows.T @ rows)
    P = brute_force_covariance(start, naive_gain(start))
    for _ in range(2, horizon):
        G = np.linalg.inv(back.T @ back + np.linalg.inv(F @ G @ F.T))
        left = np.eye(2) - G @ back.T @ back
        P = left @ (F @ P @ F.T + Q) @ left.T + G @ back.T @ noise @ back @ G
    return P


def test_at_delay_three_the_variance_is_the_golden_one_and_not_the_published_one():
    window = late_window(8, 3)
    P = exact_covariance(window, general_gain(window))
    assert P[0, 0] == pytest.approx(203.24075255, rel=1e-9)
    assert white_noise_recursion(8, 3)[0, 0] > 1.8 * P[0, 0]


def test_without_delay_the_published_recursion_is_exact():
    window = late_window(8, 0)
    P = exact_covariance(window, general_gain(window))
    np.testing.assert_allclose(white_noise_recursion(8, 0), P, rtol=1e-10)


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_the_covariance_is_that_of_simulated_errors(delay):
    """Entries of the sample covariance lie within 5 standard errors of the exact ones."""
    runs, horizon, rng = 40_000, 8, np.random.default_rng(delay)
    window = late_window(horizon, delay)
    K = general_gain(window)
    root = np.linalg.cholesky(Q)
    x = rng.normal(size=(runs, 2)) * 1e3  # unbiased: where the state starts does not matter
    Z = np.empty((runs, horizon))
    for step in range(horizon + delay):
        if step:
            x = x @ F.T + rng.normal(size=(runs, 2)) @ root.T
        if step < horizon:
            Z[:, step] = x[:, 0] + 3.75 * rng.normal(size=runs)
    errors = Z @ K.T - x
    P = exact_covariance(window, K)
    sample = errors.T @ errors / runs
    standard_error = np.sqrt((np.outer(np.diag(P), np.diag(P)) + P**2) / runs)
    assert (np.abs(sample - P) <= 5 * standard_error).all()
    if delay:
        wrong = white_noise_recursion(horizon, delay)
        assert (np.abs(sample - wrong) > 5 * standard_error).any()


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from(["stable", "unstable", "marginal", "singular"]),
    st.integers(0, 3),
    st.integers(0, 3),
)
def test_random_rows_with_delays_and_holes_have_the_stacked_covariance(seed, kind, ahead, lag):
    """Time-varying F, Q, H, R; several rows of one instant, instants without rows; any aim."""
    rng = np.random.default_rng(seed)
    n, steps = int(rng.integers(1, 4)), int(rng.integers(4, 12))
    Fs = {j: transition(rng, n, kind) for j in range(steps + ahead + 1)}
    Qs = {j: random_model(int(rng.integers(2**31)), n, 1, kind).Q for j in Fs}
    origins = np.sort(np.r_[0, rng.integers(0, steps + 1, size=steps + n)])
    records = []
    for origin in origins.tolist():
        part = random_model(int(rng.integers(2**31)), n, int(rng.integers(1, n + 1)), kind)
        records.append(Record(origin, origin, part.H, part.R, rng.normal(size=part.dim_z)))
    aim = max(0, max(origins.tolist()) + ahead - lag)
    window = Window(
        [Fs[j] for j in range(1, max(aim, origins[-1]) + 1)],
        [Qs[j] for j in range(1, max(aim, origins[-1]) + 1)],
        [r.H for r in records],
        [r.R for r in records],
        origins.tolist(),
        aim,
    )
    assume(window.determined())
    assume(window.condition < 1e5)
    x, K, P = least_squares(records, Fs, Qs, aim)
    gain = general_gain(window)
    np.testing.assert_allclose(gain, K, rtol=1e-8, atol=1e-9 * max(np.abs(K).max(), 1e-6))
    np.testing.assert_allclose(gain @ np.concatenate([r.z for r in records]), x, rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(
        exact_covariance(window, gain), P, rtol=1e-8, atol=1e-9 * max(np.abs(P).max(), 1e-6)
    )


def rotation(angle: float, radius: float) -> np.ndarray:
    return radius * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def mixed(eigenvalues: tuple[float, ...]) -> Model:
    """Every state and the measurement see every mode."""
    basis = np.random.default_rng(1).normal(size=(len(eigenvalues), len(eigenvalues)))
    A = basis @ np.diag(eigenvalues) @ np.linalg.inv(basis)
    return Model(A, np.ones((1, len(eigenvalues))), Q=0.1)


WELL_POSED = {
    "constant velocity": (kinematic(1, 1, 1.0, q=1e-3), 500),
    "constant acceleration": (kinematic(2, 1, 1.0, q=1e-6), 500),
    "constant acceleration, 100 Hz": (kinematic(2, 1, 0.01), 500),
    "damped": (Model([[1, 1], [0, 0.95]], [[1, 0]], Q=np.diag([0, 0.01])), 500),
    "damped, mixed": (mixed((0.9, 0.8, 0.99)), 500),
    "oscillating": (Model(rotation(0.3, 1.0), [[1, 0]], Q=0.01), 500),
    "oscillating, damped": (Model(rotation(0.3, 0.99), [[1, 0]], Q=0.01), 500),
    "one unstable mode": (Model([[1.05, 0.1], [0, 0.9]], [[1, 0]], Q=0.01), 500),
    "one unstable mode, mixed": (mixed((1.05, 0.9, 1.0)), 500),
    "unstable, rho 1.3": (mixed((1.3, 0.9, 0.5)), 60),
    "unstable, rho 1.3, long": (mixed((1.3, 1.0, 0.99)), 200),
}


@pytest.mark.parametrize("lag", [0, 5])
@pytest.mark.parametrize("name", WELL_POSED)
def test_gains_and_covariances_have_twelve_digits(name, lag):
    """Against 200 digits, relative to each row of the gain and to the standard deviations."""
    model, horizon = WELL_POSED[name]
    gain, (K, P) = ufir_gain(model, horizon, lag), reference(model, horizon, lag)
    assert (np.abs(gain.K - K).max(axis=1) <= 1e-12 * np.abs(K).max(axis=1)).all()
    deviation = np.sqrt(np.diag(P))
    assert np.abs((gain.P - P) / np.outer(deviation, deviation)).max() <= 1e-12


@pytest.mark.parametrize("lag", [0, 2])
def test_powers_that_overflow_do_not_spoil_the_gain(lag):
    """F^N leaves the range of floating point at N = 442; the filter of 500 rows is still an ordinary one."""
    model = Model([[5.0, 1.0], [0.0, 0.9]], [[1.0, 0.0]], Q=0.1)
    long, short = ufir_gain(model, 500, lag), ufir_gain(model, 200, lag)
    np.testing.assert_allclose(long.K[:, -8:], short.K[:, -8:], rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(long.P, short.P, rtol=1e-9)


def test_a_delay_augmented_plant_has_the_covariance_of_the_stacked_formula():
    """State [x; x one step ago; x two steps ago] with the oldest measured: F is singular."""
    chain = np.zeros((4, 4))
    chain[:2, :2], chain[2, 0], chain[3, 2] = F, 1.0, 1.0
    noise = np.zeros((4, 4))
    noise[:2, :2] = Q
    model = Model(chain, [[0.0, 0.0, 0.0, 1.0]], Q=noise, R=R)
    for lag in (0, 2):
        gain = ufir_gain(model, 12, lag)
        records = [Record(i, i, model.H, model.R, np.zeros(1)) for i in range(12)]
        _, K, P = least_squares(records, Constant(chain), Constant(noise), 11 - lag)
        np.testing.assert_allclose(gain.K, K, atol=1e-12)
        np.testing.assert_allclose(gain.P, P, rtol=1e-10, atol=1e-10)
