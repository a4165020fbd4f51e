"""The tick of a fleet: one product for all tracks, then the few it does not answer."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from .._array_api import Space
from .._arrays import Array
from ..engines.records import Limits
from ..errors import UfirextError
from ..gains import observability_index, ufir_gain
from ..model import Model
from .history import History
from .irregular import Irregular, covariance_of

# Host bookkeeping of a track that needs nothing of the past.
NOTHING = np.iinfo(np.int64).max
# Tracks that are gathered at once: what they need fits a cache.
BLOCK = 8192


class Engine:
    """History, estimates and bookkeeping of all slots.

    A track is `odd` unless its window is full of plain rows; `needs` is the tick of the oldest row of an odd
    track's last estimate: what came since then is all that later windows and covariances can ask for.
    The last estimates are kept where a track is odd; else the ring gives them again.
    """

    def __init__(self, model: Model, horizon: int, tracks: int, extends: bool) -> None:
        seen = model.H.any(axis=1)
        # A component that sees no state is noise alone; the filter leaves it out.
        self.seen = None if seen.all() else np.flatnonzero(seen)
        self.model = model.replace(H=model.H[seen], R=model.R[np.ix_(seen, seen)])
        index = observability_index(self.model) or 1
        self.limits = Limits(horizon, index + 2, extends, by_arrival=True)
        self.horizon, self.tracks, self.now = horizon, tracks, -1
        self.space: Space | None = None
        self.active = np.ones(tracks, bool)
        self.ready = np.zeros(tracks, bool)
        self.odd = np.ones(tracks, bool)
        self.needs = np.full(tracks, NOTHING)
        self.dropped = np.zeros(tracks, np.int64)

    def begin(self, space: Space) -> None:
        """Memory for the tracks, in the caller's library, device and dtype."""
        self.space = space
        self.history = History(space, self.horizon, self.model.dim_z, self.tracks)
        self.x: Any | None = None
        K = ufir_gain(self.model, self.horizon).K
        self.gain = space.constant(np.concatenate([K, K], axis=1))
        self.F = space.constant(self.model.F.T)

    @cached_property
    def irregular(self) -> Irregular:
        """The solver of tracks with holes and late rows."""
        if self.space is None:
            raise RuntimeError("a fleet has no memory before its first step")
        return Irregular(self.model, self.limits, self.space)

    def __getstate__(self) -> dict[str, Any]:
        # What the solver remembers is found again, and may be large.
        return {name: value for name, value in self.__dict__.items() if name != "irregular"}

    def _nowhere(self, tracks: int) -> Any:
        space: Any = self.space
        return space.xp.full((tracks, self.model.dim_x), np.nan, dtype=space.dtype, **space.placed)

    # -- one tick --------------------------------------------------------------------------------------------

    def step(self, space: Space, z: Any, delay: Array | None) -> Any:
        """Z (tracks, all components) and delays into the rings; the estimates (tracks, dim_x)."""
        xp = space.xp
        whole = space.finite_or_nan(z, "Z")
        here = None if whole else space.host(~xp.isnan(z))
        if not self.active.all():
            given = self.active < (True if here is None else here.any(axis=1))
            if given.any():
                raise UfirextError(
                    f"Z must be NaN in slots without a track, got a measurement in slot "
                    f"{int(np.argmax(given))}: join() begins a track"
                )
        if self.space is None:
            self.begin(space)
        if self.seen is not None:
            z = xp.take(z, space.indices(self.seen), axis=1)
            here = None if here is None else here[:, self.seen]
        if delay is not None:
            z, here, delay = self._drop(space, z, here, delay)
        complete = None if here is None and delay is None else self._complete(here, delay)
        held = None if complete is None else self._last()
        self.now += 1
        self._keep_what_is_needed(complete)
        self.history.write(self.now, z, delay)
        if complete is None and not self.odd.any():
            self.x = None
            return self._product(self.now)
        came = self.active.copy() if here is None else here.any(axis=1)
        self.x = self._answered(self._product(self.now), held, came)
        return space.copy(self.x)

    def _product(self, tick: int) -> Any:
        """Estimates of all tracks from the full window up to a tick, NaN where that has holes."""
        return self.history.product(tick, self.gain)

    def _complete(self, here: Any, delay: Array | None) -> Any:
        """Tracks with a plain row at this tick."""
        on_time = np.ones(self.tracks, bool) if delay is None else delay == 0
        return on_time if here is None else on_time & here.all(axis=1)

    def _drop(self, space: Space, z: Any, here: Any, delay: Array) -> tuple[Any, Any, Array]:
        """Rows that come later than any window reaches are missing, and counted."""
        came = np.ones(self.tracks, bool) if here is None else here.any(axis=1)
        late = came & (delay >= self.limits.reach)
        if late.any():
            self.dropped += late
            nothing = space.xp.asarray(np.nan, dtype=space.dtype, **space.placed)
            z = space.xp.where(space.indices(late[:, None]), nothing, z)
            here = (np.ones(z.shape, bool) if here is None else here) & ~late[:, None]
        return z, here, np.where(came & ~late, delay, 0)

    def _keep_what_is_needed(self, complete: Any) -> None:
        """Put aside what the slot of this tick holds where a track still needs it.

        A track that was plain until now needs its window of the last tick, oldest row now - horizon.
        """
        if not self.limits.extends:
            return
        leaving = self.now - self.horizon
        if complete is not None:
            self.needs[self.active & ~self.odd & ~complete] = leaving
        oldest = NOTHING
        if complete is not None or self.odd.any():
            within = self.needs[self.needs > self.now - self.limits.reach]
            oldest = int(within.min(initial=NOTHING))
        if self.history.older or oldest <= leaving:
            self.history.keep(leaving, oldest)

    def _answered(self, x: Any, held: Any, came: Any) -> Any:
        """x with the tracks whose window is not full of plain rows; `held` are the estimates of the last
        tick, needed where not all `came`.
        """
        space: Any = self.space
        before = self.ready
        self.odd = space.host(space.xp.any(space.xp.isnan(x), axis=1)) & self.active
        self.ready = self.active & ~self.odd
        self.needs[~self.odd] = NOTHING
        solving = self.odd & came if self.limits.extends else self.odd
        if self.limits.extends:
            coasting = self.odd & ~came & before & (self.needs > self.now - self.limits.reach)
            where = np.flatnonzero(coasting)
            if where.size:
                rows = space.indices(where)
                moved = space.xp.matmul(space.xp.take(held, rows, axis=0), self.F)
                x = space.put_rows(x, rows, moved)
                self.ready |= coasting
        return self._solved(x, np.flatnonzero(solving))

    def _solved(self, x: Any, where: Any) -> Any:
        """x with the estimates of these tracks."""
        space: Any = self.space
        size = BLOCK if space.native else max(BLOCK, 1 << 20)
        for block in (where[start : start + size] for start in range(0, len(where), size)):
            rows, oldest = self.irregular.solve(self.history, self.now, block)
            x = space.put_rows(x, space.indices(block), rows)
            found = oldest >= 0
            self.ready[block] = found
            first = self.now - self.limits.reach + 1
            waiting = np.maximum(np.minimum(self.needs[block], self.now), first)
            self.needs[block] = np.where(found, self.now - oldest, waiting)
        return x

    def estimates(self) -> Any:
        """The last estimates again; the caller's own."""
        space = self.space
        if space is None:
            return np.full((self.tracks, self.model.dim_x), np.nan)
        return self._last() if self.x is None else space.copy(self.x)

    def _last(self) -> Any:
        return self._product(self.now) if self.x is None else self.x

    def covariance(self, slots: Any) -> Array:
        """Exact covariances (len(slots), dim_x, dim_x), NaN where a track is not ready."""
        n = self.model.dim_x
        result = np.full((len(slots), n, n), np.nan)
        ready, odd = self.ready[slots], self.odd[slots]
        if (ready & ~odd).any():
            result[ready & ~odd] = ufir_gain(self.model, self.horizon).P
        rest = np.flatnonzero(ready & odd)
        if rest.size:
            tracks = slots[rest]
            batch = self.history.batch(tracks, self.now, self.limits.reach)
            mask, delays = self.irregular.held(batch, np.arange(len(tracks)))
            mask = mask & (np.arange(len(mask))[:, None, None] <= self.now - self.needs[tracks])
            result[rest] = covariance_of(self.irregular.patterns, mask, delays)
        return result

    # -- tracks ----------------------------------------------------------------------------------------------

    def join(self, count: int) -> np.ndarray[Any, np.dtype[np.int64]]:
        """Slots of new tracks: free ones first, then new ones."""
        slots = np.flatnonzero(~self.active)[:count]
        missing = count - len(slots)
        if missing:
            slots = np.concatenate([slots, np.arange(self.tracks, self.tracks + missing)])
            self._widen(self.tracks + missing)
        self.active[slots] = True
        self.odd[slots] = True  # ticks on which a slot stood empty say nothing of its next track
        return slots

    def _widen(self, tracks: int) -> None:
        more = tracks - self.tracks
        for name, value in (
            ("active", False),
            ("ready", False),
            ("odd", True),
            ("needs", NOTHING),
            ("dropped", 0),
        ):
            old = getattr(self, name)
            setattr(self, name, np.concatenate([old, np.full(more, value, dtype=old.dtype)]))
        self.tracks = tracks
        if self.space is not None:
            self.history.widen(tracks)
            if self.x is not None:
                self.x = self.space.xp.concat([self.x, self._nowhere(more)], axis=0)

    def leave(self, slots: Any) -> None:
        """Forget the tracks in these slots."""
        self.active[slots] = self.ready[slots] = False
        self.odd[slots], self.needs[slots], self.dropped[slots] = True, NOTHING, 0
        if self.space is not None:
            self.history.forget(slots)
            if self.x is not None:
                self.x = self.space.put_rows(self.x, self.space.indices(slots), self._nowhere(len(slots)))

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays whose size grows with the tracks."""
        host = (self.active, self.ready, self.odd, self.needs, self.dropped)
        total = sum(array.nbytes for array in host)
        if self.space is not None:
            history = self.history
            aside = [array for slot in history.older.values() for array in slot]
            arrays = (history.values, history.late, history.delays, self.x, *aside)
            total += sum(_bytes(array) for array in arrays if array is not None)
        return total


def _bytes(array: Any) -> int:
    """Bytes of an array of any library."""
    return int(np.prod(array.shape)) * int(
        array.nbytes // max(1, array.size) if hasattr(array, "nbytes") else 8
    )
