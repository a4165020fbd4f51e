"""Sums over a window that start at its oldest row: for models that forget or grow within a window.

Coordinates as in `frames`. A block has a boundary t. Rows after it are summed up in the frame of x_f, f <= t
(forward products only); rows up to t are kept as a table of suffixes, each in the frame of its oldest origin,
built by backward recursion. A window is one suffix and the sum. While a block serves, the next one's table is
built row by row, so that no step is long.
"""

from __future__ import annotations

from collections.abc import Callable
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from .._arrays import Array
from .._lapack import cholesky_solver
from .._rounding import carried_rounding, drowned
from ..window import Row, well_scaled
from .records import Limits, Records

# A scaled pivot below this: the normal equations would lose too much. What comes next is slow but exact.
WEAK_PIVOT = 0.03
# Transitions that grow beyond this over a window make start-referenced sums lose digits: likewise.
GROWTH = 1e4
# Two blocks are kept for one part in so many of the steps, in which the table of the next one is built.
OVERLAP = 8


class Suffix(NamedTuple):
    """Sum of the grams of the rows after a bound, up to the boundary, in the frame of x_a; Phi(f, a); and
    what rounding may have left on the diagonal of the sum.
    """

    sum: Array
    lead: Array
    rounding: Array


class Block:
    """A boundary t, the sum of what came after it, and the suffixes before it."""

    def __init__(self, boundary: int, frame: int, dim_x: int) -> None:
        self.boundary, self.frame = boundary, frame
        self.sum = np.zeros((dim_x + 1, dim_x + 1))
        self.products = [np.eye(dim_x + 1)]  # Phi(frame + j, frame)
        self.suffixes = [Suffix(self.sum.copy(), self.products[0], np.zeros(dim_x + 1))]
        self.oldest = frame

    def advance(self, E: Array) -> None:
        """One more transition."""
        self.products.append(E.dot(self.products[-1]))

    def move(self, delta: Array) -> None:
        """x of now was moved by delta."""
        moved = self.products[-1].copy()
        moved[:-1, -1] += delta
        self.products[-1] = moved

    def add(self, origin: int, gram: Array) -> None:
        """The gram of a row after the boundary."""
        product = self.products[origin - self.frame]
        self.sum += product.T.dot(gram.dot(product))

    def window(self, bound: int) -> tuple[Array, Array, Array]:
        """The rows after `bound`: their sum in the frame of their oldest state, Phi from it to now, and what
        rounding may have left on the diagonal of the sum.
        """
        older, lead, rounding = self.suffixes[self.boundary - bound]
        rounding = rounding + carried_rounding(lead, self.sum, np.zeros(len(lead)))
        return older + lead.T.dot(self.sum.dot(lead)), self.products[-1].dot(lead), rounding

    def lengthen(self, rows: list[Row], records: Records) -> None:
        """One more suffix: the rows of the next older step join, in the frame of the oldest origin."""
        total, lead, rounding = self.suffixes[-1]
        for row in rows:
            while self.oldest > row.origin:
                E = records.step(self.oldest).affine
                rounding = carried_rounding(E, total, rounding)
                total, lead = E.T.dot(total.dot(E)), lead.dot(E)
                self.oldest -= 1
        ahead, step = None, self.oldest
        for row in sorted(rows, key=lambda row: row.origin) if len(rows) > 1 else rows:
            while step < row.origin:
                step += 1
                E = records.step(step).affine
                ahead = E if ahead is None else E.dot(ahead)
            if ahead is not None:
                rounding = rounding + carried_rounding(ahead, row.gram, np.zeros(len(ahead)))
            total = total + (row.gram if ahead is None else ahead.T.dot(row.gram.dot(ahead)))
        self.suffixes.append(Suffix(total, lead, rounding))


