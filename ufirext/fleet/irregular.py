"""Tracks whose window is not full of plain rows: which rows count, and the estimate they give.

The rows are those of `Records.select`: the window's, and older ones, newest first, while the window holds
too few instants or does not determine the state. Three answers, from the usual to the rare: masked normal
equations, a gain for each pattern of the rows that should suffice, and one of all rows within reach.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .._array_api import Space
from .._arrays import Array
from ..engines.records import Limits
from ..model import Model
from ..window import whitener
from .history import Batch, History
from .masked import by_origin, estimates
from .patterns import Ints, Patterns, groups

# Basis lengths are rounded up to powers of two from here on, so that few are needed.
SHORTEST_BASIS = 8


class Irregular:
    """Estimates of some tracks at a time."""

    def __init__(self, model: Model, limits: Limits, space: Space) -> None:
        self.model, self.limits, self.space = model, limits, space
        self.patterns = Patterns(model, limits)
        self.whitener = space.constant(whitener(model.R))
        self.diagonal = np.count_nonzero(model.R) == np.count_nonzero(model.R.diagonal())
        self.wanted = min(limits.horizon, limits.instants) if limits.extends else 0

    def solve(self, history: History, now: int, tracks: Ints) -> tuple[Any, Ints]:
        """x (len(tracks), dim_x), and the ages of the oldest rows used, -1 where x is not determined."""
        space = self.space
        shape = (len(tracks), self.model.dim_x)
        x = space.xp.full(shape, np.nan, dtype=space.dtype, **space.placed)
        oldest = np.full(len(tracks), -1)
        rest = np.arange(len(tracks))
        answers = (self._window, self._extended, self._everything)
        for answer in answers if history.older else answers[:1]:
            if rest.size:
                estimate, ages = answer(history, now, tracks[rest])
                x = space.put_rows(x, space.indices(rest), estimate)
                oldest[rest] = ages
                rest = rest[ages < 0]
        return x, oldest

    def _window(self, history: History, now: int, tracks: Ints) -> tuple[Any, Ints]:
        """The rows that arrived within the horizon, where they are instants enough."""
        xp, horizon = self.space.xp, self.limits.horizon
        batch = history.batch(tracks, now, horizon)
        if not history.older and bool(xp.all(batch.mask == batch.mask[:, :, :1])):
            return self._by_pattern(batch, np.arange(len(tracks)))  # they all began together
        length = horizon if batch.delays is None else horizon + int(xp.max(batch.delays))
        sums, counts = by_origin(batch, self.space, length)
        instants = xp.sum(xp.astype(xp.any(counts > 0.0, axis=1), xp.int32), axis=0)
        enough = self.space.host(instants) >= (self.wanted if history.older else 1)
        return self._solved(batch, sums, counts, enough)

    def _extended(self, history: History, now: int, tracks: Ints) -> tuple[Any, Ints]:
        """Older rows as well, until they are instants enough; late rows are left to the patterns."""
        space, xp, horizon = self.space, self.space.xp, self.limits.horizon
        batch = history.batch(tracks, now, self.limits.reach)
        count = len(tracks)
        nothing = xp.full((count, self.model.dim_x), np.nan, dtype=space.dtype, **space.placed)
        if batch.delays is not None:
            return nothing, np.full(count, -1)
        present = space.host(xp.any(batch.mask, axis=1))
        chosen = np.cumsum(present, axis=0) <= self.wanted
        chosen[:horizon] = True
        spans = _spans(_oldest(present & chosen))
        oldest = np.full(count, -1)
        for span in np.unique(spans).tolist():
            members = np.flatnonzero(spans == span)
            where, ages = space.indices(members), min(span, len(present))
            keep = space.indices(chosen[:ages, None, members])
            mask = xp.take(batch.mask[:ages, ...], where, axis=2) & keep
            values = xp.take(batch.values[:ages, ...], where, axis=2)
            part = Batch(xp.where(mask, values, xp.zeros_like(values)), mask, None)
            sums, counts = by_origin(part, space, span)
            x, oldest[members] = self._solved(part, sums, counts, np.ones(len(members), bool))
            nothing = space.put_rows(nothing, where, x)
        return nothing, oldest

    def _everything(self, history: History, now: int, tracks: Ints) -> tuple[Any, Ints]:
        """All rows within reach; the reference chooses."""
        batch = history.batch(tracks, now, self.limits.reach)
        return self._by_pattern(batch, np.arange(len(tracks)))

    def _solved(self, batch: Batch, sums: Any, counts: Any, enough: Any) -> tuple[Any, Ints]:
        """Normal equations, or patterns where they do not answer well, for the tracks with `enough`."""
        space, xp = self.space, self.space.xp
        x, trusted = estimates(self.model, self.whitener, space, sums, counts)
        some = xp.any(batch.mask, axis=1)
        if not self.diagonal:
            # A part of a row has weights of its own where its components' noises are correlated.
            parts = space.host(xp.any(some & ~xp.all(batch.mask, axis=1), axis=0))
            trusted = trusted & ~parts
        oldest = np.where(trusted & enough, _oldest(space.host(some)), -1)
        rest = np.flatnonzero(enough & ~trusted)
        if rest.size:
            estimate, ages = self._by_pattern(batch, rest)
            x = space.put_rows(x, space.indices(rest), estimate)
            oldest[rest] = ages
        undetermined = space.indices((oldest < 0)[:, None])
        return xp.where(undetermined, xp.asarray(np.nan, dtype=space.dtype, **space.placed), x), oldest

    def _by_pattern(self, batch: Batch, tracks: Ints) -> tuple[Any, Ints]:
        """Exact gains for each pattern of rows."""
        space, xp = self.space, self.space.xp
        where = space.indices(tracks)
        values = xp.reshape(xp.take(batch.values, where, axis=2), (-1, len(tracks)))
        mask, delays = self.held(batch, tracks)
        x = xp.full((len(tracks), self.model.dim_x), np.nan, dtype=space.dtype, **space.placed)
        oldest = np.full(len(tracks), -1)
        for key, members in groups(mask, delays):
            first = members[0]
            late = None if delays is None else delays[:, first]
            pattern = self.patterns.find(key, mask[:, :, first], late)
            if pattern is not None:
                own = space.indices(members)
                across = xp.permute_dims(xp.take(values, own, axis=1), (1, 0))
                x = space.put_rows(x, own, xp.matmul(across, space.constant(pattern.gain.T)))
                oldest[members] = pattern.oldest
        return x, oldest

    def held(self, batch: Batch, tracks: Ints) -> tuple[Any, Any]:
        """What the tracks of a batch hold, on the host: mask (ages, dim_z, tracks), delays (ages, tracks)."""
        host = self.space.host
        mask = host(batch.mask)[:, :, tracks]
        delays = None if batch.delays is None else host(batch.delays)[:, tracks]
        return mask, delays


def _oldest(present: Any) -> Ints:
    """Age of the oldest row of each track (ages, tracks); -1 without any."""
    last = len(present) - 1 - np.argmax(present[::-1], axis=0)
    return np.where(present.any(axis=0), last, -1)


def _spans(oldest: Ints) -> Ints:
    """Powers of two that cover the ages."""
    spans = 1 << np.ceil(np.log2(np.maximum(oldest + 1, SHORTEST_BASIS))).astype(int)
    return np.asarray(spans)


def covariance_of(patterns: Patterns, mask: Any, delays: Any) -> Array:
    """Covariances (tracks, dim_x, dim_x) of the estimates over all rows of the masks."""
    n = patterns.model.dim_x
    result = np.full((mask.shape[2], n, n), np.nan)
    for _, members in groups(mask, delays):
        first = members[0]
        if mask[:, :, first].any():
            late = None if delays is None else delays[:, first]
            result[members] = patterns.covariance(mask[:, :, first], late)
    return result
