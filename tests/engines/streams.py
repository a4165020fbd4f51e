"""Random streams of everything that may happen to a filter, and the reference they are played to as well."""

from __future__ import annotations

import copy
import pickle

import numpy as np

from ufirext import Model, UFIRFilter, kinematic
from ufirext.engines.records import Records

MODELS = {
    "velocity": kinematic(1, 1, 1.0, q=0.1, r=4.0),
    "plane": kinematic(1, 2, 0.5, q=0.1, r=4.0),
    "acceleration": kinematic(2, 1, 1.0, q=0.01, r=1.0),
    "oscillating": Model([[0.9, 0.4], [-0.4, 0.9]], [[1.0, 0.0]], Q=0.1, R=1.0),
    "unstable": Model([[1.05, 0.2], [0.0, 0.9]], [[1.0, 0.0]], Q=0.1, R=1.0),
    "delayed": Model([[1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]], Q=0.1, R=1.0),
}


def reference(model, horizon, **options):
    """A UFIRFilter that never leaves the records."""
    f = fresh(model, horizon, **options)
    f._state._regular = lambda F, Q: False
    f._state._general = lambda F, Q: Records(F, Q, f._state.now)
    return f


def fresh(model, horizon, **options):
    """A UFIRFilter of the model."""
    f = UFIRFilter(model.dim_x, model.dim_z, horizon=horizon, **options)
    f.F, f.H, f.Q, f.R, f.B = model.F, model.H, model.Q, model.R, np.eye(model.dim_x)
    f.P = 10.0 * np.eye(model.dim_x)
    return f


class Stream:
    """Plays the same events to several filters; `chances` maps an event to its probability per step."""

    def __init__(self, model, filters, rng, chances):
        self.model, self.filters, self.rng, self.chances = model, list(filters), rng, chances
        self.truth = [rng.normal(size=model.dim_x)]

    def happens(self, event):
        return self.rng.random() < self.chances.get(event, 0.0)

    def step(self):
        model, rng = self.model, self.rng
        u = rng.normal(size=model.dim_x) if self.happens("input") else None
        F = model.F + 0.02 * rng.normal(size=model.F.shape) * (model.F != 0) if self.happens("F") else None
        self.each(lambda f: f.predict(u, F=F))
        x = (model.F if F is None else F) @ self.truth[-1] + 0.1 * rng.normal(size=model.dim_x)
        self.truth.append(x if u is None else x + u)
        self.edit("edit before")
        if not self.happens("skip"):
            self.measure()
            if self.happens("again"):
                self.measure()
        self.edit("edit")
        if self.happens("copy"):
            self.filters[0] = copy.deepcopy(self.filters[0])
        if self.happens("pickle"):
            self.filters[0] = pickle.loads(pickle.dumps(self.filters[0]))

    def measure(self):
        model, rng = self.model, self.rng
        if self.happens("lost"):
            self.each(lambda f: f.update(None))
            return
        delay = min(int(rng.integers(1, 4)), len(self.truth) - 1) if self.happens("late") else 0
        z = model.H @ self.truth[-1 - delay] + rng.normal(size=model.dim_z)
        if self.happens("component"):
            z[rng.integers(model.dim_z)] = np.nan
        R = model.R * rng.uniform(0.3, 3.0) if self.happens("weight") else None
        H = model.H * 2.0 if self.happens("H") else None
        self.each(lambda f: f.update(z, R, H, delay=delay))

    def edit(self, event):
        if not self.happens(event):
            return
        delta = self.rng.normal(size=self.filters[0].x.shape)
        inplace = self.rng.random() < 0.5

        def change(f):
            if inplace:
                f.x[:] += delta
            else:
                f.x = f.x + delta

        self.each(change)

    def each(self, verb):
        for f in self.filters:
            verb(f)
