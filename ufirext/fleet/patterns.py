"""Exact gains and covariances of windows by what they hold: the reference engine, once for each pattern."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from .._arrays import Array, readonly
from ..engines.records import Limits, Records, measured
from ..gains import exact_covariance, least_squares
from ..model import Model
from ..window import Row

# Gains are remembered up to this many bytes: patterns recur as they slide over the window.
REMEMBERED_BYTES = 64_000_000

Bools = np.ndarray[Any, np.dtype[np.bool_]]
Ints = np.ndarray[Any, np.dtype[np.integer[Any]]]


class Pattern(NamedTuple):
    """`gain` (dim_x, ages * dim_z) on the rows by age of arrival, newest first, zero where there is none, and
    the age of the oldest row it uses.
    """

    gain: Array
    oldest: int


class Patterns:
    """Gains of a model's windows with holes and late rows, worked out by the reference and remembered."""

    def __init__(self, model: Model, limits: Limits) -> None:
        self.model, self.limits = model, limits
        self._known: dict[bytes, Pattern | None] = {}
        self._bytes = 0

    def find(self, key: bytes, mask: Bools, delays: Ints | None) -> Pattern | None:
        """The pattern of `mask` (ages, dim_z); None where no rows within reach determine the state."""
        key = b"%d:%b" % (len(mask), key)
        if key not in self._known:
            found = self._found(mask, delays)
            if self._bytes > REMEMBERED_BYTES:
                self._known.clear()
                self._bytes = 0
            self._known[key] = found
            self._bytes += len(key) + (0 if found is None else found.gain.nbytes)
        return self._known[key]

    def _found(self, mask: Bools, delays: Ints | None) -> Pattern | None:
        records = self._records(mask, delays)
        rows = records.select(self.limits) if records.rows else None
        if not rows:
            return None
        stack = records.stack(rows, 0)
        columns = least_squares(stack.window)
        gain = np.zeros((self.model.dim_x, *mask.shape))
        for row, start, stop in zip(stack.rows, stack.window.starts, stack.window.starts[1:], strict=False):
            gain[:, -row.arrival, mask[-row.arrival]] = columns[:, start:stop]
        return Pattern(readonly(gain.reshape(len(gain), -1)), max(-row.arrival for row in rows))

    def covariance(self, mask: Bools, delays: Ints | None) -> Array:
        """Exact error covariance of the estimate over all rows of `mask`, aimed at its newest arrival and
        predicted from there.
        """
        model = self.model
        idle = int(np.argmax(mask.any(axis=1))) if self.limits.extends else 0
        records = self._records(mask[idle:], None if delays is None else delays[idle:])
        window = records.stack(records.rows, 0).window
        P = exact_covariance(window, least_squares(window))
        for _ in range(idle):
            P = model.F @ P @ model.F.T + model.Q
        return P

    def _records(self, mask: Bools, delays: Ints | None) -> Records:
        """What arrived `age` ticks ago was taken age + delay ticks ago; now is tick 0."""
        model, records = self.model, Records(self.model.F, self.model.Q)
        for age in range(len(mask) - 1, -1, -1):
            if mask[age].any():
                z = np.where(mask[age], 0.0, np.nan)
                z, H, R, _ = measured(z, model.H, model.R)
                late = 0 if delays is None else int(delays[age])
                records.rows.append(Row(-age - late, -age, H, R, z))
        return records


def groups(mask: Bools, delays: Ints | None) -> Iterator[tuple[bytes, Ints]]:
    """Tracks (last axis) that hold the same rows: a key of the pattern, and the tracks' indices."""
    ages, m, tracks = mask.shape
    if not tracks:
        return
    bits = np.packbits(mask.reshape(ages * m, tracks), axis=0).T
    if delays is not None:
        bits = np.concatenate([bits, np.ascontiguousarray(delays.T, dtype="<i4").view(np.uint8)], axis=1)
    keys = np.ascontiguousarray(bits)
    if (keys == keys[0]).all():
        yield keys[0].tobytes(), np.arange(tracks)
        return
    _, first, inverse = np.unique(
        keys.view(f"V{keys.shape[1]}").reshape(-1), return_index=True, return_inverse=True
    )
    order = np.argsort(inverse, kind="stable")
    for members in np.split(order, np.cumsum(np.bincount(inverse))[:-1]):
        yield keys[first[inverse[members[0]]]].tobytes(), members
