"""horizon="adaptive": the filter of the horizon that foretold the measurements best, whatever comes."""

from __future__ import annotations

import copy
import pickle
from collections import deque

import numpy as np
import pytest
from filterpy.common import Saver, copy_states
from filterpy.kalman import KalmanFilter
from numpy.lib.stride_tricks import sliding_window_view

from ufirext import Model, UFIRFilter, kinematic, ufir_gain
from ufirext.adaptive import BANK

RAMP = kinematic(1, 1, 1.0, q=0.01)
PLANE = kinematic(1, 2, 1.0, q=0.05)
CANDIDATES = BANK  # of a model that two rows determine


def configured(model: Model, horizon: int | str, **options: str):
    f = UFIRFilter(model.dim_x, model.dim_z, horizon=horizon, **options)
    f.x = np.zeros(model.dim_x)
    f.F, f.H, f.Q, f.R = (np.array(matrix) for matrix in (model.F, model.H, model.Q, model.R))
    f.P *= 100.0
    return f


def adaptive(model: Model = RAMP, **options: str):
    return configured(model, "adaptive", **options)


def ramp(rng: np.random.Generator, steps: int, wild: float = 0.1) -> list[float]:
    walk = np.cumsum(np.cumsum(wild * rng.standard_normal(steps)))
    return (walk + rng.standard_normal(steps)).tolist()


def run(f, zs):
    for z in zs:
        f.predict()
        f.update(z)
    return f


