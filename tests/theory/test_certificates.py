"""Certificates accept optimal gains, refuse everything else, and never hide a solver."""

from __future__ import annotations

from dataclasses import replace

import cvxpy
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tests.strategies import models
from tests.theory.test_fms_gain import papers_formula, tracking, unstable
from ufirext import Model, kinematic, ufir_gain
from ufirext.certificates import UnconfirmedWarning, certify
from ufirext.errors import CovarianceError, ShapeError, UfirextError, UnobservableWindow
from ufirext.gains import Gain
from ufirext.minimum_variance import minimum_variance_gain

MODEL = kinematic(1, 2, 0.5, q=0.3, r=2.0)


class TestAcceptance:
    @pytest.mark.parametrize(("M", "d"), [(15, 5), (15, 0), (15, 1), (15, 15), (3, 1), (30, 1)])
    def test_the_fms_gain_is_optimal_by_both_problems(self, M, d):
        certificate = certify(tracking(M, d))
        assert certificate.optimal
        assert certificate.confirmed
        assert (certificate.status, certificate.literal_status) == ("optimal", "optimal")
        assert certificate.gain_difference < 1e-11
        assert certificate.literal_difference < 1e-7
        assert certificate.value == pytest.approx(np.trace(tracking(M, d).P), rel=1e-12)
        np.testing.assert_allclose(certificate.dual, certificate.primal, rtol=1e-10)

    @settings(max_examples=15)
    @given(models(max_x=4, max_z=2), st.integers(1, 8), st.integers(0, 7))
    def test_any_minimum_variance_gain_is_optimal(self, model, horizon, lag):
        try:
            gain = minimum_variance_gain(model, horizon, min(lag, horizon - 1))
        except UnobservableWindow:
            assume(False)
        certificate = certify(gain, model)
        assert certificate.optimal
        assert certificate.gain_difference < 1e-7

    @pytest.mark.parametrize("lag", [0, 3])
    def test_the_unbiased_fir_gain_has_the_least_norm(self, lag):
        gain = ufir_gain(MODEL, 9, lag)
        certificate = certify(gain, MODEL)
        assert certificate.confirmed
        assert certificate.criterion == "noise"
        # R = 2 I: the noise of the estimate is 2 |K|^2.
        assert certificate.optimum == pytest.approx(2.0 * np.linalg.norm(gain.K) ** 2, rel=1e-10)
        assert not certify(gain, MODEL, criterion="variance").optimal

    @pytest.mark.parametrize("solver", ["OSQP", "SCS"])
    def test_first_order_solvers_agree(self, solver):
        certificate = certify(tracking(), solver=solver)
        assert certificate.confirmed
        assert certificate.gain_difference < 1e-10
        assert certificate.solver == solver

    @pytest.mark.parametrize(
        "objective", ["lambda_max", 0, 5, [1.0, 2.0, 0.5, 0.0, 3.0, 1.0], np.diag([0.0, 1, 1, 1, 0, 0]) + 0.1]
    )
    def test_one_gain_is_optimal_for_every_objective(self, objective):
        certificate = certify(tracking(), objective=objective)
        assert certificate.confirmed
        assert certificate.value == pytest.approx(certificate.optimum, rel=1e-6)

    def test_singular_transitions_are_certified_without_the_paper_s_problem(self):
        model = Model([[1.0, 1.0, 0], [0, 0.5, 1.0], [0, 0, 0]], [[1.0, 0, 0]], Q=np.diag([0.0, 0.1, 1.0]))
        certificate = certify(minimum_variance_gain(model, 8, 2), model)
        assert certificate.confirmed
        assert certificate.literal_status == "not posed: the transitions are singular"
        assert np.isnan(certificate.literal_difference)


