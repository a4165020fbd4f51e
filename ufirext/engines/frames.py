"""Running sums over a window in a frame of its own: a handful of small products a step, at any length.

Everything is in the coordinates [x; -1]: x_j = [Phi, -c] [x_f; -1] holds known inputs in c, and
[H Phi, z - H c] times [x_f; -1] is the noise of a row, of covariance R.

Time is cut into blocks as long as the horizon. While a block runs, all rows of the window are summed up in
the frame of x_f, f the boundary one horizon before the block: rows of the block in one sum that grows, older
ones in a table of suffixes. A row joins in two frames at once, the present one and the next block's, so that
the next table is one cumulative sum. All products go forward and nothing is ever subtracted.
"""

from __future__ import annotations

from itertools import accumulate
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .._arrays import Array
from .._lapack import cholesky_solver
from .._rounding import SUSPECT
from .hands import Hands, QuickRow

if TYPE_CHECKING:
    from ..window import Row
    from .records import Limits, Records

# Squared pivots below this fraction of their diagonal entries: the normal equations would lose too much.
LEAST = 5e-4
# Squared: what is known may be so many times as large as x; taking it off and adding it again costs digits.
OUTGROWN = 1e3


class Products(NamedTuple):
    """Transitions from two frames to a step, side by side."""

    both: Array  # [Phi, -c, Phi, -c] above a row of ones for the -1s, (k, 2 k)
    top: Array  # without that row
    turned: Array  # transposed

    @classmethod
    def of(cls, both: Array) -> Products:
        """From the whole."""
        return cls(both, both[:-1], both.T)


