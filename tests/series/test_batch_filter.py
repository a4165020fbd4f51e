"""batch_filter of a UFIRFilter takes the fast way, and nobody can tell."""

from __future__ import annotations

import numpy as np
import pytest

from tests.engines.streams import MODELS
from ufirext import BernoulliDelay, FMSFilterSmoother, UFIRFilter
from ufirext.series import hook

STEPS = 2600


def filters(model, horizon, form=2):
    for _ in range(2):
        f = UFIRFilter(model.dim_x, model.dim_z, horizon=horizon)
        f.F, f.H, f.Q, f.R = model.F, model.H, model.Q, model.R
        f.x = np.ones((model.dim_x, 1) if form == 2 else model.dim_x)
        f.P = 50.0 * np.eye(model.dim_x)
        yield f


def series(model, steps=STEPS):
    return np.random.default_rng(0).normal(size=(steps, model.dim_z, 1)).cumsum(axis=0)


def streamed(f, zs):
    """What filterpy's own loop would give."""
    rows = []
    for z in zs:
        f.predict()
        before = f.x.copy(), f.P.copy()
        f.update(z)
        rows.append((f.x.copy(), f.P.copy(), *before))
    return [np.array(part) for part in zip(*rows, strict=True)]


@pytest.mark.parametrize("form", [1, 2])
@pytest.mark.parametrize("name", ["velocity", "plane", "oscillating"])
def test_the_fast_way_gives_the_numbers_of_the_loop(name, form):
    model = MODELS[name]
    quick, slow = filters(model, 20, form)
    zs = series(model)
    for ours, theirs in zip(quick.batch_filter(zs), streamed(slow, zs), strict=True):
        assert ours.shape == theirs.shape
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-11 * np.abs(theirs).max())
    # ... and leaves the same filter behind.
    for f in (quick, slow):
        f.predict()
        f.update(None)
        f.predict()
        f.update(zs[0], delay=3)
    np.testing.assert_allclose(quick.x, slow.x, rtol=0, atol=1e-11 * np.abs(slow.x).max())
    np.testing.assert_allclose(quick.P, slow.P, rtol=1e-9)
    np.testing.assert_allclose(quick.y, slow.y, rtol=0, atol=1e-11 * np.abs(slow.x).max())


def test_masked_measurements_stream():
    model = MODELS["plane"]
    quick, slow = filters(model, 20)
    zs = np.ma.array(series(model))
    zs[1000:1003, 1] = np.ma.masked
    ours, theirs = quick.batch_filter(zs), slow.batch_filter(zs.filled(np.nan))
    for mine, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(mine, other, rtol=0, atol=1e-13 * np.abs(other).max())


def test_the_fast_way_is_taken_only_where_it_is_exact():
    model = MODELS["velocity"]
    zs, nothing = series(model), [None] * 6

    def taken(f, zs=zs, per_step=nothing):
        def stream(part):
            raise InterruptedError

        try:
            return hook.whole_series(f, zs, per_step, stream) is not None
        except InterruptedError:
            return True

    fresh, used = filters(model, 20)
    assert taken(fresh)
    used.predict()
    used.update(1.0)
    assert not taken(used)
    holed = zs.copy()
    holed[5] = np.nan
    again, extended = filters(model, 20)
    assert not taken(again, holed)
    assert not taken(again, [None, *zs])
    assert not taken(again, zs[:300])
    assert not taken(again, zs, [[model.F] * STEPS, *nothing[1:]])
    extended.alpha = 1.01
    assert not taken(extended)


class Own(UFIRFilter):
    """Its verbs may do anything."""


@pytest.mark.parametrize(
    "f",
    [
        Own(2, 1, horizon=20),
        UFIRFilter(2, 1, horizon="adaptive"),
        UFIRFilter(2, 1, horizon=20, max_delay=0),
        UFIRFilter(2, 1, horizon=20, channel=BernoulliDelay(0.9)),
        UFIRFilter(2, 1, horizon=20, missing="skip"),
        FMSFilterSmoother(2, 1, horizon=20),
    ],
    ids=lambda f: repr(f).replace("\n", " ")[:60],
)
def test_filters_that_are_more_than_a_window_stream(f):
    f.F, f.H = MODELS["velocity"].F, MODELS["velocity"].H

    def stream(part):
        raise AssertionError("only a plain window is worked out at once")

    assert hook.whole_series(f, series(MODELS["velocity"]), [None] * 6, stream) is None