class TestRefusal:
    @pytest.mark.parametrize("row", range(6))
    def test_one_entry_wrong_by_a_millionth(self, row):
        gain = tracking()
        for column in (0, 7, 13, 14):
            H = gain.H.copy()
            H[row, column] += 1e-6
            assert not certify(replace(gain, H=H)).optimal
            H[row, column] += 1e-6 * np.linalg.norm(gain.H[row]) - 1e-6
            assert not certify(replace(gain, H=H)).optimal

    def test_one_entry_of_an_unbiased_fir_gain_wrong_by_a_millionth(self):
        gain = ufir_gain(MODEL, 3)
        for where in np.ndindex(gain.K.shape):
            K = gain.K.copy()
            K[where] += 1e-6
            assert not certify(Gain(K, gain.G, gain.P, 3), MODEL).optimal

    def test_an_unbiased_gain_that_is_not_the_best(self):
        gain = ufir_gain(MODEL, 8)
        certificate = certify(Gain(gain.K, gain.G, gain.P, 8), MODEL, criterion="variance")
        assert certificate.feasibility < 1e-12
        assert certificate.gap > 1e-3
        assert not certificate.optimal
        assert (certificate.primal >= certificate.dual).all()

    def test_a_biased_gain_of_smaller_variance(self):
        gain = tracking()
        certificate = certify(replace(gain, H=0.999 * gain.H))
        assert certificate.feasibility > 1e-4
        assert not certificate.optimal
        assert not certificate.confirmed

    @pytest.mark.parametrize("factor", [1.001, 0.5, 10.0])
    def test_the_gain_for_another_q_or_r(self, factor):
        gain = minimum_variance_gain(MODEL, 10, 3)
        assert not certify(gain, MODEL.replace(Q=MODEL.Q * factor)).optimal
        assert not certify(gain, MODEL.replace(R=MODEL.R * factor)).optimal
        # Only their ratio matters.
        assert certify(gain, MODEL.replace(Q=MODEL.Q * factor, R=MODEL.R * factor)).optimal

    def test_the_papers_formula_where_pi_is_singular(self):
        certificate = certify(replace(tracking(d=1), H=papers_formula(15, 1)))
        assert not certificate.optimal
        assert certificate.gain_difference > 0.5
        assert "NOT optimal" in repr(certificate)


class TestSolvers:
    def test_a_missing_solver_is_named_with_those_that_are_there(self):
        with pytest.raises(UfirextError, match=r"one of .*CLARABEL.*, got 'NOSUCH'"):
            certify(tracking(), solver="NOSUCH")

    def test_a_solver_that_cannot_solve_the_problem_is_named(self):
        with pytest.warns(UnconfirmedWarning, match="OSQP says 'failed"):
            certificate = certify(tracking(), objective="lambda_max", solver="OSQP")
        assert certificate.optimal
        assert not certificate.confirmed
        assert "not confirmed by OSQP" in repr(certificate)

    def test_a_solver_that_fails_is_named(self, monkeypatch):
        def fail(*_args, **_options):
            raise cvxpy.SolverError("out of order")

        monkeypatch.setattr(cvxpy.Problem, "solve", fail)
        with pytest.warns(UnconfirmedWarning, match="out of order"):
            certificate = certify(tracking())
        assert not certificate.confirmed
        assert certificate.status == "failed: out of order"
        assert np.isnan(certificate.gain_difference)

    def test_an_inaccurate_solution_is_named(self, monkeypatch):
        solve = cvxpy.Problem.solve

        def hurry(self, **options):
            return solve(
                self, **{**options, "max_iter": 2, "eps_abs": 1e-14, "eps_rel": 1e-14, "polishing": False}
            )

        monkeypatch.setattr(cvxpy.Problem, "solve", hurry)
        monkeypatch.setattr("ufirext.certificates.literal_program", lambda *_: None)
        with pytest.warns(UnconfirmedWarning, match="OSQP says 'user_limit|OSQP says 'optimal_inaccurate"):
            certificate = certify(tracking(), solver="OSQP")
        assert not certificate.confirmed


class TestErrors:
    def test_gain_and_model_must_fit(self):
        gain = minimum_variance_gain(MODEL, 5)
        with pytest.raises(UfirextError, match="model must be given"):
            certify(gain)
        with pytest.raises(ShapeError, match=r"gain must have shape \(2, 5\)"):
            certify(gain, kinematic(1, 1, 1.0))
        with pytest.raises(UfirextError, match="one of the library's gains, got ndarray"):
            certify(gain.K, MODEL)

    def test_objective_and_criterion(self):
        gain = tracking()
        with pytest.raises(UfirextError, match="objective must be 'trace'"):
            certify(gain, objective="determinant")
        with pytest.raises(UfirextError, match="one of the 6 rows"):
            certify(gain, objective=6)
        with pytest.raises(ShapeError, match="objective must have shape"):
            certify(gain, objective=[1.0, 2.0])
        with pytest.raises(CovarianceError, match="objective must be positive semidefinite"):
            certify(gain, objective=[-1.0, 1, 1, 1, 1, 1])
        with pytest.raises(UfirextError, match="criterion must be"):
            certify(gain, criterion="bias")

    def test_a_window_without_an_unbiased_gain(self):
        gain = minimum_variance_gain(MODEL, 5)
        with pytest.raises(UnobservableWindow, match="no gain is unbiased"):
            certify(gain, MODEL.replace(H=[[1, 0, 0, 0], [1, 0, 0, 0]]))

    def test_a_long_unstable_window_is_certified_or_refused_but_never_by_accident(self):
        model = Model(unstable(1.3), [[1.0, 0, 0]], Q=0.1, R=1.0)
        gain = minimum_variance_gain(model, 60)
        wrong = replace(gain, K=gain.K * (1 + 1e-6))
        assert not certify(wrong, model).optimal
