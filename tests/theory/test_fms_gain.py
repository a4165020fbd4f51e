"""The FMS filter-smoother's gain: printed numbers, two oracles, the places where formula (14) fails."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.strategies import models, seeds
from tests.theory.blue import diffuse_kalman, lstsq_pair, paper_case, row_error
from ufirext.errors import CovarianceError, HorizonError, ShapeError, UfirextError, UnobservableWindow
from ufirext.fms import fms_gain
from ufirext.joint import InaccurateGainWarning

# The tracking model of Kim (2019), section 3: T = 2, G, Q, R as printed there.
A = np.array([[1.0, 2.0, 2.0], [0.0, 1.0, 2.0], [0.0, 0.0, 1.0]])
C = np.array([[1.0, 0.0, 0.0]])
G = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
QW = np.diag([0.173**2, 0.01**2])
Q = G @ QW @ G.T
R = np.array([[0.05**2]])


def tracking(M: int = 15, d: int = 5):
    return fms_gain(A, C, QW, R, M, d, G=G)


def unstable(rho: float) -> np.ndarray:
    F = np.array([[0.9, 0.4, 0.1], [-0.3, 1.0, 0.2], [0.1, -0.2, 0.6]])
    return F * rho / np.abs(np.linalg.eigvals(F)).max()


def papers_formula(M: int, d: int) -> np.ndarray:
    """H* of equation (14) for the tracking model, with pseudo-inverses where there is no inverse."""
    inverse = np.linalg.inv(A)
    back = [np.linalg.matrix_power(inverse, k) for k in range(M + 1)]
    Gamma = np.vstack([C @ back[M - k] for k in range(M)])
    noise = np.zeros((M + 3, 2 * M))
    for j in range(M):
        for k in range(j + 1):
            noise[k, 2 * j : 2 * j + 2] = -(C @ back[j - k + 1] @ G)[0]
        if j >= M - d:
            noise[M:, 2 * j : 2 * j + 2] = -back[j - (M - d) + 1] @ G
    noise = noise @ np.kron(np.eye(M), np.sqrt(QW))
    Pi = noise @ noise.T
    Pi[:M, :M] += R * np.eye(M)
    bar = np.block([[Gamma, np.zeros((M, 3))], [back[d], -np.eye(3)]])
    weighted = np.linalg.pinv(Pi, rcond=1e-13, hermitian=True) @ bar
    return (np.linalg.pinv(bar.T @ weighted, rcond=1e-13, hermitian=True) @ weighted.T)[:, :M]


class TestGoldenNumbers:
    def test_tracking_model_covariance(self):
        P = tracking().P
        printed = [
            0.07607823123,
            0.04302728068,
            0.001119247443,
            0.001703781504,
            0.002952469335,
            0.000725784407,
        ]
        np.testing.assert_allclose(np.diag(P), printed, rtol=5e-10)
        assert np.trace(P) == pytest.approx(0.125606794599, rel=5e-12)
        assert P[0, 3] == pytest.approx(-4.519e-7, rel=1e-4)
        assert P[2, 5] == pytest.approx(6.780671458e-4, rel=2e-10)

    def test_tracking_model_gain(self):
        H = tracking().H
        np.testing.assert_allclose(H[0, -3:], [0.4044554486291, -1.761595516387, 2.397575716514], rtol=1e-12)
        printed = [-0.08952639074485, 0.2337957283604, 0.6815126014478, 0.2337959896058]
        np.testing.assert_allclose(H[3, 8:12], printed, rtol=1e-12)

    def test_scalar_random_walk(self):
        gain = fms_gain(1, 1, 1, 1, M=2, d=1, G=1)
        np.testing.assert_allclose(gain.H, [[1 / 3, 2 / 3], [1 / 3, 2 / 3]], atol=1e-15)
        np.testing.assert_allclose(gain.P, [[5 / 3, 2 / 3], [2 / 3, 2 / 3]], atol=1e-15)
        np.testing.assert_allclose(fms_gain(1, 1, 1, 1, M=2, d=2).H[1], [2 / 3, 1 / 3], atol=1e-15)

    @pytest.mark.parametrize("M", [1, 4, 9])
    def test_without_process_noise_a_constant_is_averaged(self, M):
        gain = fms_gain(1, 1, 0, 1, M=M, d=1)
        np.testing.assert_allclose(gain.H, np.full((2, M), 1 / M), atol=1e-15)
        np.testing.assert_allclose(gain.P, np.full((2, 2), 1 / M), atol=1e-15)

    def test_a_deadbeat_window_interpolates(self):
        H = tracking(M=3, d=1).H
        np.testing.assert_allclose(H[0], [1, -3, 3], atol=1e-13)
        np.testing.assert_allclose(H[3], [0, 0, 1], atol=1e-13)

    def test_bias_after_a_unit_step_of_acceleration_dies_within_the_window(self):
        gain, x, window, bias = tracking(), np.zeros(3), np.zeros(15), []
        for i in range(40):
            bias.append(x[0] - gain.estimate(window)[0][0])
            window = np.append(window[1:], C @ x)
            x = A @ x + (np.array([0.0, 0.0, 1.0]) if i == 0 else 0.0)
        step = bias[1:]
        np.testing.assert_allclose(step[:5], [0, 2, 3.205, 2.343, 2.127], atol=5e-4)
        np.testing.assert_allclose(step[15:], 0, atol=1e-9)


class TestAccuracy:
    """The recursive design against 150 and more digits; the bounds are ten times what was measured."""

    @pytest.mark.parametrize(
        ("case", "bound"),
        [
            pytest.param((A, C, Q, R, 15, 5), 7e-14, id="the paper's model"),
            pytest.param((A, C, Q, R, 15, 0), 5e-14, id="d = 0, where Pi is singular"),
            pytest.param((A, C, Q, R, 15, 15), 2e-13, id="d = M"),
            pytest.param((A, C, Q, R * 1e-12, 200, 5), 9e-13, id="M = 200, almost exact measurements"),
            pytest.param((unstable(1.3), C, np.eye(3) * 0.1, R, 100, 5), 2e-14, id="unstable"),
            pytest.param((unstable(2.0), C, np.eye(3) * 0.1, R, 60, 60), 2e-13, id="very unstable, d = M"),
            pytest.param((unstable(1.3), C, np.zeros((3, 3)), R, 60, 30), 2e-13, id="unstable, no noise"),
        ],
    )
    def test_gain_and_covariance_against_extended_precision(self, case, bound):
        M = case[4]
        K, P = diffuse_kalman(paper_case(*case), digits=120 + M, log_kappa=40 + M // 2)
        gain = fms_gain(*case)
        assert row_error(gain.H, K) < bound
        np.testing.assert_allclose(np.diag(gain.P), np.diag(P), rtol=10 * bound)
        scale = np.sqrt(np.diag(P))
        assert np.abs((gain.P - P) / np.outer(scale, scale)).max() < 1e-9

    def test_doubles_that_do_not_suffice_are_said_aloud(self):
        twins = np.diag([0.9, 0.9 + 3e-9, 0.5])
        with pytest.warns(InaccurateGainWarning, match="nearly unobservable"):
            fms_gain(twins, [[1, 1, 1]], np.eye(3), 1, M=40, d=5)


class TestAgainstOracles:
    @given(models(), st.integers(0, 12), st.integers(0, 12))
    def test_any_model_agrees_with_least_squares_in_state_and_noise(self, model, M, d):
        M, d = max(M, d, 1), min(M, d)
        try:
            gain = fms_gain(model.F, model.H, model.Q, model.R, M, d)
        except UnobservableWindow:
            assume(False)
        K, P = lstsq_pair(paper_case(model.F, model.H, model.Q, model.R, M, d))
        scale = np.abs(K).max() + 1.0
        np.testing.assert_allclose(gain.H, K, atol=1e-9 * scale)
        np.testing.assert_allclose(gain.P, P, atol=1e-9 * (np.abs(P).max() + 1.0))

    @given(models(max_x=3), st.integers(1, 9), st.integers(0, 9))
    def test_any_model_agrees_with_a_diffuse_kalman_filter_in_extended_precision(self, model, M, d):
        d = min(M, d)
        try:
            gain = fms_gain(model.F, model.H, model.Q, model.R, M, d)
        except UnobservableWindow:
            assume(False)
        K, P = diffuse_kalman(paper_case(model.F, model.H, model.Q, model.R, M, d))
        np.testing.assert_allclose(gain.H, K, atol=1e-9 * (np.abs(K).max() + 1.0))
        np.testing.assert_allclose(gain.P, P, atol=1e-9 * (np.abs(P).max() + 1.0))

    def test_filterpys_kalman_filter_and_rts_smoother_from_a_diffuse_start(self):
        from filterpy.kalman import KalmanFilter

        rng, M, d = np.random.default_rng(3), 15, 5
        zs = rng.normal(size=M)
        kf = KalmanFilter(dim_x=3, dim_z=1)
        kf.F, kf.H, kf.Q, kf.R, kf.P = A, C, Q, R, np.eye(3) * 1e6
        means, covs, means_prior, _ = kf.batch_filter(zs, update_first=True)
        smooth = kf.rts_smoother(means, covs)
        x, lagged = tracking(M, d).estimate(zs)
        np.testing.assert_allclose(x, means_prior[-1].ravel(), rtol=1e-5)
        np.testing.assert_allclose(lagged, smooth[0][M - d].ravel(), rtol=1e-5)
        np.testing.assert_allclose(tracking(M, d).P[3:, 3:], smooth[1][M - d], rtol=1e-5)

    def test_the_papers_formula_where_its_conditions_hold(self):
        np.testing.assert_allclose(tracking().H, papers_formula(15, 5), atol=1e-9)

    @pytest.mark.parametrize("d", [0, 1])
    def test_the_papers_formula_is_wrong_where_they_do_not(self, d):
        # Up to one lag two noises drive three states: Pi is singular.
        literal, right = papers_formula(15, d), tracking(d=d).H
        assert np.linalg.norm(literal - right) > 0.3 * np.linalg.norm(right)


class TestProperties:
    @given(seeds, st.integers(0, 6), st.integers(0, 6))
    def test_noise_free_data_with_inputs_give_the_exact_states(self, seed, extra, d):
        rng = np.random.default_rng(seed)
        n, M = 3, 6 + extra
        F = rng.normal(size=(n, n)) / 2.0
        F[:, 0] *= rng.integers(0, 2)
        B = rng.normal(size=(n, 2))
        H = rng.normal(size=(2, n))
        gain = fms_gain(F, H, np.eye(n), np.eye(2), M, d, B=B)
        x, states, us = rng.normal(size=n), [], rng.normal(size=(M, 2))
        for u in us:
            states.append(x)
            x = F @ x + B @ u
        states.append(x)
        now, lagged = gain.estimate(np.array(states[:M]) @ H.T, us)
        np.testing.assert_allclose(now, states[M], atol=1e-10)
        np.testing.assert_allclose(lagged, states[M - d], atol=1e-10)

    def test_the_current_estimate_does_not_depend_on_the_lag(self):
        rows = [tracking(d=d).H[:3] for d in (0, 1, 5, 15)]
        for other in rows[1:]:
            np.testing.assert_allclose(other, rows[0], rtol=1e-12, atol=1e-13)

    @pytest.mark.parametrize("lag", [0, 1, 4, 14])
    def test_the_predictor_form_is_one_transition_after_the_librarys(self, lag):
        from ufirext.minimum_variance import minimum_variance_gain
        from ufirext.model import Model

        paper = tracking(d=lag + 1)
        ours = minimum_variance_gain(Model(A, C, Q, R), 15, lag)
        np.testing.assert_allclose(paper.H[:3], A @ ours.K_now, atol=1e-12)
        np.testing.assert_allclose(paper.H[3:], ours.K, atol=1e-12)
        np.testing.assert_allclose(paper.P[:3, :3], A @ ours.P_now @ A.T + Q, atol=1e-14)
        np.testing.assert_allclose(paper.P[3:, 3:], ours.P, atol=1e-14)
        np.testing.assert_allclose(paper.P[:3, 3:], A @ ours.P_cross, atol=1e-14)

    def test_units_do_not_matter(self):
        S = np.diag([1e3, 1e-6, 2.0])
        scaled = fms_gain(S @ A @ np.linalg.inv(S), C @ np.linalg.inv(S), S @ Q @ S, R, 15, 5)
        both = np.kron(np.eye(2), S)
        expected = both @ tracking().H
        assert row_error(scaled.H, expected) < 1e-11


class TestErrors:
    @pytest.mark.parametrize(("M", "d"), [(15, -1), (15, 16), (0, 0), (2.5, 1), (15, True)])
    def test_a_lag_or_length_out_of_range(self, M, d):
        with pytest.raises(HorizonError, match="must be"):
            tracking(M, d)

    def test_noise_that_is_no_covariance(self):
        with pytest.raises(CovarianceError, match="Q must be positive semidefinite"):
            fms_gain(A, C, np.diag([1.0, -1.0, 1.0]), R, 15, 5)
        with pytest.raises(CovarianceError, match="R must be positive semidefinite"):
            fms_gain(A, C, Q, -1.0, 15, 5)
        with pytest.raises(CovarianceError, match="R must be positive definite"):
            fms_gain(A, np.eye(3), Q, np.diag([1.0, 0.0, 1.0]), 15, 5)

    def test_matrices_that_do_not_fit(self):
        with pytest.raises(ShapeError, match=r"C must have shape \(any, 3\)"):
            fms_gain(A, np.eye(2), Q, R, 15, 5)
        with pytest.raises(ShapeError, match=r"Q must have shape \(2, 2\)"):
            fms_gain(A, C, Q, R, 15, 5, G=G)

    @pytest.mark.parametrize(("M", "rank"), [(1, 1), (2, 2)])
    def test_a_short_window_names_the_shortest_that_works(self, M, rank):
        with pytest.raises(UnobservableWindow) as caught:
            fms_gain(A, C, Q, R, M, 0)
        assert caught.value.rank == rank
        assert caught.value.shortest == 3
        assert "the shortest M that works is 3" in str(caught.value)
        with pytest.raises(UnobservableWindow) as caught:
            fms_gain(A, C, Q, R, 2, 2)
        assert caught.value.shortest == 3

    def test_a_state_that_no_window_shows(self):
        with pytest.raises(UnobservableWindow, match="no M does") as caught:
            fms_gain(np.eye(2), [[1, 0]], np.eye(2), 1, 200, 5)
        assert caught.value.shortest is None
        assert caught.value.rank == 1

    def test_a_long_window_of_a_mixed_model_is_no_false_alarm(self):
        mixed = np.array([[1.2, 1.0, 0.0], [0.0, 0.5, 1.0], [0.0, 0.0, 0.3]])
        assert np.isfinite(fms_gain(mixed, C, np.eye(3), 1, 200, 100).H).all()

    def test_an_unseen_state_that_is_forgotten_does_not_matter(self):
        forgets = np.array([[0.9, 0.0], [0.0, 0.0]])
        gain = fms_gain(forgets, [[1, 0]], np.diag([1.0, 2.0]), 1, M=4, d=2)
        np.testing.assert_allclose(gain.H[[1, 3]], 0, atol=1e-15)
        assert gain.P[1, 1] == pytest.approx(2.0)
        with pytest.raises(UnobservableWindow):
            fms_gain(forgets, [[1, 0]], np.diag([1.0, 2.0]), 1, M=4, d=4)

    def test_inputs_are_neither_forgotten_nor_invented(self):
        forced = fms_gain(A, C, Q, R, 15, 5, B=[0, 0, 1])
        with pytest.raises(UfirextError, match="U must hold the 15 inputs"):
            forced.estimate(np.zeros(15))
        with pytest.raises(UfirextError, match="designed without B"):
            tracking().estimate(np.zeros(15), np.zeros(15))
        with pytest.raises(ShapeError, match="Z must hold 15 rows of 1"):
            forced.estimate(np.zeros(14), np.zeros(15))

    def test_repr_tells_what_it_is(self):
        assert repr(tracking()) == (
            "FMSGain(M=15, d=5, n=3, q=1): x_i with trace P = 0.120225 and x_{i-5} with trace P = 0.00538204"
        )
