"""What every track received in the last ticks: a time-major ring, one slot a tick of arrival.

NaN stands for whatever is not a plain row: nothing came, a component is missing, or the row was late (then it
is in the ring beside). A product of the window with a gain is therefore NaN exactly for the tracks that need
more than this product.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from .._array_api import Space


class Batch(NamedTuple):
    """Rows of some tracks, newest arrival first.

    `values` (ages, dim_z, tracks) is zero where `mask` is False; `delays` (ages, tracks), None where no row
    is late.
    """

    values: Any
    mask: Any
    delays: Any | None


class History:
    """The ring. Slot t % depth holds what arrived at tick t: (depth, dim_z, tracks)."""

    def __init__(self, space: Space, depth: int, dim_z: int, tracks: int) -> None:
        self.space, self.depth, self.dim_z, self.tracks = space, depth, dim_z, tracks
        self.values = self._empty(depth, tracks)
        self.late: Any | None = None  # values of late rows, by tick of arrival
        self.delays: Any | None = None  # ... and their delays, (depth, tracks)

    def _empty(self, depth: int, tracks: int) -> Any:
        space = self.space
        return space.xp.full((depth, self.dim_z, tracks), np.nan, dtype=space.dtype, **space.placed)

    def _none_late(self, depth: int, tracks: int) -> Any:
        xp = self.space.xp
        return xp.zeros((depth, tracks), dtype=xp.int32, **self.space.placed)

    # -- writing ---------------------------------------------------------------------------------------------

    def write(self, tick: int, z: Any, delay: np.ndarray[Any, Any] | None) -> None:
        """What arrived at a tick, z (tracks, dim_z); `delay` (tracks,) where a row is late."""
        space, xp, slot = self.space, self.space.xp, tick % self.depth
        rows = xp.permute_dims(z, (1, 0))
        if delay is not None and self.late is None:
            self.late = self._empty(self.depth, self.tracks)
            self.delays = self._none_late(self.depth, self.tracks)
        if self.late is None:
            self.values = space.put(self.values, slot, rows)
            return
        ages = space.indices(np.zeros(self.tracks, np.int32) if delay is None else delay.astype(np.int32))
        nothing = xp.asarray(np.nan, dtype=space.dtype, **space.placed)
        self.values = space.put(self.values, slot, xp.where(ages > 0, nothing, rows))
        self.late = space.put(self.late, slot, xp.where(ages > 0, rows, nothing))
        self.delays = space.put(self.delays, slot, ages)

    def forget(self, slots: np.ndarray[Any, Any]) -> None:
        """Empty the columns of these tracks."""
        xp = self.space.xp
        gone = np.zeros(self.tracks, bool)
        gone[slots] = True
        where = self.space.indices(gone)
        nothing = xp.asarray(np.nan, dtype=self.space.dtype, **self.space.placed)
        self.values = xp.where(where, nothing, self.values)
        if self.late is not None:
            self.late = xp.where(where, nothing, self.late)

    def widen(self, tracks: int) -> None:
        """Room for more tracks."""
        xp, more = self.space.xp, tracks - self.tracks
        self.values = xp.concat([self.values, self._empty(self.depth, more)], axis=2)
        if self.late is not None:
            self.late = xp.concat([self.late, self._empty(self.depth, more)], axis=2)
            self.delays = xp.concat([self.delays, self._none_late(self.depth, more)], axis=1)
        self.tracks = tracks

    def deepen(self, depth: int, newest: int) -> None:
        """More slots; `newest` is the last tick written."""
        ticks = range(newest - self.depth + 1, newest + 1)
        moves = [(tick % self.depth, tick % depth) for tick in ticks]

        def moved(old: Any, new: Any) -> Any:
            for here, there in moves:
                new = self.space.put(new, there, old[here, ...])
            return new

        self.values = moved(self.values, self._empty(depth, self.tracks))
        if self.late is not None:
            self.late = moved(self.late, self._empty(depth, self.tracks))
            self.delays = moved(self.delays, self._none_late(depth, self.tracks))
        self.depth = depth

    # -- reading ---------------------------------------------------------------------------------------------

    def product(self, newest: int, twice: Any, length: int) -> Any:
        """x (tracks, dim_x) of the window of `length` ticks up to `newest`.

        `twice` (2 length dim_z, dim_x) is the transposed gain, oldest row first, written down twice: in a
        ring as long as the window the slots begin in the middle of it, and one product does.
        """
        m = self.dim_z
        if self.depth == length:
            return self._part(0, length, twice, -(newest + 1) % length)
        first = (newest - length + 1) % self.depth
        count = min(length, self.depth - first)
        x = self._part(first, count, twice, 0)
        if count < length:
            x = x + self._part(0, length - count, twice[count * m :, :], 0)
        return x

    def _part(self, slot: int, count: int, gain: Any, block: int) -> Any:
        xp, m = self.space.xp, self.dim_z
        rows = xp.reshape(self.values[slot : slot + count, ...], (count * m, self.tracks))
        return xp.matmul(xp.permute_dims(rows, (1, 0)), gain[block * m : (block + count) * m, :])

    def batch(self, tracks: np.ndarray[Any, Any], newest: int, ages: int) -> Batch:
        """The rows of some tracks that arrived in the last `ages` ticks."""
        xp, where = self.space.xp, self.space.indices(tracks)
        slots = [(newest - age) % self.depth for age in range(min(ages, self.depth))]

        def rows(ring: Any) -> Any:
            return xp.stack([xp.take(ring[slot, ...], where, axis=-1) for slot in slots])

        values, delays = rows(self.values), None
        mask = ~xp.isnan(values)
        if self.late is not None:
            late = rows(self.late)
            came = ~xp.isnan(late)
            if bool(xp.any(came)):
                values, mask, delays = xp.where(came, late, values), mask | came, rows(self.delays)
                delays = xp.where(xp.any(came, axis=1), delays, xp.zeros_like(delays))
        return Batch(xp.where(mask, values, xp.zeros_like(values)), mask, delays)
