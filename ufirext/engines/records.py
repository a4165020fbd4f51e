"""The reference engine: immutable records of steps and rows, one plain solution over the window they form.

Slow and readable; every faster engine is tested against it on random streams. Steps carry absolute numbers,
so that changing engines never renumbers time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._arrays import Array, readonly
from ..gains import exact_covariance, least_squares
from ..window import Row, Window
from .covariance import Covariance

# Rows with less than this fraction of the window's largest information count as missing.
NEGLIGIBLE = 1e-8


@dataclass(eq=False)  # not frozen, which would cost more than all the rest; nobody writes to a step
class Step:
    """x_n = F x_{n-1} + known + w, cov w = Q. `known` holds inputs and edits of x, up to the rows of this
    step.
    """

    F: Array
    Q: Array
    known: Array | None = None
    _affine: Array | None = field(default=None, init=False, repr=False)

    @property
    def leads(self) -> bytes:
        """F, to be compared with."""
        return self.F.tobytes()

    def repeats(self, other: Step) -> bool:
        """Whether the transition is another step's."""
        return self.leads == other.leads and self.Q is other.Q

    @property
    def affine(self) -> Array:
        """E = [[F, known], [0, 1]], the transition of [x; 1]."""
        if self._affine is None:
            n = len(self.F)
            E = _identity(n + 1).copy()
            E[:n, :n] = self.F
            if self.known is not None:
                E[:n, n] = self.known
            self._affine = E
        return self._affine


@cache
def _identity(size: int) -> Array:
    return readonly(np.eye(size))


class Limits(NamedTuple):
    """How far a window goes.

    `horizon` steps; `instants`, the number of distinct origins below which it reaches further back;
    `extends`, whether it may; `by_arrival`, whether steps count from a row's arrival or from its origin.
    """

    horizon: int
    instants: int
    extends: bool
    by_arrival: bool

    @property
    def reach(self) -> int:
        """Steps after which a row is forgotten for good."""
        return 4 * self.horizon + 64 if self.extends else self.horizon


class Stack(NamedTuple):
    """Rows in a window: their regression, their measurements free of known inputs, the known part of the
    aim.
    """

    window: Window
    Z: Array
    known: Array
    rows: Sequence[Row]


class Solution(NamedTuple):
    """An estimate, and what can be asked about it later: covariance, gain on all rows and on the newest."""

    x: Array
    covariance: Covariance
    gain: Covariance
    newest_gain: Covariance
    rows: int


