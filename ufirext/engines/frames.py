"""Running sums over a window in a frame of its own: a handful of small products a step, at any length.

Everything is in the coordinates [x; 1]: a transition is E = [[F, known], [0, 1]], a row B = [H, -z] with
B [x; 1] = noise of covariance R, so that known inputs need no thought; B'R^-1 B is its gram.

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
from ..window import Row

if TYPE_CHECKING:
    from .records import Limits, Records

# Squared pivots below this fraction of their diagonal entries: the normal equations would lose too much.
LEAST = 1e-4
# Transitions that grow beyond this from the frame on make the sums lose digits.
GROWTH = 1e4


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
        self.older = np.zeros((horizon + 1, n, n + 1))  # of the rows before it from a step on, in this one's
        self.sum = np.zeros((2 * n + 2, 2 * n + 2))  # grams of the rows of the block in both frames
        self.newer = self.sum[:n, : n + 1]
        self.second = slice(n + 1, 2 * n + 1), slice(n + 1, None)
        self.start = np.concatenate([np.zeros((n + 1, n + 1)), np.eye(n + 1)], axis=1)
        self.total = np.empty((n, n + 1))  # of the window, and parts of it
        self.Lam, self.right, self.scales = self.total[:, :n], self.total[:, n], self.total[:, :n].diagonal()
        self.point = np.zeros(2 * n + 2)  # [x_f; 1; 0]
        self.point[n], self.frame_x = 1.0, self.point[:n]
        self.rows_until: list[int] = []  # rows before each step of the block, instants likewise
        self.instants_until: list[int] = []
        frame = boundary - horizon - delays
        products = [np.eye(n + 1)]
        for step in range(frame + 1, boundary + 1):
            products.append(records.step(step).affine.dot(products[-1]))
        rows, instants = [0] * horizon, [0] * horizon
        for row in records.rows:
            place = (row.arrival if self.by_arrival else row.origin) - boundary + horizon - 1
            if place >= 0:
                product = products[row.origin - frame]
                self.grams[place] += product.T.dot(row.gram.dot(product))[:n]
                instants[place] += rows[place] == 0 and row.origin == row.arrival
                rows[place] += 1
        self.rows_until = list(accumulate(rows, initial=0))
        self.instants_until = list(accumulate(instants, initial=0))
        self.all_rows, self.all_instants = self.rows_until.pop(), self.instants_until.pop()
        self._begin(boundary, products[horizon:], records)

    def _begin(self, boundary: int, leads: list[Array], records: Records) -> None:
        """A new block; `leads` are the products from its frame to the steps boundary - delays .. boundary."""
        np.add.accumulate(self.grams[::-1], axis=0, out=self.older[-2::-1])
        self.grams.fill(0.0)
        self.sum.fill(0.0)
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
                both = records.step(step).affine.dot(both)
            both[:, :k] = lead
            self.trail.append(both)
        self.both = both

    def advance(self, records: Records) -> None:
        """One more transition, the newest of the records."""
        if self.age == self.horizon:
            last = self.trail[-1 - self.delays :] if self.delays else [self.both]
            self._begin(self.boundary + self.horizon, [both[:, self.dim_x + 1 :] for both in last], records)
        self.age += 1
        self.rows_until.append(self.all_rows)
        self.instants_until.append(self.all_instants)
        step = records.steps[-1]
        self.both = step.affine.dot(self.both)
        if step.known is not None:
            self.driven = True
        if self.delays:
            self.trail.append(self.both)

    def move(self, delta: Array) -> None:
        """x of now was moved by delta."""
        n = self.dim_x
        self.both = self.trail[-1] = self.both.copy()
        self.both[:n, n] += delta
        self.both[:n, -1] += delta
        self.driven = True

    def add(self, row: Row, now: int) -> bool:
        """A row that arrived now; False where these sums have no place for it."""
        late = now - row.origin
        both, place = self.both, self.age - 1
        if late:
            if not self.by_arrival:
                place -= late
            if late > self.delays or place < 0:
                return False
            both = self.trail[row.origin - self.boundary + self.delays]
        elif place < 0:
            return False
        gram = both.T.dot(row.gram.dot(both))
        self.sum += gram
        first = self.all_rows == self.rows_until[-1] and not late
        if first:
            self.grams[place] = gram[self.second]
            self.all_instants += 1
        else:
            self.grams[place] += gram[self.second]
        self.all_rows += 1
        if late and not self.by_arrival:
            for step in range(place + 1, self.age):
                self.rows_until[step] += 1
        return True

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
        if info:
            return None
        for pivot, entry in zip(factor.diagonal().tolist(), self.scales.tolist(), strict=True):
            if not pivot * pivot >= LEAST * entry:
                return None
        both = self.both
        # What is known of x is taken off and added again: it must not have grown out of proportion.
        if self.driven and np.vdot(both, both) > GROWTH**2:
            n = self.dim_x
            if np.vdot(both[:n, :n], both[:n, :n]) > GROWTH**2:
                return None
        np.negative(solution, out=self.frame_x)
        x: Array = both.dot(self.point)[: self.dim_x]
        return x

    @property
    def frame(self) -> int:
        """The oldest step whose transitions are still asked for."""
        return self.boundary - self.delays
