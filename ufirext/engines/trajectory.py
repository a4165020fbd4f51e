"""What is known about the state: inputs and edits of x, as a trajectory x_u that rows are seen against."""

from __future__ import annotations

import numpy as np

from .._arrays import Array


class Trajectory:
    """x_u now, at the rows of each step (`path`), and what each step added to it (`known`), slot by slot.

    x = x_u + x_f: the slots hold z - H x_u, the window estimates x_f, and the estimate adds x_u back: exact
    for any gain.
    """

    def __init__(self, slots: int, dim_x: int, now: int) -> None:
        self.now = np.zeros(dim_x)
        self.known, self.path = np.zeros((slots, dim_x)), np.zeros((slots, dim_x))
        self.after: Array | None = None  # edits since the last row of this step
        self.coming: Array | None = None  # what the step adds that is open and has no slot so far
        self.over = False  # whether nothing was known for as long as anything is remembered
        self.rebased = now
        self.valid_from = now - slots  # oldest step whose path belongs to the present x_u

    def advance(self, slot: int, F: Array, known: Array | None) -> None:
        """One transition, to the step of `slot`."""
        total = known
        if self.after is not None:
            moved = F.dot(self.after)  # x_u holds the edit already: only the record of the step needs it
            total = moved if known is None else known + moved
            self.after = None
        ahead = F.dot(self.now)
        self.now = ahead if known is None else ahead + known
        self.known[slot] = 0.0 if total is None else total
        self.path[slot] = self.now

    def edit(self, slot: int, delta: Array, after_rows: bool) -> None:
        """x was moved from outside, after or before the rows of the step of `slot`."""
        self.now = self.now + delta
        if after_rows:
            self.after = delta if self.after is None else self.after + delta
        else:
            self.known[slot] += delta
            self.path[slot] = self.now

    def forgotten(self, low: int, end: int) -> bool:
        """Whether nothing was known at the steps of these slots."""
        return not self.known[low:end].any()

    def compact(self, shift: int, keep: int) -> None:
        """Move the last `keep` slots to the front."""
        for array in (self.known, self.path):
            array[:keep] = array[shift : shift + keep].copy()

    def rebase(self, low: int, end: int, F: Array) -> None:
        """Start from zero at slot `low`: x_u stays small for any F, and nothing else changes."""
        start = self.path[low].copy()
        for slot in range(low, end):
            self.path[slot] -= start
            start = F.dot(start)
        self.now = self.path[end - 1].copy()

    def copy(self) -> Trajectory:
        """An independent copy."""
        fork = object.__new__(Trajectory)
        fork.__dict__.update(self.__dict__)
        fork.known, fork.path = self.known.copy(), self.path.copy()
        return fork
