"""FMSFilterSmoother: the best estimates of its window, whatever comes, behind filterpy's verbs."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.oracles import kalman_update, observability_index
from tests.strategies import random_model, seeds
from tests.theory.test_fms_gain import A, C, Q, R, tracking
from ufirext import DelayKalmanFilter, Model, kinematic
from ufirext.engines.pairs import PairRing
from ufirext.engines.segmented import Segmented
from ufirext.errors import CovarianceError, HorizonError, UnobservableWindow
from ufirext.filters.fms import FMSFilterSmoother
from ufirext.fms import fms_gain
from ufirext.joint import InaccurateGainWarning
from ufirext.minimum_variance import minimum_variance_gain


class Naive:
    """Every window solved from scratch: one least-squares problem in the oldest state and all the noise."""

    def __init__(self, horizon: int, wanted: int) -> None:
        self.horizon, self.wanted, self.now = horizon, wanted, 0
        self.steps: dict[int, tuple] = {}
        self.rows: list[tuple] = []

    def predict(self, F, Q, known) -> None:
        self.now += 1
        self.steps[self.now] = F, Q, known

    def update(self, z, H, R, delay: int) -> None:
        seen = ~np.isnan(z)
        self.rows.append((self.now - delay, z[seen], H[seen], R[np.ix_(seen, seen)]))

    def window(self) -> list[tuple]:
        start = self.now - self.horizon + 1
        origins = sorted({row[0] for row in self.rows})
        start = min(start, origins[max(len(origins) - self.wanted, 0)])
        return [row for row in self.rows if row[0] >= start]

    def estimate(self, lag: int):
        """x_now, x_lag (before the first step: the oldest state of the window), and the joint covariance."""
        rows = self.window()
        old, n = min(row[0] for row in rows), rows[0][2].shape[1]
        aim = self.now - lag if self.now > lag else max(self.now - lag, old)
        old = min(old, aim)
        steps = range(old + 1, self.now + 1)
        into = np.zeros((n, n + n * len(steps)))
        into[:, :n] = np.eye(n)
        offset = np.zeros(n)
        states = {old: (into, offset)}
        for i, t in enumerate(steps):
            F, Q, known = self.steps.get(t) or (*self.steps[min(self.steps)][:2], np.zeros(n))
            values, vectors = np.linalg.eigh(Q)
            into = F @ into
            into[:, n + i * n : n + (i + 1) * n] = vectors * np.sqrt(np.maximum(values, 0.0))
            offset = F @ offset + known
            states[t] = into, offset
        white = [np.linalg.inv(np.linalg.cholesky(row[3])) for row in rows]
        seen = [w @ row[2] @ states[row[0]][0] for w, row in zip(white, rows, strict=True)]
        free = [w @ (row[1] - row[2] @ states[row[0]][1]) for w, row in zip(white, rows, strict=True)]
        noise = np.hstack([np.zeros((n * len(steps), n)), np.eye(n * len(steps))])
        big = np.vstack([*seen, noise])
        right = np.concatenate([*free, np.zeros(len(noise))])
        scale = np.linalg.norm(big, axis=0)
        scale[scale == 0] = 1.0
        theta = np.linalg.lstsq(big / scale, right, rcond=1e-13)[0] / scale
        both = np.vstack([states[self.now][0], states[aim][0]])
        spread = (both / scale) @ np.linalg.pinv(big / scale, rcond=1e-13)
        x = both @ theta + np.concatenate([states[self.now][1], states[aim][1]])
        return x[:n], x[n:], spread @ spread.T


def made(model: Model, horizon: int, lag: int = 0, form: int = 1) -> FMSFilterSmoother:
    f = FMSFilterSmoother(model.dim_x, model.dim_z, model.dim_u, horizon=horizon, lag=lag)
    f.F, f.H, f.Q, f.R, f.B = model.F.copy(), model.H.copy(), model.Q.copy(), model.R.copy(), model.B
    f.x = np.zeros(model.dim_x) if form == 1 else np.zeros((model.dim_x, 1))
    f.P = 100.0 * np.eye(model.dim_x)
    return f


def agrees(f: FMSFilterSmoother, naive: Naive, lag: int, tolerance: float = 1e-9) -> None:
    x, x_lag, P = naive.estimate(lag)
    n = len(x)
    for got, expected in (
        (f.x.ravel(), x),
        (f.x_lag.ravel(), x_lag),
        (f.P, P[:n, :n]),
        (f.P_lag, P[n:, n:]),
        (f.P_cross, P[:n, n:]),
    ):
        np.testing.assert_allclose(got, expected, atol=tolerance * (np.abs(expected).max() + 1.0))


def wanted(model: Model, horizon: int) -> int:
    return min(horizon, (observability_index(model.F, model.H) or 1) + 2)


MODELS = {
    "velocity": kinematic(1, 1, 0.5, q=0.4, r=2.0),
    "two axes": kinematic(1, 2, 1.0, q=0.1, r=1.0),
    "tracking": Model(A, C, Q=Q, R=R),
    "no process noise": kinematic(1, 1, 0.5, q=0.0, r=2.0),
}


class TestTheWindow:
    @pytest.mark.parametrize("name", MODELS)
    @pytest.mark.parametrize(("horizon", "lag"), [(4, 0), (5, 3), (12, 5), (12, 11)])
    def test_a_plain_stream_is_the_best_estimate_of_every_window(self, name, horizon, lag):
        model, rng = MODELS[name], np.random.default_rng(1)
        f, naive = made(model, horizon, lag), Naive(horizon, wanted(model, horizon))
        for _ in range(4 * horizon):
            z = rng.normal(size=model.dim_z) * 3
            f.predict()
            naive.predict(model.F, model.Q, np.zeros(model.dim_x))
            f.update(z)
            naive.update(z, model.H, model.R, 0)
            if f.ready:
                agrees(f, naive, lag)
        assert isinstance(f._state.engine, PairRing)

    @settings(max_examples=40)
    @given(
        seeds, st.integers(3, 9), st.integers(0, 8), st.sampled_from(["stable", "marginal", "oscillating"])
    )
    def test_holes_late_rows_inputs_edits_and_varying_models(self, seed, horizon, lag, kind):
        rng = np.random.default_rng(seed)
        model = random_model(seed, 2, 2, kind).replace(B=rng.normal(size=(2, 1)))
        horizon = max(horizon, 4)
        lag = min(lag, horizon - 1)
        f, naive = made(model, horizon, lag), Naive(horizon, wanted(model, horizon))
        f.predict()
        f.update(None)  # so that an edit is one after the rows of its step
        naive.predict(model.F, model.Q, np.zeros(2))
        for _ in range(5 * horizon):
            F = model.F + (0.05 * rng.normal(size=(2, 2)) if rng.random() < 0.3 else 0.0)
            Q_now = model.Q * rng.uniform(0.5, 2.0)
            u = rng.normal(size=1) if rng.random() < 0.4 else None
            if rng.random() < 0.1:
                delta = rng.normal(size=2)
                f.x = f.x + delta
                extra = F @ delta
            else:
                extra = np.zeros(2)
            f.predict(u=u, F=F, Q=Q_now)
            known = extra + (0.0 if u is None else model.B @ u)
            naive.predict(F, Q_now, known)
            if rng.random() < 0.25:
                f.update(None)
                continue
            z, H = rng.normal(size=2) * 2, rng.normal(size=(2, 2))
            R_now = model.R * rng.uniform(0.5, 2.0)
            if rng.random() < 0.2:
                z[rng.integers(2)] = np.nan
            delay = int(rng.integers(0, min(3, horizon, naive.now))) if rng.random() < 0.3 else 0
            f.update(z, R=R_now, H=H, delay=delay)
            naive.update(z, H, R_now, delay)
            if f.ready and len({row[0] for row in naive.window()}) >= 3:
                agrees(f, naive, lag, 1e-8)

    def test_a_hole_in_a_regular_stream_and_back(self):
        model, rng = MODELS["two axes"], np.random.default_rng(3)
        f, naive = made(model, 6, 2), Naive(6, wanted(model, 6))
        engines = set()
        for i in range(60):
            f.predict()
            naive.predict(model.F, model.Q, np.zeros(4))
            if i in (20, 21, 40):
                f.update(None)
            else:
                z = rng.normal(size=2) + 1e3
                f.update(z)
                naive.update(z, model.H, model.R, 0)
                if f.ready:
                    agrees(f, naive, 2)
            engines.add((i // 20, type(f._state.engine)))
        assert {(0, PairRing), (1, PairRing), (2, PairRing), (1, Segmented), (2, Segmented)} <= engines

    def test_a_disturbance_is_forgotten_after_the_horizon(self):
        model = MODELS["tracking"]
        clean, hit = made(model, 15, 4), made(model, 15, 4)
        for i in range(40):
            for f in (clean, hit):
                f.predict()
                f.update(np.array([0.1 * i + (1e3 if f is hit and i == 20 else 0.0)]))
            same = np.abs(clean.x - hit.x).max() < 1e-6 and np.abs(clean.x_lag - hit.x_lag).max() < 1e-6
            assert same == (i < 20 or i >= 35)

    @pytest.mark.parametrize("lag", [0, 4])
    def test_large_offsets_cost_no_digits(self, lag):
        model, rng = MODELS["velocity"], np.random.default_rng(5)
        near, far = made(model, 10, lag), made(model, 10, lag)
        for i in range(50):
            z = rng.normal(size=1)
            for f, offset in ((near, 0.0), (far, 2.0**20)):
                f.predict()
                f.update(None if i % 4 == 0 else z + offset)
        np.testing.assert_allclose(far.x - [2.0**20, 0], near.x, atol=1e-8)
        np.testing.assert_allclose(far.x_lag - [2.0**20, 0], near.x_lag, atol=1e-8)

    @pytest.mark.parametrize("q", [0.0, 1e-6])
    @pytest.mark.parametrize("angle", [1e-2, 1e-5])
    def test_the_window_is_no_longer_than_it_must_be_however_weakly_it_sees(self, angle, q):
        # Rows that are almost parallel follow rows that are not: normal equations square their angle.
        model = kinematic(1, 1, 1.0, q=q, r=1.0)
        f, naive = made(model, 5, 2), Naive(5, 4)
        rng = np.random.default_rng(4)
        for i in range(1, 25):
            z, tilt = rng.normal(size=1), 1.0 if i < 10 else angle
            H = np.array([[1.0, -i + tilt * rng.normal()]])
            f.predict()
            naive.predict(model.F, model.Q, np.zeros(2))
            f.update(z, H=H)
            naive.update(z, H, model.R, 0)
            if f.ready:
                assert f.rows == len(naive.window())
                agrees(f, naive, 2, 1e-15 / angle**2 + 1e-9)

    def test_the_cost_of_a_hole_is_some_combinations_whatever_the_horizon(self, monkeypatch):
        import ufirext.segments as segments

        counts = {}
        combine = segments.combine
        for horizon in (10, 80):
            model, calls = MODELS["velocity"], [0]
            f = made(model, horizon, 3)
            for i in range(2 * horizon):
                f.predict()
                f.update(None if i % 3 == 0 else np.array([float(i)]))
                f.x_lag  # noqa: B018

            def counted(first, second, calls=calls):
                calls[0] += 1
                return combine(first, second)

            monkeypatch.setattr(segments, "combine", counted)
            monkeypatch.setattr("ufirext.engines.segmented.combine", counted)
            for i in range(6 * horizon):
                f.predict()
                f.update(None if i % 3 == 0 else np.array([float(i)]))
                f.x_lag  # noqa: B018
            monkeypatch.undo()
            counts[horizon] = calls[0] / (6 * horizon)
        assert counts[80] < 1.3 * counts[10]
        assert counts[80] < 15


class TestKnownInputsAndEdits:
    """They stay on the constant gain: the window is free of a path of what is known."""

    @pytest.mark.parametrize("name", MODELS)
    @pytest.mark.parametrize(("horizon", "lag"), [(5, 0), (12, 5)])
    def test_inputs_edits_and_pauses(self, name, horizon, lag):
        rng, base = np.random.default_rng(1), MODELS[name]
        n = base.dim_x
        model = base.replace(B=rng.normal(size=(n, 2)))
        f, naive, engines = made(model, horizon, lag), Naive(horizon, wanted(model, horizon)), set()
        held = np.zeros(n)
        for i in range(16 * horizon):
            busy = (i // (4 * horizon)) % 2 == 0
            u = rng.normal(size=2) if busy and i % 3 else None
            f.predict(u=u)
            naive.predict(model.F, model.Q, held + (0.0 if u is None else model.B @ u))
            held = np.zeros(n)
            if busy and i % 5 == 0:
                delta = rng.normal(size=n)
                f.x = f.x + delta  # before the row of this step
                F, Q, known = naive.steps[naive.now]
                naive.steps[naive.now] = F, Q, known + delta
            if i in (9 * horizon, 12 * horizon + 2):
                f.update(None)
                continue
            z = rng.normal(size=model.dim_z) * 3
            f.update(z)
            naive.update(z, model.H, model.R, 0)
            if f.ready:
                agrees(f, naive, lag)
            if busy and i % 7 == 0:
                delta = rng.normal(size=n)
                f.x += delta  # after it
                held = model.F @ delta
            engine = f._state.engine
            engines.add((type(engine), getattr(engine, "path", None) is not None))
        assert {(PairRing, True), (PairRing, False), (Segmented, False)} == engines

    @pytest.mark.parametrize("rho", [1.1, 1.0])
    def test_a_stabilised_plant_for_a_long_time(self, rho):
        model = Model([[rho, 0.3], [0.0, 0.9]], np.eye(2), Q=0.01, R=0.1, B=[1.0, 0.2])
        f, naive = made(model, 12, 3), Naive(12, 3)
        rng, x, u = np.random.default_rng(3), np.zeros(2), np.zeros(1)
        for _ in range(500):
            x = model.F @ x + model.B @ u + 0.1 * rng.normal(size=2)
            z = x + 0.3 * rng.normal(size=2)
            f.predict(u=u)
            naive.predict(model.F, model.Q, model.B @ u)
            f.update(z)
            naive.update(z, model.H, model.R, 0)
            u = -0.6 * f.x[:1]
        agrees(f, naive, 3)

    def test_copies_keep_the_path(self):
        model = MODELS["velocity"].replace(B=[0.5, 1.0])
        f = made(model, 8, 3)
        for i in range(30):
            f.predict(u=float(i % 3))
            f.update(np.array([np.sin(i)]))
        twins = [copy.deepcopy(f), pickle.loads(pickle.dumps(f))]
        for i in range(30, 40):
            for twin in (f, *twins):
                twin.predict(u=float(i % 3))
                twin.update(np.array([np.sin(i)]))
        for twin in twins:
            np.testing.assert_allclose(twin.x, f.x, rtol=1e-12)
            np.testing.assert_allclose(twin.x_lag, f.x_lag, rtol=1e-12)


class TestTheRelationToThePaper:
    @pytest.mark.parametrize("lag", [0, 1, 4])
    def test_horizon_is_m_and_lag_is_d_minus_one(self, lag):
        f, rng, zs = made(MODELS["tracking"], 15, lag), np.random.default_rng(2), []
        gain = tracking(d=lag + 1)
        for _ in range(40):
            zs.append(rng.normal(size=1))
            f.predict()
            f.update(zs[-1])
        x, lagged = gain.estimate(np.array(zs[-15:]))
        np.testing.assert_allclose(f.x_lag, lagged, atol=1e-12)
        np.testing.assert_allclose(f.P_lag, gain.P[3:, 3:], atol=1e-14)
        f.predict()
        np.testing.assert_allclose(f.x_prior, x, atol=1e-11)
        np.testing.assert_allclose(f.P_prior, gain.P[:3, :3], atol=1e-14)

    def test_inputs_as_in_the_paper(self):
        model = MODELS["tracking"].replace(B=[2.0, 2.0, 1.0])
        f, rng = made(model, 8, 2), np.random.default_rng(4)
        gain = fms_gain(A, C, Q, R, 8, 3, B=model.B)
        zs, us = [], []
        for _ in range(30):
            zs.append(rng.normal(size=1))
            f.predict(u=us[-1] if us else None)
            f.update(zs[-1])
            us.append(rng.normal(size=1))
        x, lagged = gain.estimate(np.array(zs[-8:]), np.array(us[-8:]))
        np.testing.assert_allclose(f.x_lag, lagged, atol=1e-10)
        f.predict(u=us[-1])
        np.testing.assert_allclose(f.x, x, atol=1e-10)


class TestWarmUpAndLoss:
    def test_until_it_is_ready_it_is_the_kalman_filter(self):
        model, rng = MODELS["tracking"], np.random.default_rng(6)
        f, x, P = made(model, 9, 3), np.array([1.0, 2.0, 3.0]), np.diag([4.0, 5.0, 6.0])
        f.x, f.P = x, P
        for i in range(5):
            z = rng.normal(size=1)
            x, P = A @ x, A @ P @ A.T + Q
            f.predict()
            f.update(z)
            x, P = kalman_update(x, P, z, C, R)
            assert f.ready == (i >= 2)
            if not f.ready:
                np.testing.assert_allclose(f.x, x, rtol=1e-10)
                np.testing.assert_allclose(f.P, P, rtol=1e-10)

    def test_in_warm_up_the_lagged_state_is_smoothed_from_the_prior(self):
        f = made(MODELS["tracking"], 9, 1)
        f.x, f.P = np.array([1.0, 2.0, 3.0]), np.diag([4.0, 5.0, 6.0])
        f.predict()
        f.update(np.array([0.5]))
        f.predict()
        f.update(np.array([0.7]))
        assert not f.ready
        F2 = np.block([[A, np.zeros((3, 3))], [np.eye(3), np.zeros((3, 3))]])
        x, P = A @ [1.0, 2.0, 3.0], A @ np.diag([4.0, 5.0, 6.0]) @ A.T + Q
        x, P = kalman_update(x, P, np.array([0.5]), C, R)
        pair, joint = np.concatenate([x, x]), np.kron(np.ones((2, 2)), P)
        pair, joint = F2 @ pair, F2 @ joint @ F2.T
        joint[:3, :3] += Q
        pair, joint = kalman_update(pair, joint, np.array([0.7]), np.hstack([C, np.zeros((1, 3))]), R)
        np.testing.assert_allclose(f.x_lag, pair[3:], atol=1e-10)
        np.testing.assert_allclose(f.P_lag, joint[3:, 3:], rtol=1e-9)
        np.testing.assert_allclose(f.P_cross, joint[:3, 3:], rtol=1e-9)

    def test_while_nothing_comes_it_coasts_and_it_recovers(self):
        model = MODELS["velocity"]
        f = made(model, 5, 2)
        for i in range(20):
            f.predict()
            f.update(np.array([2.0 * i]))
        traces = []
        for _ in range(200):
            before = model.F @ f.x
            f.predict()
            f.update(None)
            np.testing.assert_allclose(f.x, before, rtol=1e-12)
            assert np.isfinite(f.x_lag).all()
            traces.append(np.trace(f.P))
        assert np.all(np.diff(traces) > 0)
        assert not f.ready
        for i in range(220, 230):
            f.predict()
            f.update(np.array([2.0 * i]))
            assert np.isfinite(f.x_lag).all()
        assert f.ready
        np.testing.assert_allclose(f.x, [2.0 * 229, 4.0], atol=1e-8)
        np.testing.assert_allclose(f.x_lag, [2.0 * 227, 4.0], atol=1e-8)

    def test_rows_that_are_too_late_are_counted(self):
        f = made(MODELS["velocity"], 4, 1)
        for i in range(10):
            f.predict()
            f.update(np.array([float(i)]), delay=0 if i < 8 else 4)
        assert f.dropped == 2

    def test_a_window_that_can_never_suffice(self):
        f = made(MODELS["tracking"], 2)
        with pytest.raises(UnobservableWindow, match="horizon must be at least 3"):
            f.predict()
        forgets = Model([[0.9, 0.0], [0.0, 0.0]], [[1.0, 0.0]], Q=np.eye(2))
        with pytest.raises(UnobservableWindow, match="the state 5 steps ago, it cannot"):
            made(forgets, 6, 5).predict()

    def test_a_singular_transition_whose_older_states_stay_hidden(self):
        forgets = Model([[0.9, 0.0], [0.0, 0.0]], [[1.0, 0.0]], Q=np.diag([0.5, 2.0]))
        f, gain = made(forgets, 6, 2), minimum_variance_gain(forgets, 6, 2)
        rng, zs = np.random.default_rng(8), []
        for i in range(20):
            zs.append(rng.normal(size=1))
            f.predict()
            f.update(zs[-1] if i != 3 else None)
        np.testing.assert_allclose(f.x, gain.K_now @ np.ravel(zs[-6:]), atol=1e-12)
        np.testing.assert_allclose(f.x_lag, gain.K @ np.ravel(zs[-6:]), atol=1e-12)

    def test_what_the_folds_cannot_tell_is_solved_by_the_recursion(self):
        # Without process noise an unstable mode drowns the oldest rows: the folds lose its companion.
        model = Model([[1.6, 0.3], [0.0, 0.9]], [[1.0, 0.5]], R=1.0)
        f, naive = made(model, 30, 4), Naive(30, 4)
        rng, x = np.random.default_rng(9), np.array([1e-6, 1.0])
        for i in range(45):
            x = model.F @ x
            z = model.H @ x + rng.normal(size=1)
            f.predict()
            naive.predict(model.F, model.Q, np.zeros(2))
            if i % 5 == 0:
                f.update(None)
            else:
                f.update(z)
                naive.update(z, model.H, model.R, 0)
        x_now, x_lag, _ = naive.estimate(4)
        np.testing.assert_allclose(f.x, x_now, atol=1e-6)
        np.testing.assert_allclose(f.x_lag, x_lag, atol=1e-6)


class TestFilterpysFace:
    def stream(self, f, steps=30, start=0):
        for i in range(start, start + steps):
            f.predict()
            f.update(np.array([0.3 * i + np.sin(i)]))

    @pytest.mark.parametrize("steps", [2, 8, 40])
    def test_copies_and_pickles_go_on_alike(self, steps):
        f = made(MODELS["velocity"], 8, 3)
        self.stream(f, steps)
        twins = [f, copy.deepcopy(f), pickle.loads(pickle.dumps(f))]
        for twin in twins:
            self.stream(twin, 20, steps)
            np.testing.assert_allclose(twin.x, f.x, rtol=1e-12)
            np.testing.assert_allclose(twin.x_lag, f.x_lag, rtol=1e-12)

    def test_batch_equals_the_hand_loop_with_gaps(self):
        zs = [None if i % 7 == 3 else np.array([np.cos(i)]) for i in range(40)]
        f, g = made(MODELS["velocity"], 6, 2), made(MODELS["velocity"], 6, 2)
        means, covs, priors, prior_covs = f.batch_filter(zs)
        for i, z in enumerate(zs):
            g.predict()
            np.testing.assert_allclose(priors[i], g.x, rtol=1e-12, atol=1e-12)
            np.testing.assert_allclose(prior_covs[i], g.P, rtol=1e-9)
            g.update(z)
            np.testing.assert_allclose(means[i], g.x, rtol=1e-12, atol=1e-12)
            np.testing.assert_allclose(covs[i], g.P, rtol=1e-9)

    @pytest.mark.parametrize("form", [1, 2])
    def test_forms_and_published_quantities(self, form):
        f = made(MODELS["velocity"], 8, 3, form)
        self.stream(f, 30)
        shape = (2,) if form == 1 else (2, 1)
        assert f.x.shape == f.x_lag.shape == f.x_prior.shape == shape
        np.testing.assert_allclose(f.y.ravel(), f.z.ravel() - f.H @ f.x_prior.ravel(), atol=1e-12)
        np.testing.assert_allclose(f.S, f.H @ f.P_prior @ f.H.T + f.R)
        np.testing.assert_allclose(f.K, f.P_post @ f.H.T @ np.linalg.inv(f.R), rtol=1e-9)
        np.testing.assert_allclose(f.x_prior.ravel(), f.F @ self.before(form), rtol=1e-12)

    def before(self, form):
        f = made(MODELS["velocity"], 8, 3, form)
        self.stream(f, 29)
        return f.x.ravel()

    def test_the_lagged_state_stays_through_predict(self):
        f = made(MODELS["velocity"], 8, 3)
        self.stream(f, 30)
        before = f.x_lag
        f.predict()
        assert np.array_equal(f.x_lag, before)
        f.x += 1.0
        assert np.array_equal(f.x_lag, before)

    def test_reading_everything_every_step_changes_nothing(self):
        quiet, nosy = made(MODELS["velocity"], 8, 3), made(MODELS["velocity"], 8, 3)
        for i in range(40):
            for f in (quiet, nosy):
                f.predict()
                f.update(None if i == 25 else np.array([np.sin(i)]))
            assert repr(nosy)
            nosy.P, nosy.F  # noqa: B018
            nosy.get_update(np.array([1.0]))
            nosy.get_prediction()
        np.testing.assert_allclose(quiet.x, nosy.x, rtol=1e-12)
        np.testing.assert_allclose(quiet.x_lag, nosy.x_lag, rtol=1e-12)

    def test_an_edit_of_x_moves_the_state(self):
        f, g = made(MODELS["velocity"], 8, 3), made(MODELS["velocity"], 8, 3)
        self.stream(f, 30)
        self.stream(g, 30)
        f.x[0] += 100.0
        for i in range(30, 50):
            f.predict()
            g.predict()
            f.update(np.array([np.sin(i) + 100.0]))
            g.update(np.array([np.sin(i)]))
            np.testing.assert_allclose(f.x - g.x, [100.0, 0.0], atol=1e-9)

    def test_another_horizon_and_lag_in_mid_life(self):
        f, naive, rng = made(MODELS["velocity"], 8, 3), Naive(5, 4), np.random.default_rng(7)
        for i in range(40):
            if i == 20:
                f.horizon, f.lag = 5, 1
            z = rng.normal(size=1)
            f.predict()
            naive.predict(f.F, f.Q, np.zeros(2))
            f.update(z)
            naive.update(z, f.H, f.R, 0)
            if i >= 20:
                agrees(f, naive, 1)
        assert (f.horizon, f.lag, f.rows) == (5, 1, 5)

    def test_any_lag_on_demand_and_predictions(self):
        f, rng = made(MODELS["velocity"], 8, 3), np.random.default_rng(1)
        zs = rng.normal(size=(30, 1))
        for z in zs:
            f.predict()
            f.update(z)
        for lag in range(8):
            gain = minimum_variance_gain(MODELS["velocity"], 8, lag)
            x, P = f.smoothed(lag)
            np.testing.assert_allclose(x, gain.K @ zs[-8:].ravel(), atol=1e-11)
            np.testing.assert_allclose(P, gain.P, atol=1e-11)
        x, P = f.predicted(2)
        np.testing.assert_allclose(x, f.F @ f.F @ f.x, atol=1e-12)
        np.testing.assert_allclose(P, f.F @ (f.F @ f.P @ f.F.T + f.Q) @ f.F.T + f.Q)
        with pytest.raises(HorizonError, match="lag must be between 0 and 7"):
            f.smoothed(8)

    def test_from_filterpy_saver_and_certificate(self):
        from filterpy.common import Saver
        from filterpy.kalman import KalmanFilter

        kf = KalmanFilter(2, 1)
        kf.F, kf.H, kf.Q, kf.R = (np.array(getattr(MODELS["velocity"], name)) for name in "FHQR")
        f = FMSFilterSmoother.from_filterpy(kf, horizon=8, lag=3)
        saver = Saver(f)
        for i in range(20):
            f.predict()
            f.update(float(i))
            saver.save()
        saver.to_array()
        assert saver.x_lag.shape == (20, 2, 1)
        assert f.certify().confirmed

    def test_bad_input(self):
        for horizon, lag in [(0, 0), (5, 5), (5, -1), ("auto", 0)]:
            with pytest.raises(HorizonError):
                FMSFilterSmoother(2, 1, horizon=horizon, lag=lag)
        f = made(MODELS["velocity"], 8)
        f.predict()
        with pytest.raises(CovarianceError, match="R must not be zero"):
            f.update(1.0, R=0.0)


def test_an_unobservable_model_coasts_as_a_kalman_filter():
    model = Model(np.eye(2), [[1.0, 0.0]], Q=0.1, R=1.0)
    f, x, P = made(model, 6, 2), np.zeros(2), 100.0 * np.eye(2)
    for i in range(40):
        P = P + model.Q
        f.predict()
        f.update(float(i))
        x, P = kalman_update(x, P, np.array([float(i)]), model.H, model.R)
        np.testing.assert_allclose(f.x, x, rtol=1e-12)
        assert not f.ready
        assert np.isfinite(f.x_lag).all()


@pytest.mark.parametrize("lag", [0, 2])
def test_a_model_that_becomes_unobservable_coasts_where_it_is_blind(lag):
    """A sensor turned away: the window reaches back as far as it may, then this is a Kalman filter."""
    f = made(kinematic(1, 2, 1.0, q=0.1), 8, lag)
    for i in range(150):
        if i == 30:
            f.H = np.array([[1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]])
        f.predict()
        f.update([2.0 * i, 2.0 * i if i >= 30 else -1.0])
        if i >= 8:
            np.testing.assert_allclose(f.x, [2.0 * i, 2.0, -1.0, 0.0], rtol=1e-6, atol=1e-6)
            assert f.ready == (i < 28 + 4 * 8 + 64)  # two steps saw the other axis


@pytest.mark.parametrize(("r", "tolerance"), [(1e-8, 1e-6), (1e-12, None)])
def test_measurements_far_better_than_predictions_cost_no_digits_silently(r, tolerance):
    """Late rows of tiny R go through gains designed anew, not through folds that would lose their digits."""
    rng = np.random.default_rng(0)
    model = kinematic(1, 1, 1.0, q=1.0, r=r)
    window = FMSFilterSmoother(2, 1, horizon=9)
    kalman = DelayKalmanFilter(2, 1, max_delay=5, method="augmented")
    for f in (window, kalman):
        f.F, f.H, f.Q, f.R = model.F, model.H, model.Q, model.R
    kalman.P *= 1e6

    def run() -> float:
        worst = 0.0
        for now in range(40):
            delay, place = int(rng.integers(0, 5)), rng.random()
            z = 3.0 * (now - delay + place) + np.sin(now - delay + place)
            for f in (window, kalman):
                f.predict()
                if now >= delay:
                    f.update(z, H=[[1.0, place]], delay=delay)
            if now > 30:
                worst = max(worst, float(np.abs(window.x - kalman.x).max()))
        return worst

    if tolerance is None:
        with pytest.warns(InaccurateGainWarning, match="two designs"):
            run()
    else:
        assert run() < tolerance