class Suffixes:
    """Sums of the rows of a window, started at its oldest one; the same face as `Frames`."""

    def __init__(self, records: Records, limits: Limits, delays: int) -> None:
        self.limits, self.delays, self.now = limits, delays, records.now
        self._key: Callable[[Row], int] = attrgetter("arrival" if limits.by_arrival else "origin")
        self.by_key: dict[int, list[Row]] = {}
        for row in records.rows:
            self.by_key.setdefault(self._key(row), []).append(row)
        # Up to each step: rows, and steps that brought one of their own.
        start = self.now - limits.horizon - delays
        count = instants = 0
        self.tallies = {start - 1: (0, 0)}
        for step in range(start, self.now + 1):
            rows = self.by_key.get(step, ()) if step > self.now - limits.horizon else ()
            count += len(rows)
            instants += any(row.origin == step for row in rows)
            self.tallies[step] = count, instants
        self.active, self.following = self._block(self.now, records), None
        for _ in range(limits.horizon):
            self._lengthen(self.active, records)

    active: Block
    following: Block | None

    def _block(self, boundary: int, records: Records) -> Block:
        block = Block(boundary, boundary - self.delays, len(records.steps[-1].F))
        for step in range(block.frame + 1, boundary + 1):
            block.advance(records.step(step).affine)
        return block

    def _lengthen(self, block: Block, records: Records) -> None:
        block.lengthen(self.by_key.get(block.boundary - len(block.suffixes) + 1, []), records)

    def advance(self, records: Records, F: Array, known: Array | None) -> None:
        """One more transition, the newest of the records."""
        active, following, now = self.active, self.following, records.now
        self.now = now
        E = records.steps[-1].affine
        active.advance(E)
        self.tallies[now] = self.tallies[now - 1]
        # The following block takes over, `overlap` steps old, when the table of the active one ends.
        horizon, overlap = self.limits.horizon, max(1, self.limits.horizon // OVERLAP)
        if following is not None:
            following.advance(E)
        elif now - active.boundary > horizon - overlap:
            following = self.following = self._block(now - 1, records)
            following.advance(E)
        if following is not None:
            for _ in range(min(-(-horizon // overlap), horizon - overlap + 1 - len(following.suffixes))):
                self._lengthen(following, records)  # a few at a time, so that no step is long
            if now - active.boundary >= horizon:
                self.active, self.following = following, None
                self._forget(now - 2 * horizon - self.delays)

    def _forget(self, bound: int) -> None:
        self.by_key = {key: rows for key, rows in self.by_key.items() if key > bound}
        self.tallies = {key: tally for key, tally in self.tallies.items() if key > bound}

    def move(self, delta: Array) -> None:
        """x of now was moved by delta."""
        for block in (self.active, self.following):
            if block is not None:
                block.move(delta)

    def add(self, row: Row, now: int) -> bool:
        """A row that arrived now; False where these sums have no place for it."""
        key = self._key(row)
        newest = self.active.boundary if self.following is None else self.following.boundary
        if now - row.origin > self.delays or key <= newest:
            return False
        here = self.by_key.setdefault(key, [])
        here.append(row)
        alone = row.origin == now and len(here) == 1
        for step in range(key, now + 1):
            count, instants = self.tallies[step]
            self.tallies[step] = count + 1, instants + alone
        for block in (self.active, self.following):
            if block is not None:
                block.add(row.origin, row.gram)
        return True

    def merged(self, rows: list[Row]) -> None:
        """The rows of this step became these; the sums hold them already."""
        self.by_key[self.now] = rows
        count, instants = self.tallies[self.now - 1]
        self.tallies[self.now] = count + len(rows), instants + 1

    def _tally(self, which: int) -> int:
        before = self.now - self.limits.horizon
        return self.tallies[self.now][which] - (self.tallies[before][which] if before in self.tallies else 0)

    @property
    def rows(self) -> int:
        """Rows in the window."""
        return self._tally(0)

    @property
    def instants(self) -> int:
        """Steps of the window that brought a row of their own: it has at least so many origins."""
        return self._tally(1)

    def estimate(self) -> Array | None:
        """x of least squares over the window, None where the digits would not do."""
        total, ahead, rounding = self.active.window(self.now - self.limits.horizon)
        Lam, Phi = total[:-1, :-1], ahead[:-1, :-1]
        if drowned(Lam, rounding[:-1]):
            return None
        factor, solution, info = cholesky_solver()(Lam, total[:-1, -1])
        if info or not well_scaled(factor, Lam, WEAK_PIVOT**2) or np.vdot(Phi, Phi) > GROWTH**2:
            return None
        x: Array = ahead[:-1, -1] - Phi.dot(solution)
        return x

    @property
    def frame(self) -> int:
        """The oldest step whose transitions are still asked for."""
        blocks = (self.active, self.following)
        return min(block.frame for block in blocks if block is not None)
