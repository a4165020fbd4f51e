"""The hot path's hands on a ring whose window has holes, weights or late rows: nothing left to look up.

The slots of a ring keep their arrays for good, so that functions may hold views of them. What these functions
do to a ring is what `advance` and `add` do.
"""

from __future__ import annotations

from collections.abc import Callable
from struct import Struct
from struct import error as StructError  # noqa: N812
from typing import Any, NamedTuple

import numpy as np

from .._arrays import Array
from .ring import GROWING_GAINS, Ring
from .slots import NEVER, ORDINARY

__all__ = ["Uneven", "uneven"]

FLOAT = np.dtype(float)
SIZE = FLOAT.itemsize


class Uneven(NamedTuple):
    """What can be done to a window with holes, weights or late rows.

    `skip()` goes on by a slot that stays empty; `lay(z, delay, R, opens)` puts a row into the slot of its
    origin, in a new step where it `opens` one: False, with nothing done, for whatever is not plainly such a
    row or has no slot. `estimate()` gives x, (dim_x, 1) or (dim_x,), and the pattern of the weights it was
    made with, None where that takes the slow path.
    """

    column: bool
    skip: Callable[[], None]
    lay: Callable[[Any, int, Any, bool], bool]
    estimate: Callable[[], tuple[Array, bytes] | None]


def uneven(ring: Ring, column: bool) -> Uneven:
    """The hands on a ring, for one form of x."""
    skip = _skipping(ring)
    return Uneven(column, skip, _laying(ring, skip), _estimating(ring, column))


def _skipping(ring: Ring) -> Callable[[], None]:
    width = ring.free.shape[1] * SIZE
    nothing = bytes(width)
    cells: Any = ring.free.data.cast("B")
    weights, arrivals = ring.weights.data, ring.arrivals.data
    horizon, capacity, by_arrival = ring.limits.horizon, ring.capacity, ring.limits.by_arrival

    def skip() -> None:
        end = ring.end
        spread = ring.spread
        now = ring.base + end
        cells[end * width : (end + 1) * width] = nothing
        weights[end], arrivals[end] = 0.0, NEVER
        ring.irregular = now
        if spread and by_arrival:
            # Rows that arrived a horizon ago leave the working copy, wherever their origins lie.
            bound, last = now - horizon, end + 1 - horizon
            for i in range(last - spread - 1, last):
                if arrivals[i] == bound:
                    weights[i] = 0.0
                    cells[i * width : (i + 1) * width] = nothing
        ring.end = end + 1
        if end + 1 == capacity:
            ring.compact()

    return skip


def _laying(ring: Ring, skip: Callable[[], None]) -> Callable[[Any, int, Any, bool], bool]:
    m = ring.free.shape[1]
    width = m * SIZE
    numbers, weigh = _numbers(m), _weighing(ring.plan.model.R)
    pack_into = Struct(f"{m}d").pack_into
    cells = ring.free.data.cast("B")
    weights, arrivals = ring.weights.data, ring.arrivals.data

    def lay(z: Any, delay: int, R: Any, opens: bool) -> bool:
        values = numbers(z)
        weight = 1.0 if R is None else weigh(R)
        if values is None or weight is None:
            return False
        i = ring.end - delay if opens else ring.end - delay - 1
        if delay:
            # A row later than any before moves the window's end: that is not for the hot path.
            begin = ring.begin
            if not 0 < delay <= ring.spread or begin is None or ring.base + i < begin:
                return False
        if (delay or not opens) and arrivals[i] != NEVER:
            return False
        before = ring.irregular
        if opens:
            skip()
            i = ring.end - 1 - delay
        now = ring.base + ring.end - 1
        if weight == 1.0:
            pack_into(cells, i * width, *values)
            if not delay and opens:
                ring.irregular = before
        else:
            ring.keep_raw()
            ring.noise[now - delay] = R.tobytes() if R.__class__ is np.ndarray else FLOAT.type(R).tobytes()
            pack_into(cells, i * width, *[weight * value for value in values])
            ring.irregular = now
        if delay:
            ring.irregular = now
        if ring.raw is not None:
            pack_into(ring.raw, i * width, *values)
        weights[i], arrivals[i], ring.newest_age = weight, now, delay
        return True

    return lay


