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
from ..window import Row, well_scaled

if TYPE_CHECKING:
    from .records import Limits, Records

# A scaled pivot below this: the normal equations would lose too much.
WEAK_PIVOT = 0.03
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
        # Rows of the block by the step they count for, in the next block's frame; [Lam | -eta] will do.
        self.grams = np.zeros((horizon, n, n + 1))
        self.older = np.zeros((horizon + 1, n, n + 1))  # the rows before it from a step on, in this frame
        self.sum = np.zeros((2 * n + 2, 2 * n + 2))  # the rows of the block in both frames
        self.newer = self.sum[:n, : n + 1]
        self.point = np.zeros(2 * n + 2)  # [x_f; 1; 0]
        self.point[n] = 1.0
        self.came, self.instants_of = [0] * horizon, [0] * horizon
        frame = boundary - horizon - delays
        products = [np.eye(n + 1)]
        for step in range(frame + 1, boundary + 1):
            products.append(records.step(step).affine.dot(products[-1]))
        for row in records.rows:
            place = (row.arrival if self.by_arrival else row.origin) - boundary + horizon - 1
            if place >= 0:
                product = products[row.origin - frame]
                self.grams[place] += product.T.dot(row.gram.dot(product))[:n]
                self._count(place, row.origin == row.arrival)
        self._begin(boundary, products[horizon:], records)

    def _begin(self, boundary: int, leads: list[Array], records: Records) -> None:
        """A new block; `leads` are the products from its frame to the steps boundary - delays .. boundary."""
        np.cumsum(self.grams[::-1], axis=0, out=self.older[-2::-1])
        self.grams.fill(0.0)
        self.sum.fill(0.0)
        self.older_rows = list(accumulate(reversed(self.came), initial=0))[::-1]
        self.older_instants = list(accumulate(reversed(self.instants_of), initial=0))[::-1]
        self.newer_rows = self.newer_instants = self.age = 0
        self.came, self.instants_of = [0] * self.horizon, [0] * self.horizon
        self.boundary = boundary
        nexts = [np.eye(self.dim_x + 1)]
        for step in range(boundary - self.delays + 1, boundary + 1):
            nexts.append(records.step(step).affine.dot(nexts[-1]))
        # Products from both frames to every step from boundary - delays on, side by side.
        self.trail = [np.concatenate(pair, axis=1) for pair in zip(leads, nexts, strict=True)]
        self.both = self.trail[-1]

    def advance(self, records: Records) -> None:
        """One more transition, the newest of the records."""
        if self.age == self.horizon:
            last = self.trail[-1 - self.delays :] if self.delays else [self.both]
            leads = [np.ascontiguousarray(both[:, self.dim_x + 1 :]) for both in last]
            self._begin(self.boundary + self.horizon, leads, records)
        self.age += 1
        self.both = records.steps[-1].affine.dot(self.both)
        if self.delays:
            self.trail.append(self.both)

    def move(self, delta: Array) -> None:
        """x of now was moved by delta."""
        n = self.dim_x
        self.both = self.trail[-1] = self.both.copy()
        self.both[:n, n] += delta
        self.both[:n, -1] += delta

    def add(self, row: Row, now: int) -> bool:
        """A row that arrived now; False where these sums have no place for it."""
        late = now - row.origin
        place = self.age - 1 - (0 if self.by_arrival else late)
        if late > self.delays or place < 0:
            return False
        both = self.trail[row.origin - self.boundary + self.delays] if late else self.both
        gram = both.T.dot(row.gram.dot(both))
        self.sum += gram
        here = self.grams[place]
        here += gram[-1 - self.dim_x : -1, -1 - self.dim_x :]
        self.newer_rows += 1
        self.newer_instants += self._count(place, not late)
        return True

    def _count(self, place: int, on_time: bool) -> bool:
        self.came[place] += 1
        alone = on_time and self.came[place] == 1
        self.instants_of[place] += alone
        return alone

    def merged(self, rows: list[Row]) -> None:
        """The rows of this step became these; the sums hold them already."""
        place = self.age - 1
        self.newer_rows += len(rows) - self.came[place]
        self.came[place] = len(rows)

    @property
    def rows(self) -> int:
        """Rows in the window."""
        return self.older_rows[self.age] + self.newer_rows

    @property
    def instants(self) -> int:
        """Steps of the window that brought a row of their own: it has at least so many origins."""
        return self.older_instants[self.age] + self.newer_instants

    def estimate(self) -> Array | None:
        """x of least squares over the window, None where the digits would not do."""
        n, both = self.dim_x, self.both
        total = self.older[self.age] + self.newer
        Lam = total[:, :n]
        factor, solution, info = cholesky_solver()(Lam, total[:, n])
        if info or not well_scaled(factor, Lam, WEAK_PIVOT**2):
            return None
        if np.vdot(both, both) > GROWTH**2 and np.vdot(both[:n, :n], both[:n, :n]) > GROWTH**2:
            return None
        point = self.point
        point[:n] = -solution
        x: Array = both.dot(point)[:n]
        return x

    @property
    def frame(self) -> int:
        """The oldest step whose transitions are still asked for."""
        return self.boundary - self.delays
