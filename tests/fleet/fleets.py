"""Random measurements of many tracks, and the filters that a fleet must agree with, one a track."""

from __future__ import annotations

import numpy as np

from tests.engines.streams import fresh
from ufirext import Fleet


class Traffic:
    """Wandering targets of one model, measured with what a network does to measurements."""

    def __init__(self, model, tracks, steps, seed=0, *, lost=0.0, component=0.0, late=0.0):
        rng = np.random.default_rng(seed)
        states = np.empty((steps, tracks, model.dim_x))
        x = rng.normal(size=(tracks, model.dim_x))
        for n in range(steps):
            x = x @ model.F.T + 0.1 * rng.normal(size=x.shape)
            states[n] = x
        ages = np.where(rng.random((steps, tracks)) < late, rng.integers(1, 5, (steps, tracks)), 0)
        self.delays = np.minimum(ages, np.arange(steps)[:, None])
        taken = np.arange(steps)[:, None] - self.delays
        seen = states[taken, np.arange(tracks)] @ model.H.T
        self.Z = seen + rng.normal(size=seen.shape)
        self.Z[rng.random((steps, tracks)) < lost] = np.nan
        self.Z[rng.random(self.Z.shape) < component] = np.nan


class Peers:
    """One UFIRFilter a track."""

    def __init__(self, model, horizon, tracks, **options):
        self.filters = [fresh(model, horizon, **options) for _ in range(tracks)]

    def step(self, Z, delay=None):
        for s, f in enumerate(self.filters):
            f.predict()
            came = not np.isnan(Z[s]).all()
            f.update(Z[s] if came else None, delay=0 if delay is None else int(delay[s]))

    @property
    def ready(self):
        return np.array([f.ready for f in self.filters])

    @property
    def x(self):
        return np.array([f.x.ravel() if f.ready else np.full(f.dim_x, np.nan) for f in self.filters])

    @property
    def P(self):
        return np.array([f.P if f.ready else np.full((f.dim_x, f.dim_x), np.nan) for f in self.filters])


def assert_close(ours, theirs, tolerance):
    """Equal relative to the largest number of each track, NaN in the same places."""
    ours, theirs = np.asarray(ours), np.asarray(theirs)
    assert ours.shape == theirs.shape
    np.testing.assert_array_equal(np.isnan(ours), np.isnan(theirs))
    axes = tuple(range(1, theirs.ndim))
    size = np.nanmax(np.abs(theirs), axis=axes, keepdims=True, initial=1e-300)
    assert np.nanmax(np.abs(ours - theirs) / size, initial=0.0) <= tolerance


def play(model, horizon, traffic, missing="extend"):
    """Fleet and filters through the same traffic, compared at every tick."""
    steps, tracks = traffic.Z.shape[:2]
    fleet, peers = (
        Fleet(model, horizon, tracks, missing=missing),
        Peers(model, horizon, tracks, missing=missing),
    )
    late = traffic.delays.any()
    for n in range(steps):
        delay = traffic.delays[n] if late else None
        X = fleet.step(traffic.Z[n], delay)
        peers.step(traffic.Z[n], delay)
        np.testing.assert_array_equal(fleet.ready, peers.ready)
        assert_close(X, peers.x, 1e-12)
        if n % 9 == 0:
            assert_close(fleet.covariance(), peers.P, 1e-9)
    return fleet
