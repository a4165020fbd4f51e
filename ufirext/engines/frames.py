"""Running sums over a window in a frame of its own: a handful of small products a step, at any length.

Everything is in the coordinates [x; 1]: x_j = [Phi c] [x_f; 1] holds known inputs in c, and [H Phi, H c - z]
times [x_f; 1] is the noise of a row, of covariance R.

Time is cut into blocks as long as the horizon. While a block runs, all rows of the window are summed up in
the frame of x_f, f the boundary one horizon before the block: rows of the block in one sum that grows, older
ones in a table of suffixes. A row joins in two frames at once, the present one and the next block's, so that
the next table is one cumulative sum. All products go forward and nothing is ever subtracted.
"""

from __future__ import annotations

from itertools import accumulate
from typing import TYPE_CHECKING

import numpy as np

from .._arrays import Array
from .._lapack import cholesky_solver
from ..window import GOOD_PIVOT, Row, well_scaled

if TYPE_CHECKING:
    from .records import Limits, Records, Step

# Squared pivots below this fraction of their diagonal entries: the normal equations would lose too much.
LEAST = 5e-4
# Squared: what is known may be so many times as large as x; taking it off and adding it again costs digits.
OUTGROWN = 1e3


class Frames:
    """Sums of the rows of a window in the frame before it.

    `delays` is the longest delay of a row: frames lie so much further back.
    """

    def __init__(self, records: Records, limits: Limits, delays: int) -> None:
        horizon, boundary = limits.horizon, records.now
        n = len(records.steps[-1].F)
        self.dim_x, self.horizon, self.delays, self.by_arrival = n, horizon, delays, limits.by_arrival
        self.driven = any(step.known is not None for step in records.steps)
        # [Lam | -eta] of the rows of a block by the step they count for, in the next block's frame.
        self.grams = np.zeros((horizon, n, n + 1))
        # Of the rows of the block in this frame, and of those before it from a step on. The right halves mean
        # nothing: adding whole rows of a product takes a third of the time that adding a part of them does.
        self.newer = np.zeros((n, 2 * n + 2))
        self.older = np.zeros((horizon + 1, n, 2 * n + 2))
        self.second = slice(n + 1, 2 * n + 1), slice(n + 1, None)
        self.known = np.zeros((1, 2 * n + 2))  # the two columns of c
        self.known[0, n :: n + 1] = 1.0
        self.start = np.concatenate([np.zeros((n, n + 1)), np.eye(n, n + 1)], axis=1)
        self.total = np.empty((n, 2 * n + 2))  # of the window, and parts of it
        self.Lam, self.right = self.total[:, :n], self.total[:, n]
        self.point = np.zeros(2 * n + 2)  # [x_f; 1; 0]
        self.point[n], self.frame_x = 1.0, self.point[:n]
        self._build(records, boundary)

    def _build(self, records: Records, boundary: int) -> None:
        """All sums from the records."""
        n, horizon, frame = self.dim_x, self.horizon, boundary - self.horizon - self.delays
        products = [self.start]
        for step in range(frame + 1, boundary + 1):
            products.append(self._moved(records.step(step), products[-1]))
        rows, instants = [0] * horizon, [0] * horizon
        for row in records.rows:
            place = (row.arrival if self.by_arrival else row.origin) - boundary + horizon - 1
            if place >= 0:
                self.grams[place] += self._gram(row, products[row.origin - frame])[self.second]
                instants[place] += rows[place] == 0 and row.origin == row.arrival
                rows[place] += 1
        # Rows before each step of the block, and steps that brought a row of their own.
        self.rows_until = list(accumulate(rows, initial=0))
        self.instants_until = list(accumulate(instants, initial=0))
        self.all_rows, self.all_instants = self.rows_until.pop(), self.instants_until.pop()
        self._begin(boundary, [both[:, n + 1 :] for both in products[horizon:]], records)

    def _begin(self, boundary: int, leads: list[Array], records: Records) -> None:
        """A new block; `leads` are the products from its frame to the steps boundary - delays .. boundary."""
        np.add.accumulate(self.grams[::-1], axis=0, out=self.older[-2::-1, :, : self.dim_x + 1])
        self.grams.fill(0.0)
        self.newer.fill(0.0)
        self.earlier_rows, self.earlier_instants = self.rows_until, self.instants_until
        self.earlier_rows.append(self.all_rows)
        self.earlier_instants.append(self.all_instants)
        self.rows_until, self.instants_until = [], []
        self.boundary, self.age = boundary, 0
        # Products from both frames to every step from boundary - delays on, side by side.
        both, k = self.start.copy(), self.dim_x + 1
        self.trail: list[Array] = []
        for step, lead in enumerate(leads, boundary - self.delays):
            if self.trail:
                both = self._moved(records.step(step), both)
            both[:, :k] = lead
            self.trail.append(both)
        self.both = both

    def _moved(self, step: Step, both: Array) -> Array:
        ahead: Array = step.F.dot(both)
        if step.known is not None:
            self.driven = True
            ahead += step.known[:, None].dot(self.known)
        return ahead

    def advance(self, records: Records) -> None:
        """One more transition, the newest of the records."""
        if self.age == self.horizon:
            last = self.trail[-1 - self.delays :] if self.delays else [self.both]
            self._begin(self.boundary + self.horizon, [both[:, self.dim_x + 1 :] for both in last], records)
        self.age += 1
        self.rows_until.append(self.all_rows)
        self.instants_until.append(self.all_instants)
        self.both = self._moved(records.steps[-1], self.both)
        if self.delays:
            self.trail.append(self.both)

    def move(self, delta: Array) -> None:
        """x of now was moved by delta."""
        self.both = self.trail[-1] = self.both + delta[:, None].dot(self.known)
        self.driven = True

    def take(self, row: Row) -> bool:
        """A row of this step, with nothing about it; False, with nothing done, where R is hardly regular."""
        if not self.age:
            return False
        seen = row.H.dot(self.both)
        seen -= row.z[:, None].dot(self.known)
        factor, weighted, info = cholesky_solver()(row.R, seen)
        if info or not well_scaled(factor, row.R, GOOD_PIVOT):
            return False
        self._sum(seen.T.dot(weighted), self.age - 1)
        return True

    def add(self, row: Row, now: int) -> bool:
        """A row that arrived now; False where these sums have no place for it."""
        late = now - row.origin
        both, place = self.both, self.age - 1
        if late:
            both = self.trail[row.origin - self.boundary + self.delays] if late <= self.delays else both
            place -= 0 if self.by_arrival else late
        if late > self.delays or place < 0:
            return False
        self._sum(self._gram(row, both), place, bool(late))
        if late and not self.by_arrival:
            for step in range(place + 1, self.age):
                self.rows_until[step] += 1
        return True

    def _gram(self, row: Row, both: Array) -> Array:
        """Of any row, in both frames."""
        white = row.affine
        seen = white[:, :-1].dot(both)
        seen += white[:, -1:].dot(self.known)
        gram: Array = seen.T.dot(seen)
        return gram

    def _sum(self, gram: Array, place: int, late: bool = False) -> None:
        self.newer += gram[: self.dim_x]
        if late or self.all_rows > self.rows_until[-1]:
            self.grams[place] += gram[self.second]
        else:
            self.grams[place] = gram[self.second]
            self.all_instants += 1
        self.all_rows += 1

    def merged(self, rows: list[Row]) -> None:
        """The rows of this step became these; the sums hold them already."""
        if self.rows_until:
            self.all_rows = self.rows_until[-1] + len(rows)
        else:  # the boundary itself
            self.all_rows = self.earlier_rows[-1] = self.earlier_rows[-2] + len(rows)

    @property
    def rows(self) -> int:
        """Rows in the window."""
        return self.all_rows - self.earlier_rows[self.age]

    @property
    def instants(self) -> int:
        """Steps of the window that brought a row of their own: it has at least so many origins."""
        return self.all_instants - self.earlier_instants[self.age]

    def estimate(self) -> Array | None:
        """x of least squares over the window, None where the digits would not do."""
        np.add(self.older[self.age], self.newer, out=self.total)
        factor, solution, info = cholesky_solver()(self.Lam, self.right)
        if info or not well_scaled(factor, self.Lam, LEAST):
            return None
        np.negative(solution, out=self.frame_x)
        x: Array = self.both.dot(self.point)
        if self.driven:
            known = self.both[:, self.dim_x]
            if known.dot(known) > OUTGROWN * x.dot(x):
                return None
        return x

    @property
    def frame(self) -> int:
        """The oldest step whose transitions are still asked for."""
        return self.boundary - self.delays
