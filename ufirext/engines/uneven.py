"""The hot path's hands on a ring whose window has holes, weights or late rows: nothing left to look up.

The slots of a ring keep their arrays for good, so that functions may hold views of them. What these functions
do to a ring is what `advance` and `add` do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from struct import Struct
from typing import Any

import numpy as np

from .._arrays import FLOAT, Array
from .basis import Memory, Solve
from .lean import intake
from .lean import numbers as numbers_of
from .records import Solution
from .ring import GROWING_GAINS, Ring
from .slots import NEVER, ORDINARY

__all__ = ["REGULAR", "Point", "Uneven", "uneven"]

ARRAY = np.ndarray
SIZE = FLOAT.itemsize
# What became of a row: nothing was done; it has its slot; and so has every one of the last horizon.
REFUSED, LAID, REGULAR = 0, 1, 2
# Weight of a row with the model's R.
PLAIN: tuple[float, bytes | None] = (1.0, None)


Point = tuple[Array, bytes | Solution, int, int]
"""An estimate: x, (dim_x, 1) or (dim_x,); the pattern of its weights, or all that is known of it; its step;
the age of its newest row."""


@dataclass(frozen=True, slots=True)
class Uneven:
    """What can be done to a window with holes, weights or late rows.

    `step(True)` goes on by a slot that stays empty; `lay(z, delay, R, opens)` puts a row into the slot of its
    origin, in a new step where it `opens` one: REFUSED, with nothing done, for whatever is not plainly such a
    row or has no slot. `estimate()` gives the newest point, None where that takes the slow path.
    """

    column: bool
    step: Callable[[bool], None]
    lay: Callable[[Any, int, Any, bool], int]
    estimate: Callable[[], Point | None]


def uneven(ring: Ring, column: bool) -> Uneven:
    """The hands on a ring, for one form of x."""
    step = _opening(ring)
    return Uneven(column, step, _laying(ring, step), _estimating(ring, column))


def _opening(ring: Ring) -> Callable[[bool], None]:
    """opens(empty): a new slot, for a row that comes at once or for none."""
    width = ring.free.shape[1] * SIZE
    nothing = bytes(width)
    cells: Any = ring.free.data.cast("B")
    weights: Any = ring.weights.data
    arrivals: Any = ring.arrivals.data
    horizon, capacity, by_arrival = ring.limits.horizon, ring.capacity, ring.limits.by_arrival

    def opens(empty: bool) -> None:
        end, spread = ring.end, ring.spread
        if empty:
            cells[end * width : (end + 1) * width] = nothing
            weights[end], arrivals[end] = 0.0, NEVER
            ring.irregular = ring.opened_empty = ring.base + end
        ring.end = end + 1
        if spread and by_arrival:
            # Rows that arrived a horizon ago leave the working copy, wherever their origins lie.
            bound, last = ring.base + end - horizon, end + 1 - horizon
            for i in range(last - spread - 1, last):
                if arrivals[i] == bound:
                    weights[i] = 0.0
                    cells[i * width : (i + 1) * width] = nothing
        if end + 1 == capacity:
            ring.compact()

    return opens


def _laying(ring: Ring, step: Callable[[bool], None]) -> Callable[[Any, int, Any, bool], int]:
    m, horizon = ring.free.shape[1], ring.limits.horizon
    put, numbers, weigh = intake(ring), numbers_of(m), _weighing(ring.plan.model.R)
    cells: Any = ring.free.reshape(-1).data
    weights: Any = ring.weights.data
    arrivals: Any = ring.arrivals.data
    capacity = ring.capacity
    raw: Array | None = None
    copies: Any = None  # cells of `raw`

    def lay(z: Any, delay: int, R: Any, opens: bool) -> int:
        nonlocal raw, copies
        # Slots ahead are plain rows; without a late past, nothing leaves but with its slot.
        ahead = opens and not delay and ring.raw is None
        if ahead and R is None:
            if not put(z):
                return REFUSED
            ring.newest_age = 0
            return REGULAR if ring.base + ring.end - 1 - ring.irregular >= horizon else LAID
        values = numbers(z)
        weighed = PLAIN if R is None else weigh(R)
        if values is None or weighed is None:
            return REFUSED
        weight, noise = weighed
        if ahead and noise is not None:
            end = ring.end
            at = end * m
            for value in values:
                cells[at] = weight * value
                at += 1
            weights[end] = weight
            ring.irregular = now = ring.base + end
            ring.weighted[now] = noise, values
            ring.newest_age, ring.end = 0, end + 1
            if end + 1 == capacity:
                ring.compact()
            return LAID
        if delay or not opens:
            i = ring.end - delay - (not opens)
            # A row later than any before moves the window's end: that is not for the hot path.
            if not 0 <= delay <= ring.spread or ring.base + i < ring.begin or arrivals[i] != NEVER:  # type: ignore[operator]
                return REFUSED
        if opens:
            step(delay > 0)
        if delay > ring.spread:  # the buffer has just moved and forgotten a late past
            ring.widen(delay)
        i = ring.end - 1
        now = ring.base + i
        i -= delay
        if noise is not None:
            ring.weighted[now - delay] = noise, values
        at = i * m
        for value in values:
            cells[at] = weight * value
            at += 1
        if ring.raw is not raw:
            raw = ring.raw
            copies = None if raw is None else raw.reshape(-1).data
        if copies is not None:
            at = i * m
            for value in values:
                copies[at] = value
                at += 1
        weights[i], arrivals[i], ring.newest_age = weight, now, delay
        if delay or noise is not None:
            ring.irregular = now
            return LAID
        return REGULAR if now - ring.irregular >= horizon else LAID

    return lay


def _weighing(R: Array) -> Callable[[Any], tuple[float, bytes | None] | None]:
    """w where R_row = R / w, and the bytes of R_row where it is another; None for whatever is not plainly so,
    or far from 1.
    """
    m, shape, base = len(R), R.shape, R.ravel().tolist()
    unpack: Callable[[bytes], tuple[float, ...]] = Struct(f"{m * m}d").unpack
    first = base[0]
    # A multiple of the unit matrix, after its first number.
    below: tuple[float, ...] = (0.0,) * m
    isotropic = base[1:] == [*below, first] * (m - 1)

    def weigh(given: Any) -> tuple[float, bytes | None] | None:
        if given.__class__ is ARRAY and given.dtype is FLOAT and given.shape == shape:
            noise = given.tobytes()
        elif m == 1 and isinstance(given, float):
            noise = FLOAT.type(given).tobytes()
        else:
            return None
        numbers = unpack(noise)
        variance = numbers[0]
        if not variance > 0.0:
            return None
        weight = first / variance
        if not (isotropic and numbers[1:] == (*below, variance) * (m - 1)):
            for ours, theirs in zip(base, numbers, strict=True):
                if not abs(ours - weight * theirs) <= 1e-15 * abs(ours):
                    return None
        if weight == 1.0:
            return PLAIN
        return (weight, noise) if 1.0 / ORDINARY < weight < ORDINARY else None

    return weigh


def _estimating(ring: Ring, column: bool) -> Callable[[], Point | None]:
    m, horizon, least = ring.free.shape[1], ring.limits.horizon, ring.least
    flat = ring.free.reshape(-1)
    spread, span, full = -1, 0, -1
    views: list[tuple[Array, Array] | None] = []
    memory: Memory | None = None  # where patterns recur
    solve: Solve = _unsolved
    weigh: Solve = _unsolved  # where every slot has its row
    enough = -1  # step up to which the window cannot have fewer than the least rows

    def resize(wanted: int) -> None:
        nonlocal span, views, memory, solve, weigh
        found = ring.memory(wanted)
        memory = found if found.recalls else None
        if wanted != span:
            basis = ring.plan.basis(wanted)
            span, views = wanted, [None] * (ring.capacity + 1)
            solve, weigh = basis.solver(column), basis.solver(column, holes=False)

    def view(end: int) -> tuple[Array, Array]:
        z = flat[(end - span) * m : end * m]
        views[end] = found = ring.weights[end - span : end], z.reshape(-1, 1) if column else z
        return found

    def point(x: Array, weights: bytes) -> Point:
        return x, weights, ring.now, ring.newest_age

    def grown(length: int) -> Point | None:
        gain, end = ring.plan.gain(length), ring.end
        z = flat[(end - length) * m : end * m]
        x = None if gain is None else gain.dot(z.reshape(-1, 1) if column else z)
        return None if x is None else point(x, ring.weights[end - length : end].tobytes())

    def few(weights: Array, free: Array) -> Point | None:
        if ring.now - ring.length < (ring.begin or 0):
            x = solve(weights, free)
            return None if x is None else point(x, weights.tobytes())
        found = None if ring.spread else ring.reached()
        return None if found is None else point(found[0].reshape(-1, 1) if column else found[0], found[1])

    def estimate() -> Point | None:
        nonlocal spread, full, enough
        end = ring.end
        if span != full or ring.spread != spread:
            length, spread, full, enough = ring.length, ring.spread, horizon + ring.overhang, -1
            if length <= GROWING_GAINS and ring.plain:
                return grown(length)
            resize(ring.span(length))
        weights, free = views[end] or view(end)
        key, now = weights.tobytes(), ring.base + end - 1
        if memory is not None and not ring.weighted:
            product = memory.known.get(key) or memory.recall(key)
            if product is not None:
                return product(free), key, now, ring.newest_age
        if now > enough:
            spare = int(np.count_nonzero(weights)) - least
            if spare < 0:
                return few(weights, free)
            enough = now + spare // (spread + 1)  # no more leave in a step
        x = (solve if spread or now - ring.opened_empty < span else weigh)(weights, free)
        return None if x is None else (x, key, now, ring.newest_age)

    return estimate


def _unsolved(weights: Array, free: Array) -> Array | None:
    return None