class Frames:
    """Sums of the rows of a window in the frame before it.

    `delays` is the longest delay of a row: frames lie so much further back.
    """

    def __init__(self, records: Records, limits: Limits, delays: int) -> None:
        horizon, boundary = limits.horizon, records.now
        n = len(records.steps[-1].F)
        k = n + 1
        self.dim_x, self.horizon, self.delays, self.by_arrival = n, horizon, delays, limits.by_arrival
        self.driven = any(step.known is not None for step in records.steps)
        # Sums are [Lam; eta'], (k, n). Of the rows of a block by the step they count for, in the next block's
        # frame; in this block's frame of its rows, and of those before it from a step on.
        self.grams, self.newer = np.zeros((horizon, k, n)), np.zeros((k, n))
        self.older = np.zeros((horizon + 1, k, n))
        self.gram_at, self.older_at = list(self.grams), list(self.older)  # looking up beats slicing
        self.gram = np.zeros((k, n))  # one row's
        # The window's sum, whose Lam becomes its factor and whose eta becomes x_f, met by [Phi, -c, ..].
        room = np.zeros(n * n + 2 * k)
        self.total, self.point = room[: k * n].reshape(k, n), room[n * n :]
        self.Lam, self.diagonal, self.right = self.total[:n].T, room[: n * n : k], self.total[n:].T
        self.point[n] = -1.0
        self.start = np.concatenate([np.eye(k)] * 2, axis=1)
        self.now, self.ahead = (Products.of(self.start.copy()) for _ in range(2))  # room for the next step's
        self.hands: dict[int, Hands] = {}
        self.full: Hands | None = None  # which hold a row
        self.factorise = cholesky_solver()
        self._build(records, boundary)

    def _build(self, records: Records, boundary: int) -> None:
        """All sums from the records."""
        horizon, frame = self.horizon, boundary - self.horizon - self.delays
        products = [self.now.both.copy()]
        for step in range(frame + 1, boundary + 1):
            transition = records.step(step)
            self._move_on(transition.F, transition.known)
            products.append(self.now.both.copy())
        rows, instants = [0] * horizon, [0] * horizon
        for row in records.rows:
            place = (row.arrival if self.by_arrival else row.origin) - boundary + horizon - 1
            if place >= 0:
                self.grams[place] += self._grams(row, products[row.origin - frame])[1]
                instants[place] += rows[place] == 0 and row.origin == row.arrival
                rows[place] += 1
        # Rows before each step of the block, and steps that brought a row of their own.
        self.rows_until = list(accumulate(rows, initial=0))
        self.instants_until = list(accumulate(instants, initial=0))
        self.all_rows, self.all_instants = self.rows_until.pop(), self.instants_until.pop()
        self._begin(boundary, products[horizon:], records)

    def _begin(self, boundary: int, trail: list[Array], records: Records) -> None:
        """A new block; `trail` holds the products to the steps boundary - delays .. boundary, of which those
        of the following frame are now the present one's.
        """
        k = self.dim_x + 1
        np.add.accumulate(self.grams[::-1], axis=0, out=self.older[-2::-1])
        self.grams.fill(0.0)
        self.newer.fill(0.0)
        self.earlier_rows, self.earlier_instants = self.rows_until, self.instants_until
        self.earlier_rows.append(self.all_rows)
        self.earlier_instants.append(self.all_instants)
        self.rows_until, self.instants_until = [], []
        self.boundary, self.age = boundary, 0
        self.trail: list[Array] = []
        self.now.both[...] = self.start
        for step, products in enumerate(trail, boundary - self.delays):
            if self.trail:
                transition = records.step(step)
                self._move_on(transition.F, transition.known)
            self.now.both[:, :k] = products[:, k:]
            self.trail.append(self.now.both.copy())

    def _move_on(self, F: Array, known: Array | None) -> None:
        """One more transition."""
        now, ahead = self.now, self.ahead
        F.dot(now.top, ahead.top)
        self.now, self.ahead = ahead, now
        if known is not None:
            self._shift(known)

    def _shift(self, known: Array) -> None:
        self.driven = True
        self.now.top[:, self.dim_x :: self.dim_x + 1] -= known[:, None]

    def advance(self, records: Records, F: Array, known: Array | None) -> None:
        """One more transition, the newest of the records, which need not be asked for it."""
        if self.age == self.horizon:
            last = self.trail[-1 - self.delays :] if self.delays else [self.now.both.copy()]
            self._begin(self.boundary + self.horizon, last, records)
        self.age += 1
        self.rows_until.append(self.all_rows)
        self.instants_until.append(self.all_instants)
        self._move_on(F, known)
        if self.delays:
            self.trail.append(self.now.both.copy())

    def move(self, delta: Array) -> None:
        """x of now was moved by delta."""
        self._shift(delta)
        if self.delays:
            self.trail[-1] = self.now.both.copy()

    # -- rows ------------------------------------------------------------------------------------------------

    def row(
        self, now: int, z: Any, H: Any, R: Any, raw_H: bytes | None = None, raw_R: bytes | None = None
    ) -> QuickRow | None:
        """A measurement of this step as a row, None for whatever needs a closer look; with the bytes of an H
        and an R which had one.
        """
        try:
            hands = self.hands[len(H)]
        except (KeyError, TypeError):
            if H.__class__ is not np.ndarray or not H.ndim:
                return None
            hands = self.hands[len(H)] = Hands(len(H), self.dim_x)
        self.full = hands
        return hands.row(now, z, H, R, raw_H, raw_R)

    def take(self) -> bool:
        """The row that was read last; False, with nothing done, where its R is hardly regular."""
        place, hands = self.age - 1, self.full
        if place < 0 or hands is None or not hands.see(self.now.turned):
            return False
        (present, following), (seen, seen_too) = hands.left, hands.right
        self.newer += present(seen, self.gram)
        if self.all_rows > self.rows_until[-1]:
            self.grams[place] += following(seen_too)
        else:
            following(seen_too, self.gram_at[place])
            self.all_instants += 1
        self.all_rows += 1
        return True

    def add(self, row: Row, now: int) -> bool:
        """A row that arrived now; False where these sums have no place for it."""
        late = now - row.origin
        place = self.age - 1 - (0 if self.by_arrival else late)
        if late > self.delays or place < 0:
            return False
        products = self.trail[row.origin - self.boundary + self.delays] if late else self.now.both
        present, following = self._grams(row, products)
        self.newer += present
        self.grams[place] += following
        self.all_instants += not late and self.all_rows == self.rows_until[-1]
        self.all_rows += 1
        if late and not self.by_arrival:
            for step in range(place + 1, self.age):
                self.rows_until[step] += 1
        return True

    def _grams(self, row: Row, products: Array) -> tuple[Array, Array]:
        """Of any row, in the present frame and in the following one."""
        n, k = self.dim_x, self.dim_x + 1
        white = row.affine.copy()
        white[:, n] *= -1.0
        seen = white.dot(products)
        return seen[:, :k].T.dot(seen[:, :n]), seen[:, k:].T.dot(seen[:, k:-1])

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

    # -- the estimate ----------------------------------------------------------------------------------------

    def estimate(self) -> Array | None:
        """x of least squares over the window, None where the digits would not do."""
        np.add(self.older_at[self.age], self.newer, self.total)
        entries = self.diagonal.tolist()
        if min(entries) < SUSPECT * max(entries):
            return None
        if self.factorise(self.Lam, self.right, 0, 1, 1)[2]:
            return None
        for i, pivot in enumerate(self.diagonal.tolist()):
            if not pivot * pivot >= LEAST * entries[i]:
                return None
        x: Array = self.now.top.dot(self.point)
        if self.driven:
            known = self.now.top[:, self.dim_x]
            if known.dot(known) > OUTGROWN * x.dot(x):
                return None
        return x

    @property
    def frame(self) -> int:
        """The oldest step whose transitions are still asked for."""
        return self.boundary - self.delays