def _numbers(m: int) -> Callable[[Any], tuple[float, ...] | None]:
    """The components of a finite z in one of filterpy's forms, None for anything else."""
    unpack = Struct(f"{m}d").unpack

    def numbers(z: Any) -> tuple[float, ...] | None:
        if z.__class__ is not np.ndarray:
            return (float(z),) if m == 1 and isinstance(z, float) and z - z == 0.0 else None
        if z.dtype is not FLOAT or z.ndim > 2:
            return None
        try:
            values: tuple[float, ...] = unpack(z)
        except StructError:  # another size
            return None
        except ValueError:  # not contiguous
            return numbers(z.copy()) if z.size == m else None
        total = sum(values)
        return values if total - total == 0.0 else None

    return numbers


def _weighing(R: Array) -> Callable[[Any], float | None]:
    """w where R_row = R / w; None for whatever is not plainly so, or far from 1."""
    m, base = len(R), R.ravel().tolist()
    unpack = Struct(f"{m * m}d").unpack
    first, zeros = base[0], m * m - m
    isotropic = base[:: m + 1].count(first) == m and base.count(0.0) == zeros

    def weigh(given: Any) -> float | None:
        if given.__class__ is not np.ndarray:
            values = (given,) if m == 1 and isinstance(given, float) else None
        elif given.dtype is FLOAT and (given.shape == R.shape or (m == 1 and given.ndim < 3)):
            try:
                values = unpack(given)
            except (StructError, ValueError):
                return None
        else:
            return None
        if values is None or not values[0] > 0.0:
            return None
        weight = first / values[0]
        if not (isotropic and values[:: m + 1].count(values[0]) == m and values.count(0.0) == zeros):
            for ours, theirs in zip(base, values, strict=True):
                gap = ours - weight * theirs
                if not abs(gap) <= 1e-15 * abs(ours):
                    return None
        return weight if 1.0 / ORDINARY < weight < ORDINARY else None

    return weigh


def _estimating(ring: Ring, column: bool) -> Callable[[], tuple[Array, bytes] | None]:
    m, horizon = ring.free.shape[1], ring.limits.horizon
    least = min(horizon, ring.limits.instants)
    flat = ring.free.reshape(-1)
    spread, span, solve = -1, 0, _unsolved
    views: list[tuple[Array, Array] | None] = []

    def view(end: int) -> tuple[Array, Array]:
        z = flat[(end - span) * m : end * m]
        return ring.weights[end - span : end], z.reshape(-1, 1) if column else z

    def resize(wanted: int) -> None:
        nonlocal span, solve, views
        if wanted != span:
            span, solve = wanted, ring.plan.basis(wanted).solver(column)
            views = [None] * (ring.capacity + 1)

    def grown() -> tuple[Array, bytes] | None:
        end, length = ring.end, ring.length
        gain = ring.plan.gain(length)
        z = flat[(end - length) * m : end * m]
        x = None if gain is None else gain.dot(z.reshape(-1, 1) if column else z)
        return None if x is None else (x, ring.weights[end - length : end].tobytes())

    def reached() -> tuple[Array, bytes] | None:
        found = None if ring.spread else ring.reached()
        if found is None:
            return None
        x, key, _ = found
        return (x.reshape(-1, 1) if column else x), key

    def estimate() -> tuple[Array, bytes] | None:
        nonlocal spread
        end = ring.end
        if span < horizon or ring.spread != spread:
            length, spread = ring.length, ring.spread
            if length <= GROWING_GAINS and ring.plain:
                return grown()
            resize(ring.span(length))
        found = views[end]
        if found is None:
            found = views[end] = view(end)
        weights, free = found
        if np.count_nonzero(weights) < least and ring.now - ring.length >= (ring.begin or 0):
            return reached()
        x = solve(weights, free)
        return None if x is None else (x, weights.tobytes())

    return estimate


def _unsolved(weights: Array, free: Array) -> Array | None:
    return None
