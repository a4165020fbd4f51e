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
        alike = batch.delays is None and bool(xp.all(batch.mask == batch.mask[:, :, :1]))
        if alike and not history.older:
            return self._by_pattern(batch, np.arange(len(tracks)))  # they all began together
        length = horizon if batch.delays is None else horizon + int(xp.max(batch.delays))
        sums, counts = by_origin(batch, self.space, length)
        instants = xp.sum(xp.astype(xp.any(counts > 0.0, axis=1), xp.int32), axis=0)
        enough = self.space.host(instants) >= (self.wanted if history.older else 1)
        return self._solved(batch, sums, counts, enough)

    def _extended(self, history: History, now: int, tracks: Ints) -> tuple[Any, Ints]:
        """Older rows as well, newest first, until they are instants enough."""
        space, xp = self.space, self.space.xp
        batch = history.batch(tracks, now, self.limits.reach)
        mask, delays = self.held(batch, np.arange(len(tracks)))
        present = mask.any(axis=1)
        chosen = self._chosen(present, delays)
        spans = _spans(_oldest(present & chosen))
        x = xp.full((len(tracks), self.model.dim_x), np.nan, dtype=space.dtype, **space.placed)
        oldest = np.full(len(tracks), -1)
        for span in np.unique(spans).tolist():
            members = np.flatnonzero(spans == span)
            part = self._part(batch, members, chosen[:span])
            late = 0 if delays is None else int(delays[:span, members].max())
            length = int(_spans(np.array(part.mask.shape[0] - 1 + late)))
            sums, counts = by_origin(part, space, length)
            rows, oldest[members] = self._solved(part, sums, counts, np.ones(len(members), bool))
            x = space.put_rows(x, space.indices(members), rows)
        return x, oldest

    def _chosen(self, present: Any, delays: Any) -> Any:
        """Which rows (ages, tracks) count: the window's, and older ones while there are too few instants."""
        fresh = present
        if delays is not None:
            fresh, tracks = np.zeros_like(present), np.arange(present.shape[1])
            seen = np.zeros((len(present) + int(delays.max()), len(tracks)), bool)
            for age, came in enumerate(present):
                origin = age + delays[age]
                fresh[age] = came & ~seen[origin, tracks]
                seen[origin[came], tracks[came]] = True
        newer = np.cumsum(fresh, axis=0) - fresh
        chosen = newer < self.wanted
        chosen[: self.limits.horizon] = True
        return chosen

    def _part(self, batch: Batch, tracks: Ints, chosen: Any) -> Batch:
        """Some tracks of a batch, and of their rows those chosen."""
        space, xp = self.space, self.space.xp
        where, ages = space.indices(tracks), len(chosen)
        mask = xp.take(batch.mask[:ages, ...], where, axis=2) & space.indices(chosen[:, None, tracks])
        values = xp.take(batch.values[:ages, ...], where, axis=2)
        delays = None if batch.delays is None else xp.take(batch.delays[:ages, ...], where, axis=1)
        if delays is not None:
            delays = xp.where(xp.any(mask, axis=1), delays, xp.zeros_like(delays))
        return Batch(xp.where(mask, values, xp.zeros_like(values)), mask, delays)

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
