"""The streaming filter is windowed least squares, whatever happens on the way."""

from __future__ import annotations

import copy
import pickle
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from tests.naive_filter import NaiveUFIR
from tests.strategies import KINDS, random_model
from ufirext import Model, UFIRFilter, kinematic, ufir_gain
from ufirext.gains import observability_index
from ufirext.window import model_window


@dataclass
class Pair:
    """The filter and its oracle, fed alike."""

    filter: UFIRFilter
    oracle: NaiveUFIR

    def predict(self, known: np.ndarray | None, F: np.ndarray) -> None:
        self.filter.predict(u=known, F=F)
        self.oracle.predict(known, F=F)

    def update(self, z: np.ndarray | None, R: np.ndarray | None = None, delay: int = 0) -> None:
        self.filter.update(z, R=R, delay=delay)
        self.oracle.update(z, R=R, delay=delay)

    def edit(self, delta: np.ndarray) -> None:
        self.filter.x = self.filter.x + delta
        self.oracle.edit(delta)

    def assert_equal(self, step: int) -> None:
        mine, theirs = self.filter, self.oracle
        assert mine.ready == theirs.ready, f"step {step}"
        assert mine.dropped == theirs.dropped, f"step {step}"
        np.testing.assert_allclose(
            mine.x, theirs.x, atol=1e-7 * (1.0 + np.abs(theirs.x).max()), rtol=0, err_msg=f"{step}"
        )
        np.testing.assert_allclose(
            mine.P, theirs.P, atol=1e-7 * (1.0 + np.abs(theirs.P).max()), rtol=0, err_msg=f"{step}"
        )


def pair(model: Model, horizon: int, missing: str, window: str, x0: np.ndarray) -> Pair:
    n = model.dim_x
    f = UFIRFilter(n, model.dim_z, n, horizon=horizon, missing=missing, window=window)
    f.F, f.H, f.Q, f.R, f.B = model.F, model.H, model.Q, model.R, np.eye(n)
    f.x, f.P = x0.copy(), np.eye(n)
    oracle = NaiveUFIR(
        model.F, model.H, model.Q, model.R, x0, np.eye(n), horizon, missing=missing, window=window
    )
    return Pair(f, oracle)


def mishaps(
    rng: np.random.Generator, model: Model, both: Pair, steps: int, loss: float, varying: bool
) -> None:
    """Losses, delays, edits, inputs, weights, NaN components, several rows a step, changing F, copies."""
    n, m = model.dim_x, model.dim_z
    past = [both.oracle.x.copy()]
    for step in range(steps):
        known = rng.normal(size=n) if rng.random() < 0.3 else None
        F = model.F * (1.0 + 0.05 * rng.normal(size=(n, n))) if varying and rng.random() < 0.3 else model.F
        both.predict(known, F)
        past.append(F @ past[-1] + (0.0 if known is None else known))
        if rng.random() < 0.1:
            both.edit(rng.normal(size=n))
        for _ in range(1 + (rng.random() < 0.15)):
            if rng.random() < loss:
                both.update(None)
                continue
            delay = int(rng.integers(0, 5)) if rng.random() < 0.3 else 0
            z = model.H @ past[max(len(past) - 1 - delay, 0)] + rng.normal(size=m)
            if rng.random() < 0.15:
                z[rng.integers(m)] = np.nan
            both.update(z, model.R * rng.uniform(0.3, 3.0) if rng.random() < 0.3 else None, delay)
        if rng.random() < 0.1:
            both.edit(rng.normal(size=n))
        if rng.random() < 0.05:
            both.filter = copy.deepcopy(both.filter)
        elif rng.random() < 0.05:
            both.filter = pickle.loads(pickle.dumps(both.filter))
        both.assert_equal(step)


@pytest.mark.parametrize("missing", ["extend", "skip"])
@pytest.mark.parametrize("window", ["arrivals", "origins"])
@settings(max_examples=20)
@example(
    seed=1925, kind="stable", extra=0, loss=0.0, varying=False
)  # a row older than an input, an edit, a gap
@given(
    seed=st.integers(0, 2**32 - 1),
    kind=st.sampled_from(KINDS),
    extra=st.integers(0, 8),
    loss=st.sampled_from([0.0, 0.2, 0.7]),
    varying=st.booleans(),
)
def test_random_streams_agree_with_naive_least_squares(missing, window, seed, kind, extra, loss, varying):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 5))
    model = random_model(seed, n, int(rng.integers(1, min(n, 3) + 1)), kind)
    nu = observability_index(model)
    assume(nu is not None)
    assume(nu <= n)
    # A window of few rows is what losses leave: it must be well conditioned too.
    assume(model_window(model, nu).condition < 1e3)
    both = pair(model, nu + extra, missing, window, rng.normal(size=n))
    mishaps(rng, model, both, 40, loss, varying)


