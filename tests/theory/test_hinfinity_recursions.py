"""H-infinity filters keep their bound for every disturbance, meet it tightly, and refuse to go beyond."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tests import oracles
from tests.strategies import models, positive, random_model, seeds
from tests.theory.delays import F1, H1, Q1, R1, random_arrivals
from ufirext import Model
from ufirext.channels import TimeStamped
from ufirext.diagnostics import Guarantee, worst_case_gain
from ufirext.recursions import ThetaTooLarge, augmented_model, largest_theta, lift, tilt
from ufirext.recursions.hinfinity import robust_gain, weight_root

FORMS = st.sampled_from(("posterior", "prior"))
# A limit is a hundred runs of a filter, so fewer examples are drawn where one is needed.
few = settings(max_examples=20)


class Plant:
    """A plant with its weights over `steps` steps; H of each step, no rows where nothing comes."""

    def __init__(self, model: Model, P0, S, steps: int, Hs=None) -> None:
        self.model, self.P0, self.S, self.steps = model, P0, S, steps
        self.L = weight_root(S)
        self.Hs = [model.H] * steps if Hs is None else Hs
        self.Rs = [np.kron(np.eye(len(H) // model.dim_z), model.R) for H in self.Hs]

    def gains(self, theta: float, form: str) -> list[np.ndarray]:
        P, gains = self.P0, []
        for H, R in zip(self.Hs, self.Rs, strict=True):
            P = self.model.F @ P @ self.model.F.T + self.model.Q
            step = robust_gain(P, H, R, self.L, theta, form)
            gains.append(step.K)
            P = step.P
        return gains

    def exists(self, theta: float, form: str) -> bool:
        try:
            self.gains(theta, form)
        except ThetaTooLarge:
            return False
        return True

    def limit(self, form: str) -> float:
        """The largest theta for which the filter exists at every step, to 1e-5; 0 if there is none."""
        low, high = 1e-12, 1e6
        if self.exists(high, form):
            return 0.0
        while high / low > 1.00001:
            middle = np.sqrt(low * high)
            low, high = (middle, high) if self.exists(middle, form) else (low, middle)
        return low

    def worst(self, theta: float, form: str):
        """Of the filter for `theta`, the worst theta |e|^2 / |d|^2."""
        error = "prior" if form == "prior" else "posterior"
        return worst_case_gain(
            self.gains(theta, form),
            self.model.F,
            self.Hs,
            self.model.Q,
            self.Rs,
            self.P0,
            S=self.S,
            theta=theta,
            form=error,
        )


@st.composite
def plants(draw, steps: int = 10) -> Plant:
    model = draw(models(max_x=3, max_z=2))
    rng = np.random.default_rng(draw(seeds))
    n = model.dim_x
    plant = Plant(model, positive(rng, n), positive(rng, n, rank=draw(st.integers(1, n))), steps)
    # An error that no disturbance reaches (F = 0 and Q = 0) has no limit.
    assume(plant.limit("posterior") > 0.0)
    assume(plant.limit("prior") > 0.0)
    return plant


# -- the bound ---------------------------------------------------------------------------


@few
@given(plants(), FORMS)
def test_the_bound_holds_at_999_thousandths_of_the_limit_and_is_nearly_met(plant, form):
    gain = plant.worst(0.999 * plant.limit(form), form).gain
    assert 0.99 < gain <= 1.0 + 1e-9


@few
@given(plants(), FORMS)
def test_the_filter_refuses_to_exist_beyond_the_limit(plant, form):
    with pytest.raises(ThetaTooLarge, match="theta must be below theta_max"):
        plant.gains(1.001 * plant.limit(form), form)


@few
@given(plants(), FORMS, st.floats(0.01, 0.999))
def test_the_bound_holds_below_the_limit(plant, form, fraction):
    assert plant.worst(fraction * plant.limit(form), form).gain <= 1.0 + 1e-9


@few
@given(plants())
def test_bounding_the_prior_error_is_harder(plant):
    assert plant.limit("prior") <= plant.limit("posterior") * (1.0 + 1e-6)


@few
@given(plants())
def test_the_kalman_filter_has_a_larger_worst_case(plant):
    theta = 0.999 * plant.limit("posterior")
    kalman = plant.gains(0.0, "posterior")
    model = plant.model
    gain = worst_case_gain(
        kalman, model.F, plant.Hs, model.Q, plant.Rs, plant.P0, S=plant.S, theta=theta
    ).gain
    assert gain >= plant.worst(theta, "posterior").gain * (1.0 - 1e-6)


@few
@given(models(max_x=3, max_z=2), seeds, FORMS, st.integers(1, 3))
def test_the_bound_survives_delays_and_losses_on_the_augmented_state(model, seed, form, longest):
    rng = np.random.default_rng(seed)
    steps, n = 8, model.dim_x
    channel, big = TimeStamped(longest), augmented_model(model, longest)
    arrivals = random_arrivals(rng, steps, longest, lost=0.3)
    zeros = np.zeros(big.dim_x)
    rows = [
        [
            channel.lifted(model.H, model.R, step - a.origin, zeros, big.Q)[0]
            for a in arrivals
            if a.step == step
        ]
        for step in range(1, steps + 1)
    ]
    Hs = [np.vstack([np.zeros((0, big.dim_x)), *now]) for now in rows]
    S = np.zeros((big.dim_x, big.dim_x))
    S[:n, :n] = np.eye(n)
    P0 = lift(np.zeros(n), np.eye(n), longest + 1).P
    plant = Plant(Model(big.F, big.H, big.Q, model.R), P0, S, steps, Hs)
    limit = plant.limit(form)
    assume(limit > 0.0)
    assert 0.99 < plant.worst(0.999 * limit, form).gain <= 1.0 + 1e-9
    assert not plant.exists(1.001 * limit, form)


def test_a_late_measurement_with_an_effective_noise_breaks_the_bound():
    """Rb as a weight of its own, as in the papers: the true noises do more harm than the filter promises."""
    delay, steps, Q = 5, 6, 100.0 * Q1
    row = TimeStamped(delay).effective(Model(F1, H1, Q, R1), delay)
    Hs = [np.zeros((0, 2))] * delay + [row.H] * (steps - delay)
    plant = Plant(Model(F1, row.H, Q, row.R), np.eye(2), np.eye(2), steps, Hs)
    theta = 0.999 * plant.limit("posterior")
    assert plant.worst(theta, "posterior").gain <= 1.0
    assert _true_gain(plant, delay, theta) > 1.02


def _true_gain(plant: Plant, delay: int, theta: float) -> float:
    """theta sup |x_n - x^_n|^2 / |d|^2 of the same filter where z_n = H x_{n-delay} + v_n."""
    steps, size = plant.steps, 2 + plant.steps * 3
    states, estimate, errors = [np.eye(2, size)], np.zeros((2, size)), []
    for step, (K, Hb) in enumerate(zip(plant.gains(theta, "posterior"), plant.Hs, strict=True), start=1):
        states.append(F1 @ states[-1])
        states[-1][:, 2 * step : 2 * step + 2] += np.linalg.cholesky(plant.model.Q)
        estimate = F1 @ estimate
        if step > delay:
            z = H1 @ states[step - delay]
            z[:, 2 * steps + 1 + step] += np.sqrt(R1[0, 0])
            estimate = estimate + K @ (z - Hb @ estimate)
        errors.append(states[-1] - estimate)
    return theta * np.linalg.norm(np.vstack(errors), 2) ** 2


# -- the steps ---------------------------------------------------------------------------


@given(models(), seeds, FORMS)
def test_with_theta_zero_it_is_the_kalman_filter(model, seed, form):
    rng = np.random.default_rng(seed)
    x, P0, L = rng.normal(size=model.dim_x), positive(rng, model.dim_x), np.eye(model.dim_x)
    zs = rng.normal(size=(12, model.dim_z))
    states, covariances = oracles.book_kalman(model.F, model.H, model.Q, model.R, x, P0, list(zs))
    P = P0
    for z, expected, covariance in zip(zs, states, covariances, strict=True):
        x, P = model.F @ x, model.F @ P @ model.F.T + model.Q
        step = robust_gain(P, model.H, model.R, L, 0.0, form)
        x, P = x + step.K @ (z - model.H @ x), step.P
        size = max(1.0, np.abs(expected).max(), np.abs(covariance).max())
        assert_allclose(x, expected, atol=1e-12 * size * 100)
        assert_allclose(P, covariance, atol=1e-12 * size * 100)


def test_with_theta_zero_the_vehicle_is_tracked_as_by_the_kalman_filter_to_1e_12():
    zs = np.random.default_rng(0).normal(size=(200, 1)).cumsum(axis=0)
    states, covariances = oracles.book_kalman(F1, H1, Q1, R1, np.zeros(2), np.eye(2), list(zs))
    for form in ("posterior", "prior"):
        x, P = np.zeros(2), np.eye(2)
        for z, expected, covariance in zip(zs, states, covariances, strict=True):
            x, P = F1 @ x, F1 @ P @ F1.T + Q1
            step = robust_gain(P, H1, R1, np.eye(2), 0.0, form)
            x, P = x + step.K @ (z - H1 @ x), step.P
            assert_allclose(x, expected, rtol=1e-12, atol=1e-12)
            assert_allclose(P, covariance, rtol=1e-12)


@given(seeds, st.integers(1, 5), FORMS)
def test_the_steps_are_simons_formulas_with_all_their_inverses(seed, n, form):
    rng = np.random.default_rng(seed)
    P, S, R = positive(rng, n), positive(rng, n), positive(rng, 2)
    H, information = rng.normal(size=(2, n)), np.linalg.inv(P)
    J0 = information if form == "prior" else information + H.T @ np.linalg.inv(R) @ H
    theta = 0.7 / np.linalg.eigvals(np.linalg.solve(J0, S)).real.max()
    J = information - theta * S + H.T @ np.linalg.inv(R) @ H
    for_gain = J if form == "prior" else J + theta * S
    step = robust_gain(P, H, R, weight_root(S), theta, form)
    assert_allclose(step.P, np.linalg.inv(J), rtol=1e-7, atol=1e-9)
    assert_allclose(step.K, np.linalg.solve(for_gain, H.T @ np.linalg.inv(R)), rtol=1e-7, atol=1e-9)


@given(seeds, st.integers(1, 5), st.integers(1, 5))
def test_the_limit_is_where_the_cholesky_factorisation_stops_to_succeed(seed, n, rank):
    rng = np.random.default_rng(seed)
    P, S = positive(rng, n), positive(rng, n, rank=min(rank, n))
    J = np.linalg.inv(P)

    def factorises(theta: float) -> bool:
        try:
            np.linalg.cholesky(J - theta * S)
        except np.linalg.LinAlgError:
            return False
        return True

    low, high = 0.0, 1.0
    while factorises(high):
        high *= 2.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if factorises(middle) else (low, middle)
    assert largest_theta(P, weight_root(S)) == pytest.approx(low, rel=1e-6)


@given(seeds, st.integers(2, 5))
def test_a_singular_p_is_the_limit_of_regular_ones(seed, n):
    rng = np.random.default_rng(seed)
    P, L = positive(rng, n, rank=n - 1), weight_root(positive(rng, n, rank=n - 1))
    theta = 0.5 * largest_theta(P, L)
    regular = tilt(P + 1e-12 * np.eye(n), L, theta)
    assert_allclose(tilt(P, L, theta), regular, atol=1e-7 * max(1.0, np.abs(regular).max()))


def test_the_root_of_a_weight_reproduces_it():
    S = np.diag([4.0, 0.0, 9.0])
    L = weight_root(S)
    assert L.shape == (2, 3)
    assert_allclose(L.T @ L, S)
    assert weight_root(np.zeros((2, 2))).shape == (0, 2)
    assert largest_theta(np.eye(2), weight_root(np.zeros((2, 2)))) == np.inf


# -- the papers' pairing -----------------------------------------------------------------


def test_the_papers_pairing_diverges_between_the_two_limits():
    plant = Plant(Model(F1, H1, 0.1 * Q1, R1), np.eye(2), np.eye(2), 60)
    low, high = plant.limit("prior"), plant.limit("posterior")
    theta = 0.5 * (low + high)
    assert high > 1.05 * low
    assert plant.worst(theta, "posterior").gain <= 1.0
    assert plant.worst(theta, "mixed").gain > 10.0


def test_the_papers_pairing_takes_its_gain_from_one_filter_and_its_condition_from_the_other():
    P, theta = np.diag([2.0, 1.0]), 0.3
    mixed, prior = (robust_gain(P, H1, R1, np.eye(2), theta, form) for form in ("mixed", "prior"))
    assert_allclose(mixed.K, prior.K, rtol=1e-12)
    assert mixed.theta_max == robust_gain(P, H1, R1, np.eye(2), theta, "posterior").theta_max
    assert mixed.theta_max > prior.theta_max


# -- worst disturbances ------------------------------------------------------------------


@few
@given(plants(), FORMS)
def test_the_worst_disturbance_attains_the_bound_when_it_is_played_to_the_filter(plant, form):
    theta = 0.9 * plant.limit(form)
    worst = plant.worst(theta, form)
    model, gains = plant.model, plant.gains(theta, form)
    x, estimate, energy = worst.x0, np.zeros(model.dim_x), 0.0
    for K, w, v in zip(gains, worst.w, worst.v, strict=True):
        x, prior = model.F @ x + w, model.F @ estimate
        estimate = prior + K @ (model.H @ x + v - model.H @ prior)
        error = x - (prior if form == "prior" else estimate)
        energy += theta * error @ plant.S @ error
    assert energy == pytest.approx(worst.gain, rel=1e-6)
    inverse_Q = np.linalg.pinv(model.Q, rcond=1e-9, hermitian=True)
    spent = worst.x0 @ np.linalg.solve(plant.P0, worst.x0) + sum(w @ inverse_Q @ w for w in worst.w)
    spent += sum(v @ np.linalg.solve(model.R, v) for v in worst.v)
    assert spent == pytest.approx(1.0, rel=1e-6)


@few
@given(plants(), seeds)
def test_no_random_disturbance_does_more_harm_than_the_worst_one(plant, seed):
    rng = np.random.default_rng(seed)
    gains = plant.gains(0.0, "posterior")
    model = plant.model
    bound = worst_case_gain(gains, model.F, plant.Hs, model.Q, plant.Rs, plant.P0, S=plant.S).gain
    roots = [weight_root(M).T for M in (plant.P0, model.Q, model.R)]
    for _ in range(3):
        d = rng.normal(size=roots[0].shape[1])
        error, spent, energy = roots[0] @ d, d @ d, 0.0
        for K in gains:
            w, v = rng.normal(size=roots[1].shape[1]), rng.normal(size=roots[2].shape[1])
            error = model.F @ error + roots[1] @ w
            error = error - K @ (model.H @ error + roots[2] @ v)
            spent, energy = spent + w @ w + v @ v, energy + error @ plant.S @ error
        assert energy <= bound * spent * (1.0 + 1e-9)


# -- what is said ------------------------------------------------------------------------


def test_the_refusal_names_step_and_limit_and_survives_pickling():
    error = pickle.loads(pickle.dumps(ThetaTooLarge(0.5, 0.2, step=7)))
    assert (error.theta, error.theta_max, error.step) == (0.5, 0.2, 7)
    assert "theta_max = 0.2 at step 7" in str(error)
    assert isinstance(error, ValueError)


def test_the_guarantee_names_error_bound_and_disturbances():
    said = str(Guarantee("posterior", 20, (0.1, 0.2), 0.3, clipped=2, max_delay=3))
    for word in ("after the update", "P0^-1", "random or not", "delays up to 3", "0.1 .. 0.2", "2 steps"):
        assert word in said
    assert "before the update" in str(Guarantee("prior", 1, (0.1, 0.1), 0.3))
    mixed = Guarantee("mixed", 5, (0.1, 0.1), 0.3)
    assert not mixed.holds
    assert str(mixed).startswith("no guarantee")


def test_a_random_model_is_not_bounded_by_accident():
    """The test above would also pass for a filter that ignores theta, if theta were far below its limit."""
    plant = Plant(random_model(1, 3, 2, "unstable"), np.eye(3), np.eye(3), 14)
    theta = 0.999 * plant.limit("posterior")
    model = plant.model
    kalman = worst_case_gain(
        plant.gains(0.0, "posterior"), model.F, plant.Hs, model.Q, plant.Rs, plant.P0, S=plant.S, theta=theta
    )
    assert kalman.gain > 1.05
