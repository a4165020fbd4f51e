"""The lagged state of an FMSFilterSmoother is the state of its step, whichever rows the window has."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.strategies import random_model, seeds
from ufirext import BernoulliDelay, Model, UFIRFilter, filter_series, kinematic
from ufirext.engines.pairs import PairRing
from ufirext.engines.segmented import Segmented
from ufirext.errors import UnobservableWindow
from ufirext.filters.fms import FMSFilterSmoother

RAMP = kinematic(1, 1, 1.0, q=0.1, r=0.5)
WALK = Model([[1.0]], [[1.0]], Q=0.1, R=1.0)
FORGETFUL = Model([[0.9, 0.4], [0.0, 0.0]], np.eye(2), Q=np.diag([0.3, 2.0]), R=np.eye(2))


def best(model: Model, rows, now: int, aim: int, Fs=None, known=None):
    """Generalised least squares over stacked rows (step, z): [x_now; x_aim] and their joint covariance.

    None where the rows do not determine both. The unknown is the oldest state, of a row or aimed at; process
    noise enters each row, and its covariance is that of the stacked errors. Fs and known (input and edits)
    may change from step to step.
    """
    n, old = model.dim_x, min(aim, *(step for step, _ in rows))
    F = {step: model.F if Fs is None else Fs[step] for step in range(old + 1, now + 1)}
    size = n * (now - old)
    T, E, offset = {old: np.eye(n)}, {old: np.zeros((n, size))}, {old: np.zeros(n)}
    for i, step in enumerate(range(old + 1, now + 1)):
        T[step], E[step] = F[step] @ T[step - 1], F[step] @ E[step - 1]
        E[step][:, i * n : (i + 1) * n] += np.eye(n)
        offset[step] = F[step] @ offset[step - 1] + (0.0 if known is None else known[step])
    noise = np.kron(np.eye(now - old), model.Q)
    C = np.vstack([model.H @ T[step] for step, _ in rows])
    D = np.vstack([model.H @ E[step] for step, _ in rows])
    Z = np.concatenate([np.atleast_1d(z) - model.H @ offset[step] for step, z in rows])
    S = D @ noise @ D.T + np.kron(np.eye(len(rows)), model.R)
    aims, into = np.vstack([T[now], T[aim]]), np.vstack([E[now], E[aim]])
    null = np.linalg.svd(C)[2][np.linalg.matrix_rank(C, tol=1e-9) :]
    if np.abs(aims @ null.T).max(initial=0.0) > 1e-7:
        return None
    white = np.linalg.inv(np.linalg.cholesky(S))
    J = into @ noise @ D.T @ white.T @ white
    K = J + (aims - J @ C) @ np.linalg.pinv(white @ C, rcond=1e-11) @ white
    left = into - K @ D
    P = left @ noise @ left.T + K @ np.kron(np.eye(len(rows)), model.R) @ K.T
    return K @ Z + np.concatenate([offset[now], offset[aim]]), P


def made(model: Model, horizon: int, lag: int, **options) -> FMSFilterSmoother:
    f = FMSFilterSmoother(model.dim_x, model.dim_z, horizon=horizon, lag=lag, **options)
    f.F, f.H, f.Q, f.R, f.B = model.F, model.H, model.Q, model.R, model.B
    f.x = np.zeros(model.dim_x)
    return f


def fed(f, zs, lost=()):
    """A step for every z, the first one step 1; the steps `lost` bring nothing."""
    for step, z in enumerate(zs, 1):
        f.predict()
        f.update(None if step in lost else z)
    return f


def within(rows, now: int, horizon: int, wanted: int):
    """The rows of the window: those of the last `horizon` steps, and older ones while there are too few."""
    steps = sorted({step for step, _ in rows})
    start = min(now - horizon + 1, steps[max(len(steps) - wanted, 0)])
    return [row for row in rows if row[0] >= start]


def same(got, expected, tolerance=1e-9):
    np.testing.assert_allclose(got, expected, atol=tolerance * (np.abs(expected).max() + 1.0))


def agrees(f, expected, lag: int, tolerance=1e-9):
    x, P = expected
    n = len(x) // 2
    found = f.smoothed(lag)
    same(found[0], x[n:], tolerance)
    same(found[1], P[n:, n:], tolerance)
    if lag == f.lag:
        same(f.x_lag, x[n:], tolerance)
        same(f.P_lag, P[n:, n:], tolerance)
        same(f.P_cross, P[:n, n:], tolerance)


class TestSeveralRowsOfOneStep:
    @pytest.mark.parametrize("lag", [0, 2, 5])
    @pytest.mark.parametrize("looking", [False, True])
    def test_they_reach_every_lagged_state(self, lag, looking):
        zs = list(np.random.default_rng(0).normal(size=8))
        f = fed(made(WALK, 6, lag), zs)
        assert isinstance(f._state.engine, PairRing)
        rows = list(enumerate(zs, 1))[-6:]
        for more in (5.0, -3.0):
            if looking:
                f.x_lag, f.P_cross  # noqa: B018
            f.update(more)
            rows.append((8, more))
            for back in range(6):
                agrees(f, best(WALK, rows, 8, 8 - back), back)

    def test_the_own_lag_of_a_filter_changes_no_estimate(self):
        zs = np.random.default_rng(1).normal(size=12)
        filters = [fed(made(RAMP, 6, lag), zs) for lag in range(6)]
        for f in filters:
            f.update(4.0)
        for back in range(6):
            for f in filters[1:]:
                same(f.smoothed(back)[0], filters[0].smoothed(back)[0])

    def test_without_a_lag_the_lagged_state_is_the_state_that_the_update_left(self):
        f = fed(made(WALK, 6, 0), np.arange(9.0))
        f.x = f.x + 3.0
        f.update(5.0)
        left = f.x.copy(), f.P.copy()
        same(f.x_lag, left[0])
        same(f.P_lag, left[1])
        same(f.P_cross, left[1])
        f.x = f.x + 1.0
        f.predict()
        same(f.x_lag, left[0])

    def test_an_empty_row_and_an_edit_leave_the_lagged_state_as_it_is(self):
        f = fed(made(WALK, 6, 2), np.arange(9.0))
        before = f.x_lag
        f.update(None)
        f.x = f.x + 1.0
        f.predict()
        same(f.x_lag, before)


class TestTheOldestRowsAreLost:
    def test_a_ramp_without_noise_is_found_again_at_the_step_aimed_at(self):
        model = RAMP.replace(Q=0.01 * np.eye(2))
        for lost in ([13], [13, 14, 15], [13, 15, 20]):
            f, ufir = made(model, 8, 7), UFIRFilter(2, 1, horizon=8)
            ufir.F, ufir.H, ufir.x = model.F, model.H, np.zeros(2)
            fed(f, 10.0 * np.arange(1, 21), lost)
            fed(ufir, 10.0 * np.arange(1, 21), lost)
            same(f.x_lag, [130.0, 10.0])
            same(f.smoothed(7)[0], [130.0, 10.0])
            same(f.smoothed(7)[0], ufir.smoothed(7)[0])

    @pytest.mark.parametrize("lost", [{13}, {13, 14, 15}, {14}, {13, 15, 19, 20}, set(range(9, 19))])
    @pytest.mark.parametrize("model", [RAMP, RAMP.replace(Q=np.zeros((2, 2))), kinematic(2, 1, 1.0, q=0.3)])
    def test_every_lag_is_the_best_estimate_from_the_rows_of_the_window(self, model, lost):
        zs = list(np.random.default_rng(2).normal(size=20) * 3)
        wanted = model.dim_x + 2
        for own in (0, 4, 7):
            f = fed(made(model, 8, own), zs, lost)
            last = max(set(range(1, 21)) - lost)
            rows = within([(k, z) for k, z in enumerate(zs, 1) if k not in lost], last, 8, wanted)
            for lag in range(8):
                agrees(f, best(model, rows, 20, 20 - lag), lag, 1e-8)

    @settings(max_examples=60)
    @given(
        seeds,
        st.integers(4, 8),
        st.floats(0.1, 0.7),
        st.sampled_from(["stable", "marginal", "oscillating", "singular", "delayed"]),
    )
    def test_any_losses_inputs_and_any_transition(self, seed, horizon, share, kind):
        rng = np.random.default_rng(seed)
        model = random_model(seed, 2, 2, kind).replace(B=rng.normal(size=(2, 1)))
        f, rows, Fs, known = made(model, horizon, horizon - 1), [], {}, {}
        for now in range(1, 5 * horizon):
            Fs[now] = model.F + (0.1 * rng.normal(size=(2, 2)) if rng.random() < 0.2 else 0.0)
            u = rng.normal(size=1)
            known[now] = model.B @ u
            f.predict(u=u, F=Fs[now])
            if rng.random() < share:
                f.update(None)
                continue
            z = rng.normal(size=2)
            f.update(z)
            rows.append((now, z))
            if not f.ready or now < horizon:
                continue
            for lag in (horizon - 1, horizon // 2):
                window = within(rows, now, horizon, min(horizon, f._state.limits.instants))
                expected = best(model, window, now, now - lag, Fs, known)
                if expected is None:
                    with pytest.raises(UnobservableWindow, match=f"the state {lag} steps before"):
                        f.smoothed(lag)
                elif np.linalg.norm(expected[1]) < 1e4:  # what is hardly determined is the next test's
                    agrees(f, expected, lag, 1e-6)

    def test_a_state_that_no_row_determines_is_not_given(self):
        f = fed(made(FORGETFUL, 6, 5), np.random.default_rng(3).normal(size=(20, 2)), lost=[15, 16])
        assert f.ready
        for ask in (lambda: f.x_lag, lambda: f.P_lag, lambda: f.P_cross, lambda: f.smoothed(5)):
            with pytest.raises(UnobservableWindow, match="the state 5 steps before the last update"):
                ask()
        with pytest.raises(UnobservableWindow, match="the state 4 steps"):
            f.smoothed(4)
        assert np.isfinite(f.smoothed(3)[0]).all()

    def test_the_error_is_the_one_that_the_covariance_says(self):
        rng = np.random.default_rng(5)
        f, errors, runs = made(RAMP, 6, 5), [], 1500
        spread = np.linalg.cholesky(RAMP.Q + 1e-15 * np.eye(2))
        for _ in range(runs):
            g, x, states = copy.deepcopy(f), rng.normal(size=2), []
            for step in range(1, 13):
                x = RAMP.F @ x + spread @ rng.normal(size=2)
                states.append(x)
                g.predict()
                g.update(None if step in (7, 8) else x[0] + np.sqrt(0.5) * rng.normal())
            errors.append(g.x_lag - states[6])
        P = g.P_lag
        assert np.abs(np.mean(errors, axis=0) / np.sqrt(np.diag(P) / runs)).max() < 5
        assert np.abs(np.var(errors, axis=0) / np.diag(P) - 1).max() < 5 * np.sqrt(2 / runs)

    def test_rows_that_the_folds_cannot_weigh_go_the_slow_way_to_the_same_state(self, monkeypatch):
        zs = np.random.default_rng(6).normal(size=20)
        f = fed(made(RAMP, 8, 7), zs, [13, 14])
        g = copy.deepcopy(f)
        monkeypatch.setattr(g._state.engine, "clear", False)
        same(g.smoothed(7)[0], f.x_lag)
        same(g.smoothed(7)[1], f.P_lag)
        same(g.P_cross, f.P_cross)

    def test_a_longer_horizon_asks_no_row_from_before_its_window(self):
        zs = list(np.random.default_rng(7).normal(size=20))
        f = fed(made(RAMP, 5, 1), zs)
        f.horizon = 12
        rows = list(enumerate(zs, 1))[-5:]
        for lag in (1, 4, 9, 11):
            agrees(f, best(RAMP, rows, 20, 20 - lag), lag)

    def test_a_late_row_makes_the_state_of_its_step_known_again(self):
        zs = list(np.random.default_rng(8).normal(size=20))
        f = fed(made(RAMP, 8, 7), zs, [13, 14])
        f.update(1.5, delay=7)
        rows = [(k, z) for k, z in enumerate(zs, 1) if k > 14] + [(13, 1.5)]
        agrees(f, best(RAMP, rows, 20, 13), 7)

    def test_behind_a_channel_it_is_the_same(self):
        zs = list(np.random.default_rng(9).normal(size=20))
        f = fed(made(RAMP, 8, 7, max_delay=2), zs, [13, 14])
        agrees(f, best(RAMP, list(enumerate(zs, 1))[14:], 20, 13), 7)

    def test_a_measurement_that_may_be_late_meets_the_state_before(self):
        """A second one of a step, where one row alone determines the state: x_{n-1} is not x_n."""
        model = Model(0.5 * np.eye(2), np.eye(2), Q=np.eye(2), R=np.eye(2))
        f = made(model, 4, 1, channel=BernoulliDelay(0.0))
        fed(f, [np.ones(2), 2.0 * np.ones(2)], lost=[1])
        pair = f._state._pair()
        assert np.abs(pair.x[2:] - pair.x[:2]).max() > 0.1


class TestFirstStepsAndOutages:
    def test_in_the_first_steps_it_is_the_oldest_state_of_the_window(self):
        zs = list(np.random.default_rng(10).normal(size=9))
        f = made(RAMP, 8, 6)
        for now, z in enumerate(zs, 1):
            f.predict()
            f.update(z)
            if f.ready:
                aim = max(now - 6, 1)
                x, P = best(RAMP, within(list(enumerate(zs[:now], 1)), now, 8, 4), now, aim)
                same(f.x_lag, x[2:])
                same(f.P_lag, P[2:, 2:])
        assert now - 6 > 1

    def test_any_other_lag_is_never_answered_with_another_step(self):
        """The steps before the first one are thought to be as the first, as a UFIRFilter has it."""
        f, ufir = made(RAMP, 8, 6), UFIRFilter(2, 1, horizon=8)
        ufir.F, ufir.H, ufir.x = RAMP.F, RAMP.H, np.zeros(2)
        with pytest.raises(UnobservableWindow, match="the state 3 steps before"):
            f.smoothed(3)
        fed(f, [10.0])
        with pytest.raises(UnobservableWindow, match="the state 3 steps before"):
            f.smoothed(3)
        fed(f, [20.0, 30.0])
        fed(ufir, [10.0, 20.0, 30.0])
        for lag in range(8):
            same(f.smoothed(lag)[0], [30.0 - 10.0 * lag, 10.0])
            same(f.smoothed(lag)[0], ufir.smoothed(lag)[0])

    def test_a_first_row_that_is_lost_is_no_excuse_once_its_step_is_the_one_aimed_at(self):
        f = fed(made(RAMP, 8, 4), 10.0 * np.arange(1, 6), lost=[1, 2])
        same(f.x_lag, [10.0, 10.0])

    def test_before_anything_came_it_is_what_the_filter_believes(self):
        f = made(RAMP, 8, 3)
        f.x, f.P = np.array([1.0, 2.0]), np.diag([3.0, 4.0])
        same(f.x_lag, [1.0, 2.0])
        same(f.P_lag, np.diag([3.0, 4.0]))
        f.predict()
        assert np.isfinite(f.x_lag).all()

    @pytest.mark.parametrize("edited", [False, True])
    def test_after_an_outage_it_is_smoothed_from_what_was_believed_then(self, edited):
        """The Kalman smoother: what was predicted for the step, corrected by the row that came since."""
        model, f = RAMP, fed(made(RAMP, 5, 3), 10.0 * np.arange(1, 13))
        for _ in range(199):
            f.predict()
            f.update(None)
        if edited:
            f.x = f.x + np.array([5.0, 0.0])  # a known change of the state, seen from the next step on
        f.predict()
        f.update(None)
        then = [(f.x.copy(), f.P.copy())]
        for _ in range(3):
            f.predict()
            then.append((f.x.copy(), f.P.copy()))
        f.update(500.0)
        assert not f.ready
        S = model.H @ then[-1][1] @ model.H.T + model.R
        for lag in range(4):
            x, P = then[-1 - lag]
            cross = P @ np.linalg.matrix_power(model.F, lag).T @ model.H.T
            gain = cross @ np.linalg.inv(S)
            same(f.smoothed(lag)[0], x + gain @ (500.0 - model.H @ then[-1][0]), 1e-8)
            same(f.smoothed(lag)[1], P - gain @ cross.T, 1e-8)

    def test_a_covariance_that_is_written_says_nothing_of_the_steps_before(self):
        f = fed(made(RAMP, 5, 2), 10.0 * np.arange(1, 13))
        for _ in range(200):
            f.predict()
            f.update(None)
        f.P = 7.0 * np.eye(2)
        f.predict()
        f.update(0.0)
        with pytest.raises(UnobservableWindow, match="the state 2 steps before"):
            f.x_lag  # noqa: B018


class TestSeries:
    @pytest.mark.parametrize("engine", ["auto", "stepwise"])
    def test_losses_leave_every_row_the_state_of_its_step(self, engine):
        model = kinematic(1, 1, 1.0, q=0.01)
        z = 10.0 * np.arange(1, 41)
        z[[0, 1, 12, 20, 21, 22, 30]] = np.nan
        ours = filter_series(model, z, 8, lag=7, noise=(model.Q, model.R), engine=engine)
        ufir = filter_series(model, z, 8, lag=7)
        same(ours.x[7:], np.stack([10.0 * np.arange(1, 34), np.full(33, 10.0)], axis=1), 1e-8)
        same(ours.x[7:], ufir.x[7:], 1e-8)
        assert ours.ready[7:].all()

    def test_they_are_the_best_estimates_with_their_covariance(self):
        z = np.random.default_rng(11).normal(size=30)
        z[[9, 10, 16, 22, 23]] = np.nan
        rows = [(k, float(v)) for k, v in enumerate(z, 1) if not np.isnan(v)]
        ours = filter_series(RAMP, z, 6, lag=5, noise=(RAMP.Q, RAMP.R))
        for now in range(6, 31):
            if np.isnan(z[now - 1]):
                continue
            window = within([row for row in rows if row[0] <= now], now, 6, 4)
            x, P = best(RAMP, window, now, now - 5)
            same(ours.x[now - 1], x[2:], 1e-8)
            same(ours.P[now - 1], P[2:, 2:], 1e-8)

    def test_a_state_that_no_row_determines_is_not_a_number(self):
        z = np.random.default_rng(12).normal(size=(20, 2))
        z[[9, 10]] = np.nan
        model = FORGETFUL
        ours = filter_series(model, z, 6, lag=5, noise=(model.Q, model.R))
        lost = np.isin(np.arange(20), [14, 15])
        # The steps aimed at are those that are lost, and the windows begin after them.
        assert np.isnan(ours.x[lost]).all()
        assert not ours.ready[lost].any()
        assert np.isfinite(ours.x[5:][~lost[5:]]).all()


def test_a_hole_at_the_end_of_the_window_costs_no_design_of_gains(monkeypatch):
    """It is answered by the folds, at a cost that does not grow with the horizon."""
    f = fed(made(RAMP, 40, 39), np.arange(60.0), lost=[21, 22])
    assert isinstance(f._state.engine, Segmented)
    monkeypatch.setattr("ufirext.engines.segmented.joint_gain", None)
    assert np.isfinite(f.x_lag).all()