class Crowd:
    """The adaptive filter, and one filter of every fixed horizon that goes through the same."""

    def __init__(self, model: Model, **options: str) -> None:
        self.f = adaptive(model, **options)
        self.fixed = {N: configured(model, N, **options) for N in CANDIDATES}

    def __iter__(self):
        yield self.f
        yield from self.fixed.values()

    def predict(self, *args, **more) -> None:
        for f in self:
            f.predict(*args, **more)

    def update(self, *args, **more) -> None:
        for f in self:
            f.update(*args, **more)

    def move(self, delta: np.ndarray) -> None:
        for f in self:
            f.x = f.x + delta

    def assert_published(self) -> None:
        twin = self.fixed[self.f.horizon]
        assert self.f.ready
        np.testing.assert_allclose(self.f.x, twin.x, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(self.f.P, twin.P, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(self.f.G, twin.G, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(self.f.K, twin.K, rtol=1e-8, atol=1e-8)
        assert self.f.rows == twin.rows


def plain(rng, crowd, n, z):
    crowd.predict()
    crowd.update(z)


def losses(rng, crowd, n, z):
    crowd.predict()
    crowd.update(None if rng.random() < 0.3 else z)


def broken_components(rng, crowd, n, z):
    crowd.predict()
    crowd.update(np.where(rng.random(2) < 0.2, np.nan, z))


def inputs(rng, crowd, n, z):
    crowd.predict(rng.standard_normal(), B=np.ones((4, 1)))
    crowd.update(z)


def edits(rng, crowd, n, z):
    crowd.predict()
    if n % 7 == 3:
        crowd.move(rng.standard_normal(4))
    crowd.update(z)
    if n % 11 == 5:
        crowd.move(rng.standard_normal(4))


def changing_model(rng, crowd, n, z):
    step = np.array([[1.0, 0.5 + rng.random()], [0.0, 1.0]])
    for f in crowd:
        f.F = np.kron(np.eye(2), step)
        if n % 10 == 0:
            f.R = (1.0 + n % 3) * np.eye(2)
    crowd.predict()
    crowd.update(z)


def weights(rng, crowd, n, z):
    crowd.predict()
    crowd.update(z, R=(0.1 + rng.random()) * np.eye(2))


def several_rows(rng, crowd, n, z):
    crowd.predict()
    crowd.update(z)
    if n % 3 == 0:
        crowd.update(z + rng.standard_normal(2), R=np.diag([2.0, 0.5]))


STREAMS = (plain, losses, broken_components, inputs, edits, changing_model, weights, several_rows)


@pytest.mark.parametrize("stream", STREAMS, ids=lambda stream: stream.__name__)
def test_the_estimate_is_that_of_the_horizon_in_use(stream):
    rng = np.random.default_rng(3)
    crowd = Crowd(PLANE)
    seen = set()
    zs = np.column_stack([ramp(rng, 70), ramp(rng, 70, 0.5)])
    for n, z in enumerate(zs):
        stream(rng, crowd, n, z)
        if n > 5 and crowd.f.z[0] is not None:
            crowd.assert_published()
            seen.add(crowd.f.horizon)
    assert len(seen) > 1  # or the choice was never put to the test


@pytest.mark.parametrize("window", ["arrivals", "origins"])
def test_late_rows_reach_every_candidate(window):
    rng = np.random.default_rng(5)
    crowd = Crowd(RAMP, window=window)
    for n, z in enumerate(ramp(rng, 60)):
        crowd.predict()
        if n >= 2:
            crowd.update(z, delay=int(rng.integers(0, 3)))
        if n > 10:
            crowd.assert_published()


@pytest.mark.parametrize("missing", ["skip", "predict"])
def test_other_ways_with_missing_rows(missing):
    rng = np.random.default_rng(6)
    crowd = Crowd(RAMP, missing=missing)
    for n, z in enumerate(ramp(rng, 60)):
        crowd.predict()
        crowd.update(None if n % 5 == 4 else z)
        if n > 10 and crowd.f.ready and crowd.fixed[crowd.f.horizon].ready:
            np.testing.assert_allclose(crowd.f.x, crowd.fixed[crowd.f.horizon].x, rtol=1e-8, atol=1e-8)


def test_the_prior_is_the_prediction_of_what_was_published():
    rng = np.random.default_rng(7)
    f = adaptive()
    changes, horizon = 0, None
    for z in ramp(rng, 200, 0.3):
        before = f.x.copy()
        f.predict(0.5, B=np.array([[0.0], [1.0]]))
        np.testing.assert_allclose(f.x_prior, f.F @ before + [0.0, 0.5], rtol=1e-12)
        f.update(z)
        np.testing.assert_allclose(f.y, z - f.H @ f.x_prior, rtol=1e-9, atol=1e-9)
        changes += horizon is not None and f.horizon != horizon
        horizon = f.horizon
    assert changes


class Judge:
    """The rule of choice, naively: forgotten means of squared prediction errors of every fixed horizon."""

    def __init__(self) -> None:
        self.errors: list[list[float]] = []
        self.best = CANDIDATES[len(CANDIDATES) // 2]

    def choice(self) -> int:
        table = np.array(self.errors).reshape(-1, len(CANDIDATES))
        fading = 0.99 ** np.arange(len(table))[::-1]
        if fading.sum() >= 8.0:
            means = fading @ table / fading.sum()
            least = int(np.flatnonzero(means <= means.min() * (1 + 1e-9))[0])
            if means[least] < 0.98 * means[CANDIDATES.index(self.best)]:
                self.best = CANDIDATES[least]
        return self.best


def test_the_choice_is_the_least_prediction_error_at_matched_lead():
    """On time: against H F x^_{n-1}. Late: against H x^ as it stood then. After a gap: per step of lead."""
    rng = np.random.default_rng(8)
    crowd, judge = Crowd(RAMP), Judge()
    stood: deque[list[float]] = deque(maxlen=3)
    gap, chosen = 1, set()
    for n, z in enumerate(ramp(rng, 160, 0.3)):
        crowd.predict()
        foretold = [f.x[0] for f in crowd.fixed.values()]
        delay = 2 if n > 10 and n % 4 == 3 else 0
        if n > 10 and n % 5 == 2:
            crowd.update(None)
            gap += 1
        else:
            if n >= 2:
                value = np.array(stood[-delay] if delay else foretold)
                judge.errors.append(((z - value) ** 2 / gap**2).tolist())
            crowd.update(z, delay=delay)
            assert crowd.f.horizon == judge.best
            gap = 1
            judge.choice()
        chosen.add(judge.best)
        stood.append([f.x[0] for f in crowd.fixed.values()])
    assert len(chosen) > 2


def fixed_errors(model: Model, truth: np.ndarray, zs: np.ndarray, horizon: int) -> np.ndarray:
    """Position errors of full windows, from one product a window; from step horizon - 1 on."""
    gain = ufir_gain(model, horizon).K[0]
    return sliding_window_view(zs, horizon) @ gain - truth[horizon - 1 :]


def manoeuvres(seed: int, length: int, regimes: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Positions of a constant-velocity body whose velocity noise changes from stretch to stretch, and z."""
    rng = np.random.default_rng(seed)
    wild = np.repeat(regimes, length)
    truth = np.cumsum(np.cumsum(wild * rng.standard_normal(len(wild))))
    return truth, truth + rng.standard_normal(len(wild))


def efficiency(seed: int, length: int, regimes: tuple[float, ...], start: int = 60) -> float:
    """Root-mean-square error over that of the fixed horizon which is best in hindsight."""
    truth, zs = manoeuvres(seed, length, regimes)
    f, online = adaptive(), np.empty(len(zs))
    for n, z in enumerate(zs.tolist()):
        f.predict()
        f.update(z)
        online[n] = f.x[0]
    best = min(np.sqrt(np.mean(fixed_errors(RAMP, truth, zs, N)[start - N + 1 :] ** 2)) for N in CANDIDATES)
    return float(np.sqrt(np.mean((online - truth)[start:] ** 2)) / best)


def summary(ratios: list[float]) -> tuple[float, float]:
    """Mean, and its standard error."""
    return float(np.mean(ratios)), float(np.std(ratios, ddof=1) / np.sqrt(len(ratios)))


def test_under_changing_dynamics_it_beats_every_fixed_horizon():
    """Even the one that is best in hindsight, stream by stream; beyond three standard errors."""
    mean, error = summary([efficiency(seed, 300, (0.02, 1.0, 0.1, 2.0)) for seed in range(8)])
    assert mean + 3.0 * error < 1.0


def test_under_steady_dynamics_it_stays_within_1_5_percent_of_the_best_fixed_horizon():
    """Calm to wild, best in hindsight; the error of the mean is so small that 2.5 % would be noticed."""
    ratios = [efficiency(seed, 1500, (wild,), start=300) for wild in (0.1, 0.3, 1.0) for seed in range(4)]
    mean, error = summary(ratios)
    assert 3.0 * error < 0.01
    assert mean < 1.015 + 3.0 * error


def test_the_horizon_follows_the_motion():
    _, zs = manoeuvres(1, 400, (1e-3, 2.0, 1e-3))
    f, horizons = adaptive(), []
    for z in zs.tolist():
        f.predict()
        f.update(z)
        horizons.append(f.horizon)
    assert horizons[399] >= 15
    assert horizons[799] <= 5
    assert horizons[-1] > horizons[799]


@pytest.mark.parametrize("Q", [np.zeros((2, 2)), 1e6 * np.eye(2)], ids=["none", "huge"])
def test_it_needs_no_Q(Q):
    zs = ramp(np.random.default_rng(9), 120)
    f, twin = adaptive(), adaptive()
    twin.Q = Q
    for n, z in enumerate(zs):
        run(f, [z])
        run(twin, [z])
        if n >= 1:
            assert f.ready
            np.testing.assert_allclose(f.x, twin.x, rtol=1e-9, atol=1e-9)
            assert f.horizon == twin.horizon


def test_until_the_rows_suffice_it_is_the_kalman_filter():
    chain = Model(np.eye(4) + np.eye(4, k=1), np.eye(4)[:1], Q=np.eye(4))
    f = adaptive(chain)
    kf = KalmanFilter(4, 1)
    kf.x = np.zeros(4)
    kf.F, kf.H, kf.Q, kf.R, kf.P = (np.array(a) for a in (f.F, f.H, f.Q, f.R, f.P))
    for z in (1.0, 3.0, 2.0):
        for filter_ in (f, kf):
            filter_.predict()
            filter_.update(z)
        assert not f.ready
        np.testing.assert_allclose(f.x, kf.x, rtol=1e-9)
        np.testing.assert_allclose(f.P, kf.P, rtol=1e-9, atol=1e-9)
    run(f, [5.0])
    assert f.ready


def test_a_written_P_holds_for_the_coming_prediction_and_update():
    f = run(adaptive(), ramp(np.random.default_rng(10), 40))
    f.P = 7.0 * np.eye(2)
    f.predict()
    np.testing.assert_allclose(f.P_prior, 7.0 * f.F @ f.F.T + f.Q)
    f.update(1.0)
    twin = configured(RAMP, f.horizon)
    np.testing.assert_allclose(f.P, run(twin, range(40)).P, rtol=1e-9)


def test_losses_longer_than_any_window_and_a_fresh_start():
    rng = np.random.default_rng(11)
    f = run(adaptive(), ramp(rng, 50))
    x = f.x.copy()
    run(f, [None] * 400)
    np.testing.assert_allclose(f.x, np.linalg.matrix_power(RAMP.F, 400) @ x, rtol=1e-9)
    assert not f.ready
    run(f, (5.0 + 3.0 * n for n in range(40)))
    assert f.ready
    np.testing.assert_allclose(f.x, [5.0 + 3.0 * 39, 3.0], rtol=1e-8)


def test_the_end_of_a_gap_does_not_outvote_the_steps_before_it():
    rng = np.random.default_rng(12)
    f = run(adaptive(), ramp(rng, 300, 0.5))
    horizon = f.horizon
    far = f.x[0]
    run(f, [None] * 60)
    run(f, [far])
    run(f, [far + rng.standard_normal()])
    assert abs(CANDIDATES.index(f.horizon) - CANDIDATES.index(horizon)) <= 1


def test_a_model_nobody_sees_coasts():
    f = UFIRFilter(2, 1, horizon="adaptive")
    f.F, f.x = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([1.0, 2.0])
    run(f, range(50))
    assert not f.ready
    assert isinstance(f.horizon, int)
    np.testing.assert_allclose(f.x, [101.0, 2.0])


def test_rows_too_late_for_the_horizon_in_use_are_counted():
    f = run(adaptive(window="origins"), ramp(np.random.default_rng(13), 60, 2.0))
    horizon = f.horizon
    f.predict()
    x = f.x.copy()
    f.update(1e3, delay=horizon)
    assert f.dropped == 1
    np.testing.assert_array_equal(f.x, x)


# -- changing one's mind ----------------------------------------------------------------------------------


@pytest.mark.parametrize("start", [5, "auto"])
def test_from_one_horizon_to_the_bank_keeps_the_window(start):
    rng = np.random.default_rng(14)
    crowd = Crowd(RAMP)
    f = configured(RAMP, start)
    for n, z in enumerate(ramp(rng, 80)):
        if n == 40:
            before = f.x.copy()
            f.horizon = "adaptive"
            assert isinstance(f.horizon, int)
            assert f.ready
            np.testing.assert_array_equal(f.x, before)
        crowd.predict()
        crowd.update(z)
        run(f, [z])
        if n >= 40:
            np.testing.assert_allclose(f.x, crowd.fixed[f.horizon].x, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("goal", [4, 30, 40, "auto"])
def test_from_the_bank_to_one_horizon_keeps_the_window(goal):
    zs = ramp(np.random.default_rng(15), 80)
    f = run(adaptive(), zs[:50])
    before = f.x.copy()
    f.horizon = goal
    np.testing.assert_array_equal(f.x, before)
    assert f.ready
    twin = run(configured(RAMP, goal), zs[:50])
    for z in zs[50:]:
        run(f, [z])
        run(twin, [z])
        assert f.horizon == twin.horizon
        np.testing.assert_allclose(f.x, twin.x, rtol=1e-8, atol=1e-8)


def test_to_the_bank_and_back_before_the_first_row():
    f = configured(RAMP, "auto")
    f.horizon = "adaptive"
    f.horizon = 6
    f.horizon = "adaptive"
    zs = ramp(np.random.default_rng(16), 60)
    np.testing.assert_allclose(run(f, zs).x, run(adaptive(), zs).x)


def test_adaptive_again_changes_nothing():
    zs = ramp(np.random.default_rng(17), 60)
    f, twin = run(adaptive(), zs), run(adaptive(), zs)
    f.horizon = "adaptive"
    assert f.horizon == twin.horizon
    np.testing.assert_array_equal(run(f, zs[:5]).x, run(twin, zs[:5]).x)


def test_a_model_that_needs_longer_windows_gets_other_candidates():
    """A second sensor falls silent: two rows determined the state, now it takes four."""
    F = np.eye(4) + np.eye(4, k=1)
    both, one = np.eye(4)[[0, 2]], np.eye(4)[[0, 0]] * [[1.0], [0.0]]
    rng = np.random.default_rng(18)
    zs = rng.standard_normal((90, 2))
    f = configured(Model(F, both), "adaptive")
    twins = {N: configured(Model(F, both), N) for N in CANDIDATES}
    for n, z in enumerate(zs):
        for filter_ in (f, *twins.values()):
            if n == 30:
                filter_.H = one
            run(filter_, [z])
        if n > 65:
            assert f.horizon > 4
            np.testing.assert_allclose(f.x, twins[f.horizon].x, rtol=1e-6, atol=1e-6)
    assert twins[3].ready


# -- copies and banks -------------------------------------------------------------------------------------


def copied(f):
    twin = adaptive()
    copy_states(twin, f)
    return twin


@pytest.mark.parametrize(
    "clone",
    [copy.deepcopy, lambda f: pickle.loads(pickle.dumps(f)), copied],
    ids=["deepcopy", "pickle", "states"],
)
@pytest.mark.parametrize("steps", [0, 1, 5, 60])
def test_copies_go_on_alone(clone, steps):
    zs = ramp(np.random.default_rng(19), 120)
    f = run(adaptive(), zs[:steps])
    f.predict()
    twin, witness = clone(f), run(adaptive(), zs[:steps])
    run(f, [100.0] * 20)  # what befalls the original is not the copy's business
    witness.predict()
    for other in (twin, witness):
        other.update(zs[60])
        run(other, zs[61:])
    assert twin.horizon == witness.horizon
    np.testing.assert_allclose(twin.x, witness.x, rtol=1e-12)
    np.testing.assert_allclose(twin.P, witness.P, rtol=1e-12)


def test_a_batch_is_the_loop():
    zs = [None if n % 6 == 5 else z for n, z in enumerate(ramp(np.random.default_rng(20), 60))]
    f = adaptive()
    saver = Saver(f)
    means, covariances, means_p, _ = f.batch_filter(zs, saver=saver)
    twin = adaptive()
    for n, z in enumerate(zs):
        twin.predict()
        np.testing.assert_allclose(means_p[n], twin.x, rtol=1e-12)
        twin.update(z)
        np.testing.assert_allclose(means[n], twin.x, rtol=1e-12)
        np.testing.assert_allclose(covariances[n], twin.P, rtol=1e-12)
    saver.to_array()
    np.testing.assert_array_equal(saver.x, means)


def test_previews_change_nothing():
    zs = ramp(np.random.default_rng(21), 60)
    f, twin = run(adaptive(), zs), run(adaptive(), zs)
    f.predict()
    twin.predict()
    x, P = f.get_update(3.0)
    f.get_prediction()
    f.update(3.0)
    twin.update(3.0)
    np.testing.assert_array_equal(x, f.x)
    np.testing.assert_allclose(P, f.P, rtol=1e-12)
    np.testing.assert_array_equal(f.x, twin.x)


def test_columns_and_flat_states_give_the_same_numbers():
    zs = ramp(np.random.default_rng(22), 60)
    f, column = adaptive(), adaptive()
    column.x = np.zeros((2, 1))
    run(f, zs)
    run(column, zs)
    assert column.x.shape == (2, 1)
    np.testing.assert_array_equal(f.x, column.x.ravel())


def test_the_past_of_the_window_in_use_can_be_smoothed():
    zs = ramp(np.random.default_rng(23), 60)
    f = run(adaptive(), zs)
    twin = run(configured(RAMP, f.horizon), zs)
    for lag in (0, 1, 2):
        for mine, its in zip(f.smoothed(lag), twin.smoothed(lag), strict=True):
            np.testing.assert_allclose(mine, its, rtol=1e-8, atol=1e-8)
