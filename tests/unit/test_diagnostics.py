"""Consistency tests and worst cases: what they accept, what they refuse, what they find."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from tests.theory.delays import F1, H1, Q1, R1
from ufirext import DelayKalmanFilter
from ufirext.diagnostics import consistency, nees, nis, worst_case_gain
from ufirext.errors import UfirextError


def simulated(rng: np.random.Generator, steps: int, believed: float = 1.0) -> tuple[list[float], float]:
    """NIS of every step, and NEES of the last one, of a Kalman filter that believes in Q times `believed`."""
    f = DelayKalmanFilter(2, 1)
    f.F, f.H, f.Q, f.R, f.P = F1, H1, believed * Q1, R1, 10.0 * np.eye(2)
    x, values = rng.multivariate_normal(np.zeros(2), 10.0 * np.eye(2)), []
    for _ in range(steps):
        x = F1 @ x + rng.multivariate_normal(np.zeros(2), Q1)
        f.predict()
        f.update(x[:1] + rng.normal(0.0, 3.75, 1))
        values.append(nis(f.y, f.S))
    return values, nees(x - f.x.ravel(), f.P)


def test_a_filter_that_knows_its_noise_is_consistent_and_others_are_not():
    rng = np.random.default_rng(0)
    for believed, verdict in ((1.0, True), (0.1, False), (10.0, False)):
        values, _ = simulated(rng, 600, believed)
        assert consistency(values, dof=1, level=0.999).consistent is verdict


def test_independent_runs_have_chi_square_errors():
    rng = np.random.default_rng(1)
    errors = [simulated(rng, 8)[1] for _ in range(300)]
    assert consistency(errors, dof=2, level=0.999).consistent
    assert stats.kstest(errors, stats.chi2(2).cdf).pvalue > 1e-3


def test_the_interval_holds_the_mean_as_often_as_it_says():
    rng = np.random.default_rng(2)
    inside = [consistency(rng.chisquare(3, size=40), dof=3, level=0.8).consistent for _ in range(1000)]
    assert np.mean(inside) == pytest.approx(0.8, abs=5 * 0.4 / np.sqrt(1000))


def test_normalised_squares_do_not_depend_on_units():
    rng = np.random.default_rng(3)
    A = rng.normal(size=(3, 3))
    P, e, units = A @ A.T, rng.normal(size=3), np.array([1e-9, 1.0, 1e9])
    assert nees(e, P) == pytest.approx(e @ np.linalg.solve(P, e))
    assert nees(e * units, P * np.outer(units, units)) == pytest.approx(nees(e, P), rel=1e-6)


def test_missing_components_and_values_are_left_out():
    S = np.array([[4.0, 1.0], [1.0, 9.0]])
    assert nis([2.0, np.nan], S) == pytest.approx(1.0)
    assert nis(np.ma.array([2.0, 5.0], mask=[False, True]), S) == pytest.approx(1.0)
    assert np.isnan(nis([np.nan, np.nan], S))
    result = consistency([1.0, np.nan, 3.0], dof=2)
    assert (result.mean, result.count) == (2.0, 2)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: nis([1.0, 2.0], [[1.0, 1.0], [1.0, 1.0]]), "S must be positive definite to normalise y"),
        (lambda: nis([1.0], [[0.0]]), "S must be positive definite"),
        (lambda: nis([1.0], [[-1.0]]), "S must be positive semidefinite"),
        (lambda: nees([1.0, 2.0], np.eye(3)), "P must have shape"),
        (lambda: nees([np.inf], [[1.0]]), "error must be finite"),
        (lambda: consistency([], 1), "at least one number"),
        (lambda: consistency([np.nan], 1), "at least one number"),
        (lambda: consistency([1.0], 0), "dof must be at least 1"),
        (lambda: consistency([1.0], 1, level=1.0), "level must lie between 0 and 1"),
    ],
)
def test_bad_arguments_are_refused(call, message):
    with pytest.raises(UfirextError, match=message):
        call()


# -- worst cases -------------------------------------------------------------------------


def test_one_step_by_hand():
    """x_1 = x_0 + w, z = x_1 + v, x^ = K z: the error is (1 - K)(x_0 + w) - K v."""
    K = 0.25
    worst = worst_case_gain([[[K]]], [[1.0]], [[1.0]], [[4.0]], [[9.0]], [[1.0]])
    assert worst.gain == pytest.approx((1 - K) ** 2 * (1.0 + 4.0) + K**2 * 9.0)
    assert worst.errors[0, 0] ** 2 == pytest.approx(worst.gain)
    assert worst.x0[0] ** 2 / 1.0 + worst.w[0, 0] ** 2 / 4.0 + worst.v[0][0] ** 2 / 9.0 == pytest.approx(1.0)


def test_weights_and_thetas_scale_the_gain():
    plant = ([K1, K1], F1, H1, Q1, R1, np.eye(2))
    one = worst_case_gain(*plant).gain
    assert worst_case_gain(*plant, S=3.0).gain == pytest.approx(3.0 * one)
    assert worst_case_gain(*plant, theta=[0.5, 0.5]).gain == pytest.approx(0.5 * one)
    assert worst_case_gain(*plant, theta=[1.0, 0.0]).gain < one


K1 = np.array([[0.5], [0.1]])


def test_a_step_without_a_measurement_has_a_gain_without_columns():
    lost = worst_case_gain([K1, np.zeros((2, 0))], F1, H1, Q1, R1, np.eye(2))
    blind = worst_case_gain([K1, np.zeros((2, 1))], F1, H1, Q1, R1, np.eye(2))
    assert lost.gain == pytest.approx(blind.gain)
    assert lost.v[1].shape == (0,)


def test_matrices_may_change_from_step_to_step():
    Fs, Hs = [F1, 2.0 * F1], [H1, np.eye(2)]
    gains, Rs = [K1, 0.3 * np.eye(2)], [R1, np.eye(2)]
    worst = worst_case_gain(gains, Fs, Hs, [Q1, 0.0 * Q1], Rs, np.eye(2))
    x, energy = worst.x0, 0.0
    for K, F, H, w, v in zip(gains, Fs, Hs, worst.w, worst.v, strict=True):
        x = F @ x + w
        x = x - K @ (H @ x + v)
        energy += x @ x
    assert energy == pytest.approx(worst.gain)
    assert_allclose(worst.w[1], 0.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"K": []}, "at least one gain"),
        ({"K": [np.eye(3)]}, r"K\[0\] must have shape"),
        ({"F": [F1, F1]}, "F must hold one matrix for each of the 1 steps, got 2"),
        ({"R": [[-1.0]]}, "R must be positive semidefinite"),
        ({"P0": -np.eye(2)}, "P0 must be positive semidefinite"),
    ],
)
def test_plants_that_do_not_fit_are_refused(change, message):
    plant = {"K": [K1], "F": F1, "H": H1, "Q": Q1, "R": R1, "P0": np.eye(2)} | change
    with pytest.raises(UfirextError, match=message):
        worst_case_gain(**plant)
