"""Theorems about the unbiased FIR gain: what it is, what it is not, and what it equals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.signal import savgol_coeffs

from tests.oracles import Constant, Record, least_squares
from tests.strategies import lags, models, unobservable_models
from ufirext import Model, UnobservableWindow, kinematic, ufir_gain
from ufirext._constant import constant_covariance, constant_gain
from ufirext.gains import exact_covariance, observability_index
from ufirext.gains import least_squares as general_gain
from ufirext.window import Window, model_window

extra_rows = st.integers(0, 25)


def usable(model: Model, extra: int, lag: int, condition: float = 1e5) -> int:
    """A horizon `extra` rows above the shortest one; rejects examples double precision cannot decide."""
    nu = observability_index(model)
    assume(nu is not None)
    assume(nu <= model.dim_x)
    horizon = nu + extra
    assume(lag < horizon)
    window = model_window(model, horizon, lag)
    assume(window.determined())
    assume(window.condition < condition)
    return horizon


def rows_of(model: Model, horizon: int, zs: np.ndarray | None = None) -> list[Record]:
    zs = np.zeros((horizon, model.dim_z)) if zs is None else zs
    return [Record(i, i, model.H, model.R, zs[i]) for i in range(horizon)]


def naive(model: Model, horizon: int, lag: int) -> tuple[np.ndarray, np.ndarray]:
    constants = Constant(model.F), Constant(model.Q)
    _, K, P = least_squares(rows_of(model, horizon), *constants, horizon - 1 - lag)
    return K, P


@given(models(), extra_rows, lags)
def test_the_gain_is_unbiased(model, extra, lag):
    horizon = usable(model, extra, lag)
    K = ufir_gain(model, horizon, lag).K
    rows = np.vstack([model.H @ np.linalg.matrix_power(model.F, i) for i in range(horizon)])
    aim = np.linalg.matrix_power(model.F, horizon - 1 - lag)
    assert np.abs(K @ rows - aim).max() <= 1e-10 * (1.0 + np.abs(K).max() * np.abs(rows).max())


@given(models(), extra_rows, lags)
def test_the_gain_is_naive_least_squares_and_its_covariance_the_stacked_formula(model, extra, lag):
    horizon = usable(model, extra, lag)
    gain = ufir_gain(model, horizon, lag)
    K, P = naive(model, horizon, lag)
    np.testing.assert_allclose(gain.K, K, rtol=1e-9, atol=1e-10 * np.abs(K).max())
    np.testing.assert_allclose(gain.P, P, rtol=1e-9, atol=1e-9 * np.abs(P).max())


@given(models(), extra_rows, lags)
def test_the_noise_power_gain_is_K_times_its_transpose(model, extra, lag):
    gain = ufir_gain(model, usable(model, extra, lag), lag)
    np.testing.assert_array_equal(gain.G, gain.K @ gain.K.T)


@given(models(), extra_rows, lags)
def test_the_loop_free_path_is_the_general_path(model, extra, lag):
    horizon = usable(model, extra, lag, condition=1e3)
    K, window = constant_gain(model, horizon, lag), model_window(model, horizon, lag)
    assume(K is not None)
    scale = np.abs(general_gain(window)).max(axis=1, keepdims=True)
    assert (np.abs(K - general_gain(window)) <= 1e-12 * scale).all()
    P = constant_covariance(model, K, lag)
    assume(P is not None)
    deviation = np.sqrt(np.diag(P))
    assert (np.abs(P - exact_covariance(window, K)) <= 1e-12 * np.outer(deviation, deviation)).all()


@given(models(), extra_rows, st.integers(1, 4))
def test_without_process_noise_the_filter_is_F_to_the_lag_times_the_smoother(model, extra, lag):
    horizon = usable(model, extra, lag)
    smoother, now = ufir_gain(model, horizon, lag).K, ufir_gain(model, horizon).K
    moved = np.linalg.matrix_power(model.F, lag) @ smoother
    assert np.abs(now - moved).max() <= 1e-9 * (np.abs(moved).max() + np.abs(smoother).max())


@given(models(), extra_rows, st.integers(1, 5))
def test_a_constant_delay_shifts_the_filter_by_F_to_the_delay(model, extra, delay):
    horizon = usable(model, extra, 0)
    full = model_window(model, horizon)
    F, Q = [model.F] * (horizon - 1 + delay), [model.Q] * (horizon - 1 + delay)
    late = Window(F, Q, full.H, full.R, full.origins, horizon - 1 + delay, full.W)
    shifted = np.linalg.matrix_power(model.F, delay) @ ufir_gain(model, horizon).K
    assert np.abs(general_gain(late) - shifted).max() <= 1e-9 * max(np.abs(shifted).max(), 1e-3)


@given(models(), extra_rows, st.integers(0, 2**32 - 1))
def test_the_estimate_does_not_depend_on_units(model, extra, seed):
    """States x -> D x, measurements z -> E z, and R -> c R leave the estimate where it is."""
    horizon = usable(model, extra, 0, condition=1e4)
    rng = np.random.default_rng(seed)
    D, E = 10.0 ** rng.uniform(-4, 4, model.dim_x), 10.0 ** rng.uniform(-4, 4, model.dim_z)
    other = Model(
        model.F * np.outer(D, 1 / D),
        model.H * np.outer(E, 1 / D),
        Q=model.Q * np.outer(D, D),
        R=model.R * np.outer(E, E),
    )
    K, P = ufir_gain(model, horizon).K, ufir_gain(model, horizon).P
    units = np.tile(E, horizon)
    np.testing.assert_allclose(
        ufir_gain(other, horizon).K * units / D[:, None], K, rtol=1e-9, atol=1e-10 * np.abs(K).max()
    )
    np.testing.assert_allclose(
        ufir_gain(other, horizon).P / np.outer(D, D), P, rtol=1e-8, atol=1e-9 * np.abs(P).max()
    )
    weights = ufir_gain(model.replace(R=1e-6 * model.R), horizon).K
    np.testing.assert_allclose(weights, K, rtol=1e-9, atol=1e-10 * np.abs(K).max())


@given(models(quiet=True), extra_rows, lags, st.integers(0, 2**32 - 1))
def test_noise_free_data_give_the_exact_state_as_soon_as_the_window_determines_it(model, extra, lag, seed):
    horizon = usable(model, extra, lag, condition=1e4)
    states = [np.random.default_rng(seed).normal(size=model.dim_x)]
    for _ in range(horizon - 1):
        states.append(model.F @ states[-1])
    Z = np.concatenate([model.H @ x for x in states])
    K = ufir_gain(model, horizon, lag).K
    assert np.abs(K @ Z - states[-1 - lag]).max() <= 1e-10 * (1.0 + np.abs(K).max() * np.abs(Z).max())


@given(models(kinds=("stable", "unstable", "marginal", "oscillating")), extra_rows, st.integers(0, 2**32 - 1))
def test_batch_is_iterative(model, extra, seed):
    """The papers' iteration: G <- (H'R^-1H + (F G F')^-1)^-1, x <- F x + G H'R^-1 (z - H F x)."""
    horizon = usable(model, extra, 0, condition=1e3)
    nu = observability_index(model)
    assume(np.linalg.cond(model.F) < 1e3)
    zs = np.random.default_rng(seed).normal(size=(horizon, model.dim_z))
    weight = model.H.T @ np.linalg.inv(model.R)
    inverse = np.linalg.inv(model.F)
    information, eta = np.zeros_like(model.F), np.zeros(model.dim_x)
    for z in zs[:nu]:
        information = inverse.T @ information @ inverse + weight @ model.H
        eta = inverse.T @ eta + weight @ z
    assume(np.linalg.cond(information) < 1e6)
    x = np.linalg.solve(information, eta)
    for z in zs[nu:]:
        information = inverse.T @ information @ inverse + weight @ model.H
        x = model.F @ x + np.linalg.solve(information, weight @ (z - model.H @ model.F @ x))
    batch = ufir_gain(model, horizon).K @ zs.ravel()
    assert np.abs(batch - x).max() <= 1e-7 * (1.0 + np.abs(x).max())


@pytest.mark.parametrize("horizon", [3, 5, 20, 101])
@pytest.mark.parametrize("order", [1, 2])
def test_on_a_polynomial_ufir_is_the_savitzky_golay_end_point(order, horizon):
    if horizon == 3 and order == 2:
        horizon = 4
    dt = 0.5
    gain = ufir_gain(kinematic(order, 1, dt), horizon).K
    for derivative in range(order + 1):
        window = horizon + (horizon + 1) % 2  # scipy wants odd windows; even ones by its own formula below
        if window == horizon:
            taps = savgol_coeffs(horizon, order, deriv=derivative, delta=dt, pos=horizon - 1, use="dot")
        else:
            powers = np.vander(dt * np.arange(1 - horizon, 1), order + 1, increasing=True)
            taps = np.linalg.pinv(powers)[derivative] * (1.0 if derivative < 2 else 2.0)
        np.testing.assert_allclose(gain[derivative], taps, atol=1e-12 * np.abs(taps).max())


@pytest.mark.parametrize("horizon", [2, 3, 8, 50, 500])
def test_the_noise_power_gain_of_a_ramp_is_the_known_formula(horizon):
    G = ufir_gain(kinematic(1, 1, 1.0), horizon).G
    assert G[0, 0] == pytest.approx(2 * (2 * horizon - 1) / (horizon * (horizon + 1)), rel=1e-12)


@given(models(), st.integers(0, 20), st.integers(0, 2**32 - 1))
def test_no_other_unbiased_gain_has_less_noise(model, extra, seed):
    """With R = I: K + Y (I - C C+) is unbiased for any Y, and K is the shortest of them."""
    model = model.replace(R=1.0)
    horizon = usable(model, extra, 0)
    C = np.vstack([model.H @ np.linalg.matrix_power(model.F, i) for i in range(horizon)])
    K = ufir_gain(model, horizon).K
    Y = np.random.default_rng(seed).normal(size=K.shape)
    other = K + Y @ (np.eye(len(C)) - C @ np.linalg.pinv(C))
    assert np.trace(other @ other.T) >= np.trace(K @ K.T) * (1.0 - 1e-9)


@given(unobservable_models())
def test_an_unobservable_model_has_no_gain_at_any_horizon(model):
    assert observability_index(model) is None
    for horizon in (1, 5, 40):
        with pytest.raises(UnobservableWindow, match="no horizon determines it") as caught:
            ufir_gain(model, horizon)
        assert caught.value.shortest is None


@given(models(), st.integers(0, 4))
def test_too_short_a_window_is_refused_with_the_shortest_one_that_works(model, missing):
    nu = observability_index(model)
    assume(nu is not None)
    assume(1 + missing < nu <= model.dim_x)
    with pytest.raises(UnobservableWindow, match=f"shortest horizon that works is {nu}") as caught:
        ufir_gain(model, nu - 1 - missing)
    assert caught.value.shortest == nu


def test_a_rotation_by_pi_stays_undetermined_at_any_length():
    """Sampled at half its period, an oscillation shows one phase only: rank 1 at N = 50."""
    model = Model(-np.eye(2), [[1.0, 0.0]])
    with pytest.raises(UnobservableWindow) as caught:
        ufir_gain(model, 50)
    assert caught.value.rank == 1


def test_two_rows_of_one_instant_are_one_row():
    model = kinematic(1, 1, 1.0)
    window = Window([], [], [model.H] * 2, [model.R] * 2, [0, 0], aim=0)
    assert window.rank == 1
    assert not window.determined()


def test_four_states_need_only_two_rows_of_two_components():
    assert observability_index(kinematic(1, 2, 1.0)) == 2
    assert ufir_gain(kinematic(1, 2, 1.0), 2).K.shape == (4, 4)


def test_a_state_that_dies_need_not_be_seen():
    """F singular: the second state is never measured, but F forgets it, so one step later x is known."""
    model = Model([[0.5, 0.0], [0.3, 0.0]], [[1.0, 0.0]])
    assert observability_index(model) == 2
    x = np.array([2.0, -7.0])
    later = model.F @ x
    Z = np.array([x[0], later[0]])
    np.testing.assert_allclose(ufir_gain(model, 2).K @ Z, later, atol=1e-14)
