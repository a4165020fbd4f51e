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


class Slot(NamedTuple):
    """What arrived at one tick: plain and late rows (dim_z, tracks), and the delays of these (tracks,)."""

    values: Any
    late: Any | None
    delays: Any | None


class History:
    """The ring: slot t % length holds what arrived at tick t, (length, dim_z, tracks). Older ticks that a
    track still needs are kept aside, one by one.
    """

    def __init__(self, space: Space, length: int, dim_z: int, tracks: int) -> None:
        self.space, self.length, self.dim_z, self.tracks = space, length, dim_z, tracks
        self.values = self._empty((length, dim_z, tracks))
        self.late: Any | None = None  # values of late rows, by tick of arrival
        self.delays: Any | None = None  # ... and their delays, (length, tracks)
        self.older: dict[int, Slot] = {}

    def _empty(self, shape: tuple[int, ...]) -> Any:
        space = self.space
        return space.xp.full(shape, np.nan, dtype=space.dtype, **space.placed)

    def _on_time(self, shape: tuple[int, ...]) -> Any:
        return self.space.xp.zeros(shape, dtype=self.space.xp.int32, **self.space.placed)

    @property
    def depth(self) -> int:
        """Ticks it goes back."""
        return self.length + len(self.older)

    # -- writing ---------------------------------------------------------------------------------------------

    def write(self, tick: int, z: Any, delay: np.ndarray[Any, Any] | None) -> None:
        """What arrived at a tick, z (tracks, dim_z); `delay` (tracks,) where a row is late."""
        space, xp, slot = self.space, self.space.xp, tick % self.length
        rows = xp.permute_dims(z, (1, 0))
        if delay is not None and self.late is None:
            self.late = self._empty((self.length, self.dim_z, self.tracks))
            self.delays = self._on_time((self.length, self.tracks))
        if self.late is None:
            self.values = space.put(self.values, slot, rows)
            return
        ages = space.indices(np.zeros(self.tracks, np.int32) if delay is None else delay.astype(np.int32))
        nothing = self._empty(())
        self.values = space.put(self.values, slot, xp.where(ages > 0, nothing, rows))
        self.late = space.put(self.late, slot, xp.where(ages > 0, rows, nothing))
        self.delays = space.put(self.delays, slot, ages)

    def keep(self, tick: int, needed: int) -> None:
        """Put the oldest tick of the ring aside, if it is needed, before its slot is written anew; forget
        those before the tick `needed`.
        """
        for gone in [t for t in self.older if t < needed]:
            del self.older[gone]
        if tick >= needed:
            copies = (None if a is None else self.space.copy(a) for a in self._slot(tick))
            self.older[tick] = Slot(*copies)

    def forget(self, slots: np.ndarray[Any, Any]) -> None:
        """Empty the columns of these tracks."""
        xp = self.space.xp
        gone = np.zeros(self.tracks, bool)
        gone[slots] = True
        where, nothing = self.space.indices(gone), self._empty(())

        def without(rows: Any) -> Any:
            return None if rows is None else xp.where(where, nothing, rows)

        self.values, self.late = without(self.values), without(self.late)
        self.older = {t: Slot(without(s.values), without(s.late), s.delays) for t, s in self.older.items()}

    def widen(self, tracks: int) -> None:
        """Room for more tracks."""
        xp, m, more = self.space.xp, self.dim_z, tracks - self.tracks

        def wider(rows: Any, new: Any) -> Any:
            return None if rows is None else xp.concat([rows, new], axis=-1)

        self.values, self.late = (
            wider(rows, self._empty((self.length, m, more))) for rows in (self.values, self.late)
        )
        self.delays = wider(self.delays, self._on_time((self.length, more)))
        column, none = self._empty((m, more)), self._on_time((more,))
        self.older = {
            t: Slot(wider(s.values, column), wider(s.late, column), wider(s.delays, none))
            for t, s in self.older.items()
        }
        self.tracks = tracks

    # -- reading ---------------------------------------------------------------------------------------------

    def product(self, newest: int, twice: Any) -> Any:
        """x (tracks, dim_x) of the windows up to `newest`.

        `twice` (dim_x, 2 length dim_z) is the gain, oldest row first, written down twice: the oldest row
        lies in the middle of the ring, and a part of it fits the order of the slots.
        """
        xp, count = self.space.xp, self.length * self.dim_z
        rows = xp.reshape(self.values, (count, self.tracks))
        first = (-(newest + 1) % self.length) * self.dim_z
        return xp.permute_dims(xp.matmul(twice[:, first : first + count], rows), (1, 0))

    def batch(self, tracks: np.ndarray[Any, Any], newest: int, ages: int) -> Batch:
        """The rows of some tracks that arrived in the last `ages` ticks."""
        xp, where = self.space.xp, self.space.indices(tracks)
        slots = [self._slot(newest - age) for age in range(min(ages, self.depth))]

        def rows(index: int) -> Any:
            return xp.stack([xp.take(self._part(slot, index), where, axis=-1) for slot in slots])

        values, delays = rows(0), None
        mask = ~xp.isnan(values)
        if self.late is not None:
            late = rows(1)
            came = ~xp.isnan(late)
            if bool(xp.any(came)):
                values, mask, delays = xp.where(came, late, values), mask | came, rows(2)
                delays = xp.where(xp.any(came, axis=1), delays, xp.zeros_like(delays))
        return Batch(xp.where(mask, values, xp.zeros_like(values)), mask, delays)

    def _slot(self, tick: int) -> Slot:
        if tick in self.older:
            return self.older[tick]
        slot = tick % self.length
        late, delays = self.late, self.delays
        return Slot(
            self.values[slot, ...],
            None if late is None else late[slot, ...],
            None if delays is None else delays[slot, ...],
        )

    def _part(self, slot: Slot, index: int) -> Any:
        """A field of a slot; one put aside before the first late row has none."""
        if slot[index] is not None:
            return slot[index]
        return self._empty((self.dim_z, self.tracks)) if index == 1 else self._on_time((self.tracks,))
