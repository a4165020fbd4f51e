"""Minimum-variance gains and their relatives: least squares, the Kalman filter, every other unbiased gain."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.oracles import Constant, Record, book_kalman, brute_force_covariance, stacked
from tests.strategies import models, random_model, seeds
from tests.theory.blue import diffuse_kalman, library_case, lstsq_pair
from ufirext import Model, kinematic, ufir_gain
from ufirext.errors import CovarianceError, HorizonError, UfirextError, UnobservableWindow
from ufirext.joint import joint_gain
from ufirext.minimum_variance import minimum_variance_gain
from ufirext.optimal_fir import ofir
from ufirext.window import Window, model_window

horizons = st.integers(1, 12)
lags = st.integers(0, 11)


def gain_of(model: Model, horizon: int, lag: int):
    """The gain, or no example where the window does not determine the state."""
    try:
        return minimum_variance_gain(model, horizon, min(lag, horizon - 1))
    except UnobservableWindow:
        assume(False)


def close(actual, expected, tolerance: float = 1e-9) -> None:
    np.testing.assert_allclose(actual, expected, atol=tolerance * (np.abs(expected).max(initial=0.0) + 1.0))


def regression(model: Model, horizon: int, aim: int):
    """Z = C x_old + D w + v of the oracles."""
    rows = [Record(t, t, model.H, model.R, np.zeros(model.dim_z)) for t in range(horizon)]
    return stacked(rows, Constant(model.F), Constant(model.Q), aim)


@given(models(), horizons, lags)
def test_it_is_least_squares_in_the_state_and_the_process_noise(model, horizon, lag):
    gain = gain_of(model, horizon, lag)
    K, P = lstsq_pair(library_case(model, horizon, gain.lag))
    n = model.dim_x
    close(gain.K_now, K[:n])
    close(gain.K, K[n:])
    close(gain.P_now, P[:n, :n])
    close(gain.P, P[n:, n:])
    close(gain.P_cross, P[:n, n:])


@given(models(max_x=3, max_z=2), st.integers(1, 8), lags)
def test_it_is_the_diffuse_kalman_filter_of_the_window(model, horizon, lag):
    gain = gain_of(model, horizon, lag)
    K, P = diffuse_kalman(library_case(model, horizon, gain.lag))
    close(np.vstack([gain.K_now, gain.K]), K)
    close(gain.P, P[model.dim_x :, model.dim_x :])


@given(models(), horizons, lags)
def test_it_is_unbiased_and_its_covariance_is_exact(model, horizon, lag):
    gain = gain_of(model, horizon, lag)
    window = regression(model, horizon, horizon - 1 - gain.lag)
    close(gain.K @ window.C, window.T, 1e-9 + 1e-14 * np.linalg.cond(window.C))
    close(gain.P, brute_force_covariance(window, gain.K))
    close(gain.G, gain.K @ gain.K.T)


@given(models(), horizons, lags, seeds)
def test_no_other_unbiased_gain_has_a_smaller_variance_in_any_direction(model, horizon, lag, seed):
    gain = gain_of(model, horizon, lag)
    window = regression(model, horizon, horizon - 1 - gain.lag)
    free = np.eye(len(window.C)) - window.C @ np.linalg.pinv(window.C, rcond=1e-10)
    assume(np.abs(free).max() > 1e-6)
    rng = np.random.default_rng(seed)
    other = gain.K + 10.0 ** rng.uniform(-3, 1) * rng.normal(size=gain.K.shape) @ free
    more = brute_force_covariance(window, other) - gain.P
    assert np.linalg.eigvalsh(more)[0] >= -1e-11 * (np.abs(more).max() + np.abs(gain.P).max())
    assert np.trace(more) > 0.0


@given(models(quiet=True), horizons)
def test_without_process_noise_it_is_the_unbiased_fir_gain(model, horizon):
    gain = gain_of(model, horizon, 0)
    close(gain.K, ufir_gain(model, horizon).K)


@given(models(), horizons, st.integers(1, 5))
def test_smoothing_never_loses_against_an_older_filtered_estimate(model, horizon, lag):
    gain = gain_of(model, horizon, lag)
    assume(gain.lag > 0)
    older = gain_of(model, horizon - gain.lag, 0)
    # The same oldest state and the same aim: only the newer measurements are added.
    assert np.linalg.eigvalsh(older.P - gain.P)[0] >= -1e-9 * (np.abs(older.P).max() + 1.0)


@given(seeds, st.integers(0, 5), st.integers(0, 8))
def test_noise_free_data_with_inputs_give_the_exact_states(seed, extra, lag):
    rng = np.random.default_rng(seed)
    model = random_model(seed, 3, 2, "singular").replace(B=rng.normal(size=(3, 2)))
    horizon = 5 + extra
    gain = gain_of(model, horizon, lag)
    x, us = rng.normal(size=3), rng.normal(size=(horizon - 1, 2))
    states = [x]
    for u in us:
        states.append(model.F @ states[-1] + model.B @ u)
    Z = np.concatenate([model.H @ state for state in states])
    close(gain.K @ Z + gain.L @ us.ravel(), states[horizon - 1 - gain.lag], 1e-10)
    close(gain.K_now @ Z + gain.L_now @ us.ravel(), states[-1], 1e-10)


def test_time_varying_windows_with_holes_and_rows_of_several_sizes():
    rng = np.random.default_rng(11)
    F = [rng.normal(size=(3, 3)) for _ in range(6)]
    Q = [0.1 * np.diag(rng.uniform(0, 1, 3)) for _ in range(6)]
    origins = [0, 0, 1, 3, 3, 5]
    H = [rng.normal(size=(m, 3)) for m in (1, 2, 1, 2, 1, 1)]
    R = [np.diag(rng.uniform(0.1, 2, len(h))) for h in H]
    rows = [Record(o, o, h, r, np.zeros(len(h))) for o, h, r in zip(origins, H, R, strict=True)]
    transitions, noises = dict(enumerate(F, 1)), dict(enumerate(Q, 1))
    transitions[0] = np.eye(3)
    for aim in range(7):
        joint = joint_gain(Window(F, Q, H, R, origins, aim))
        window = stacked(rows, transitions, noises, aim)
        D, E = window.D, window.E
        size = max(D.shape[1], E.shape[1])
        Qs = np.kron(np.eye(size // 3), np.zeros((3, 3)))
        for j in range(size // 3):
            Qs[3 * j : 3 * j + 3, 3 * j : 3 * j + 3] = Q[j]
        D, E = (np.pad(a, ((0, 0), (0, size - a.shape[1]))) for a in (D, E))
        S = D @ Qs @ D.T + window.V
        J = E @ Qs @ D.T @ np.linalg.inv(S)
        left = np.linalg.solve(window.C.T @ np.linalg.solve(S, window.C), np.linalg.solve(S, window.C).T)
        close(joint.K[3:], J + (window.T - J @ window.C) @ left)


class TestOptimalFIR:
    model = kinematic(1, 1, 1.0, q=0.3, r=2.0)

    def history(self, steps: int = 30):
        rng = np.random.default_rng(5)
        zs = rng.normal(size=(steps, 1)) * 3
        x0, P0 = np.array([1.0, -2.0]), np.diag([9.0, 4.0])
        return zs, *book_kalman(self.model.F, self.model.H, self.model.Q, self.model.R, x0, P0, zs)

    @pytest.mark.parametrize("horizon", [1, 2, 8, 20])
    def test_rho_one_is_the_kalman_filter(self, horizon):
        zs, states, covariances = self.history()
        before = len(zs) - horizon - 1
        F, Q = self.model.F, self.model.Q
        gain = ofir(self.model, horizon, F @ covariances[before] @ F.T + Q)
        np.testing.assert_allclose(gain.estimate(zs[-horizon:], F @ states[before]), states[-1], rtol=1e-12)
        np.testing.assert_allclose(gain.P, covariances[-1], rtol=1e-12)

    def test_rho_infinite_is_the_minimum_variance_unbiased_gain_and_the_way_there_is_linear(self):
        limit = minimum_variance_gain(self.model, 8, lag=2)
        assert np.array_equal(ofir(self.model, 8, 5.0, rho=math.inf, lag=2).K, limit.K)
        gaps = [np.abs(ofir(self.model, 8, 5.0, rho=rho, lag=2).K - limit.K).max() for rho in (1e3, 1e5, 1e7)]
        np.testing.assert_allclose(np.divide(gaps[:-1], gaps[1:]), 100, rtol=0.02)
        np.testing.assert_allclose(ofir(self.model, 8, 5.0, rho=1e12, lag=2).K, limit.K, atol=1e-10)

    @given(models(), horizons, lags, st.floats(0.01, 100.0))
    def test_it_is_unbiased_if_the_prior_mean_is(self, model, horizon, lag, rho):
        lag = min(lag, horizon - 1)
        gain = ofir(model, horizon, 1.0, rho=rho, lag=lag)
        window = regression(model, horizon, horizon - 1 - lag)
        close(gain.K @ window.C + gain.prior, window.T)
        left = window.T - gain.K @ window.C
        close(gain.P, brute_force_covariance(window, gain.K) + rho * left @ left.T)

    def test_inputs(self):
        model = self.model.replace(B=[0.5, 1.0])
        gain = ofir(model, 3, 0.0)
        us, x = np.array([[1.0], [2.0]]), np.array([3.0, 1.0])
        states = [x]
        for u in us:
            states.append(model.F @ states[-1] + model.B @ u)
        np.testing.assert_allclose(gain.estimate(np.array(states)[:, :1], x, us), states[-1], rtol=1e-14)

    def test_what_rho_and_P_must_be(self):
        with pytest.raises(UfirextError, match="rho must be a factor"):
            ofir(self.model, 5, 1.0, rho=-1.0)
        with pytest.raises(UfirextError, match="rho must be a factor"):
            ofir(self.model, 5, 1.0, rho=math.nan)
        with pytest.raises(CovarianceError, match="P must be positive semidefinite"):
            ofir(self.model, 5, -1.0)


class TestErrors:
    def test_horizon_and_lag(self):
        for horizon, lag in [(0, 0), (5, 5), (5, -1), (5.0, 0)]:
            with pytest.raises(HorizonError, match="must be"):
                minimum_variance_gain(kinematic(1, 1, 1.0), horizon, lag)

    def test_singular_r(self):
        with pytest.raises(CovarianceError, match="add the variance of the sensor's resolution"):
            minimum_variance_gain(kinematic(1, 2, 1.0, r=0.0), 5)

    def test_short_windows_name_the_shortest_that_works(self):
        with pytest.raises(UnobservableWindow, match="shortest horizon that works is 3") as caught:
            minimum_variance_gain(kinematic(2, 1, 1.0), 2)
        assert (caught.value.rank, caught.value.shortest) == (2, 3)

    def test_general_windows(self):
        window = model_window(Model(np.eye(2), [[1, 0]]), 4)
        with pytest.raises(UnobservableWindow, match="they have rank 1"):
            joint_gain(window)

    def test_gains_are_read_only(self):
        gain = minimum_variance_gain(kinematic(1, 1, 1.0), 5)
        for array in (gain.K, gain.P, gain.G, gain.K_now, gain.P_now, gain.P_cross, gain.L):
            assert not array.flags.writeable