class Records:
    """Steps and rows that a window can still reach, and the estimate they give."""

    def __init__(self, first_F: Array, first_Q: Array, now: int = 0) -> None:
        self.now = now
        self.steps: deque[Step] = deque([Step(first_F, first_Q)])
        self.first = now  # number of steps[0]
        self.rows: list[Row] = []
        self.after: Array | None = None  # edits of x since the last row of this step
        # Sliding maximum of the rows' information, and where in the window it counts; None: to be made.
        self.peaks: deque[tuple[int, float]] | None = None
        self.least = len(first_F) * NEGLIGIBLE  # of the maximum: what has more cannot be negligible

    def advance(self, F: Array, Q: Array, known: Array | None) -> None:
        """One predict()."""
        if self.after is not None:
            moved = F @ self.after
            known = moved if known is None else known + moved
            self.after = None
        self.steps.append(Step(F, Q, known))
        self.now += 1

    def edit(self, delta: Array, after_rows: bool) -> None:
        """x was moved from outside by `delta`, after or before the rows of this step."""
        if after_rows:
            self.after = delta if self.after is None else self.after + delta
        else:
            step = self.steps[-1]
            self.steps[-1] = replace(step, known=delta if step.known is None else step.known + delta)

    def add(self, row: Row) -> None:
        """A row that arrived now."""
        self._compress()
        self.rows.append(
            row if self.after is None or row.origin < self.now else replace(row, shift=self.after)
        )

    def _compress(self) -> None:
        """Many rows of one step become at most dim_x, by QR: memory stays bounded. The last stays."""
        rows = self.rows
        if not rows or rows[-1].arrival < self.now:
            return
        first = len(rows)
        while first and _plain(rows[first - 1], self.now):
            first -= 1
        step = rows[first:-1]
        if not step or sum(len(row.z) for row in step) <= 4 * step[0].H.shape[1]:
            return
        n = step[0].H.shape[1]
        stacked = [np.column_stack([row.white, row.whitener @ row.z]) for row in step]
        triangle: Array = np.asarray(np.linalg.qr(np.concatenate(stacked), mode="r"))[:n]
        merged = Row(self.now, self.now, triangle[:, :n], np.eye(len(triangle)), triangle[:, n])
        self.rows[first:-1] = [merged]

    def negligible(self, row: Row, limits: Limits) -> bool:
        """A row that says nothing beside the window's, of any state it sees, counts as missing; any other is
        about to be added.
        """
        peaks = self.peaks
        if peaks is None:
            peaks = self.peaks = deque()
            for other in self.rows:
                _heap_up(peaks, _key(other, limits), other.information)
        bound, information = self.now - limits.horizon, row.information
        while peaks and peaks[0][0] <= bound:
            peaks.popleft()
        if peaks and information < self.least * peaks[0][1] and self._drowned(row, limits):
            return True
        while peaks and peaks[-1][1] <= information:  # as _heap_up, which a hot path can do without
            peaks.pop()
        peaks.append((row.arrival if limits.by_arrival else row.origin, information))
        return False

    def _drowned(self, row: Row, limits: Limits) -> bool:
        """State by state, for units of states are not to be added up."""
        bound = self.now - limits.horizon
        window = [other.gram.diagonal() for other in self.rows if _key(other, limits) > bound]
        if not window:
            return False
        return bool((row.gram.diagonal() <= NEGLIGIBLE * np.max(window, axis=0))[:-1].all())

    def forget(self, limits: Limits) -> None:
        """Drop what no window can reach any more."""
        bound = self.now - limits.reach
        if self.rows and _key(self.rows[0], limits) <= bound:
            self.rows = [row for row in self.rows if _key(row, limits) > bound]
        # A late row may still come from as far back as the reach.
        oldest = min((row.origin for row in self.rows), default=self.now)
        while self.first < min(oldest, bound):
            self.steps.popleft()
            self.first += 1

    def copy(self) -> Records:
        """An independent copy; rows and steps are immutable and shared."""
        fork = object.__new__(type(self))
        fork.__dict__.update(self.__dict__)
        fork.steps, fork.rows, fork.peaks = self.steps.copy(), self.rows.copy(), None
        return fork

    def step(self, number: int) -> Step:
        """The step of this number; those up to the start repeat the first transition, without inputs."""
        if number <= self.first:
            return replace(self.steps[min(1, len(self.steps) - 1)], known=None)
        return self.steps[number - self.first]

    def stack(self, rows: Iterable[Row], aim: int) -> Stack:
        """The rows as a regression in the state at their oldest origin, aimed at the state of step `aim`."""
        ordered = sorted(rows, key=lambda row: row.origin)
        oldest = min(ordered[0].origin, aim)
        newest = max(aim, ordered[-1].origin)
        steps = [self.step(number) for number in range(oldest + 1, newest + 1)]
        window = Window(
            F=[step.F for step in steps],
            Q=[step.Q for step in steps],
            H=[row.H for row in ordered],
            R=[row.R for row in ordered],
            origins=[row.origin - oldest for row in ordered],
            aim=aim - oldest,
            whiteners=[row.whitener for row in ordered],
        )
        known = [np.zeros(window.dim_x)]
        for step in steps:
            moved = step.F @ known[-1]
            known.append(moved if step.known is None else moved + step.known)
        free = []
        for row in ordered:
            offset = known[row.origin - oldest]
            free.append(row.z - row.H @ (offset if row.shift is None else offset + row.shift))
        return Stack(window, np.concatenate(free), known[aim - oldest], ordered)

    def select(self, limits: Limits) -> list[Row] | None:
        """The rows of the window now, None where they do not determine the state even as far back as
        allowed.
        """
        bound, floor = self.now - limits.horizon, self.now - limits.reach
        wanted = min(limits.horizon, limits.instants) if limits.extends else 0
        while True:
            chosen = [row for row in self.rows if _key(row, limits) > bound]
            older = [_key(row, limits) for row in self.rows if floor < _key(row, limits) <= bound]
            enough = len({row.origin for row in chosen}) >= wanted
            if enough or not older:
                if chosen and self.stack(chosen, self.now).window.determined():
                    return chosen
                if not older:
                    return None
            bound = max(older) - 1

    def solve(self, limits: Limits, lag: int = 0, rows: Sequence[Row] | None = None) -> Solution | None:
        """Least squares over the window: the state `lag` steps ago, None where the rows do not determine
        it.
        """
        chosen = self.select(limits) if rows is None else rows
        if not chosen:
            return None
        stack = self.stack(chosen, self.now - lag)
        if (lag or rows is not None) and not stack.window.determined():
            return None
        gain = least_squares(stack.window)
        x = gain @ stack.Z + stack.known
        return Solution(
            x if lag or self.after is None else x + self.after,
            Covariance(exact_covariance, (stack.window, gain)),
            Covariance.of(gain),
            Covariance(_newest_gain, (stack, gain, self.rows[-1])),
            len(stack.rows),
        )


def _newest_gain(stack: Stack, gain: Array, newest: Row) -> Array:
    """Columns of the gain that act on the row which arrived last (dim_x, its components)."""
    starts = stack.window.starts
    for index, row in enumerate(stack.rows):
        if row is newest:
            return gain[:, starts[index] : starts[index + 1]]
    return np.zeros((len(gain), len(newest.H)))


def _heap_up(peaks: deque[tuple[int, float]], key: int, information: float) -> None:
    """A new entry; what is neither newer nor larger will never be the maximum."""
    while peaks and peaks[-1][1] <= information:
        peaks.pop()
    peaks.append((key, information))


def _key(row: Row, limits: Limits) -> int:
    return row.arrival if limits.by_arrival else row.origin


def _plain(row: Row, now: int) -> bool:
    return row.arrival == row.origin == now and row.shift is None


def measured(z: Array, H: Array, R: Array) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """The components of z that are measured (not NaN, row of H not zero): z, H, R of them, and the mask."""
    mask = ~np.isnan(z) & H.any(axis=1)
    if mask.all():
        return z, H, R, mask
    return z[mask], H[mask], R[np.ix_(mask, mask)], mask