@given(st.integers(0, 2**32 - 1))
def test_the_order_of_arrival_is_irrelevant(seed):
    """The rows of the last steps come late, in any order: the estimate is that of rows in time."""
    rng = np.random.default_rng(seed)
    model, steps, late = kinematic(1, 2, 1.0, q=0.1), 20, 5
    zs = rng.normal(size=(steps, 2)).cumsum(axis=0)

    def run(order: list[int]) -> np.ndarray:
        f = UFIRFilter(4, 2, horizon=12)
        f.F, f.H, f.Q, f.R = model.F, model.H, model.Q, model.R
        for t in range(steps):
            f.predict()
            if t < steps - late:
                f.update(zs[t])
        for t in order:
            f.update(zs[t], delay=steps - 1 - t)
        return f.x

    in_time = list(range(steps - late, steps))
    np.testing.assert_allclose(run(rng.permutation(in_time).tolist()), run(in_time), atol=1e-11)


@pytest.mark.parametrize("delay", [1, 3])
def test_a_constant_delay_is_the_undelayed_filter_moved_by_F(delay):
    model, zs = kinematic(1, 1, 1.0, q=0.1), np.random.default_rng(0).normal(size=60).cumsum()
    on_time, late = (UFIRFilter(2, 1, horizon=9) for _ in range(2))
    for f in (on_time, late):
        f.F, f.H, f.Q, f.R = model.F, model.H, model.Q, model.R
    history = []
    for t, z in enumerate(zs):
        on_time.predict()
        on_time.update(z)
        history.append(on_time.x)
        late.predict()
        if t >= delay:
            late.update(zs[t - delay], delay=delay)
        if t >= 9 + delay:
            moved = np.linalg.matrix_power(model.F, delay) @ history[t - delay]
            np.testing.assert_allclose(late.x, moved, atol=1e-12 * (1.0 + np.abs(moved).max()))


def test_missing_is_nan_is_absent_bit_for_bit():
    model, rng = kinematic(1, 1, 1.0, q=0.1), np.random.default_rng(0)
    filters = [UFIRFilter(2, 1, horizon=8) for _ in range(3)]
    for f in filters:
        f.F, f.H, f.Q, f.R = model.F, model.H, model.Q, model.R
    for z in rng.normal(size=100).cumsum():
        lost = rng.random() < 0.3
        for f, nothing in zip(filters, (None, np.nan, "no call"), strict=True):
            f.predict()
            if not lost:
                f.update(z)
            elif nothing != "no call":
                f.update(nothing)
        np.testing.assert_array_equal(filters[0].x, filters[1].x)
        np.testing.assert_array_equal(filters[0].x, filters[2].x)
        np.testing.assert_array_equal(filters[0].P, filters[1].P)


@pytest.mark.parametrize("model", [kinematic(1, 1, 1.0, q=0.1), kinematic(2, 2, 0.1)], ids=str)
def test_with_a_full_window_the_stream_is_the_gain_times_the_window(model):
    horizon = 15
    zs = np.random.default_rng(0).normal(size=(80, model.dim_z)).cumsum(axis=0)
    gain = ufir_gain(model, horizon)
    f = UFIRFilter(model.dim_x, model.dim_z, horizon=horizon)
    f.F, f.H, f.Q, f.R = model.F, model.H, model.Q, model.R
    for t, z in enumerate(zs):
        f.predict()
        f.update(z)
        if t >= horizon - 1:
            expected = gain.K @ zs[t - horizon + 1 : t + 1].ravel()
            np.testing.assert_allclose(f.x.ravel(), expected, atol=1e-11 * (1.0 + np.abs(expected).max()))
            np.testing.assert_allclose(f.P, gain.P, rtol=1e-9)


@pytest.mark.parametrize("missing", ["extend", "skip"])
@pytest.mark.parametrize("window", ["arrivals", "origins"])
def test_transitions_are_remembered_as_long_as_rows_lean_on_them(missing, window):
    """F changes at every step, one row comes late, then a gap: sums and look-ups must use the same F."""
    model, rng = kinematic(2, 1, 0.1, q=0.1), np.random.default_rng(0)
    both = pair(model, 14, missing, window, np.zeros(3))
    for step in range(60):
        both.predict(None, model.F * (1.0 + 0.03 * np.sin(step)))
        if 25 <= step < 32:
            both.update(None)
        else:
            both.update(rng.normal(size=1), delay=12 if step == 22 else 0)
        both.assert_equal(step)
