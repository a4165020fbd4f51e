"""The engine for minimum-variance windows of any kind: time-varying models, holes, late rows, inputs, edits.

It keeps the same records as the reference engine, and folds of associative segments over them. Everything is
a deviation from a reference trajectory (where the filter believed to be), so that large offsets cost no
digits.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right, insort
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from .._arrays import Array
from ..joint import Joint, joint_gain
from ..segments import (
    Segment,
    SlidingFold,
    closing,
    combine,
    covariance,
    estimate,
    hopeless,
    known_start,
    split,
    transition,
)
from ..window import Row
from .covariance import Covariance
from .records import Limits, Records, Solution, Stack

__all__ = ["Lagged", "Prior", "Segmented"]


class Lagged(NamedTuple):
    """An older state: estimate, error covariance, and E[(error of the newest state) (its error)']."""

    x: Array
    P: Array
    cross: Array


class Prior(NamedTuple):
    """What is known of the state at `time` before its rows, while the rows do not determine it."""

    time: int
    x: Array
    P: Array


class Segmented(Records):
    """Records with folds: the estimate of a minimum-variance window at a cost that does not grow with it."""

    def __init__(self, first_F: Array, first_Q: Array, now: int, center: Array) -> None:
        super().__init__(first_F, first_Q, now)
        self.center = center  # where the filter believes to be
        self.references, self.oldest = {now: center}, now
        self.said: dict[int, tuple[Array, Array]] = {}  # eta and J of the rows at an instant
        self.instants: list[int] = []
        self.start: int | None = None  # of the window; None while its rows do not determine the state
        self.clear = True  # whether the folds are accurate enough for this window
        self.doubtful = False  # whether no window of the model seen first determines the state
        self.tidied = now
        self._fold()

    def _fold(self) -> None:
        self.whole, self.head, self.tail = (SlidingFold(self._leaf) for _ in range(3))

    # -- transitions and rows ---------------------------------------------------------------------------

    def advance(self, F: Array, Q: Array, known: Array | None) -> None:
        """One predict()."""
        ahead = F @ self.center
        super().advance(F, Q, known)
        self.center = ahead if known is None else ahead + known
        self.references[self.now] = self.center

    def edit(self, delta: Array, after_rows: bool) -> None:
        """x was moved from outside by `delta`, after or before the rows of this step."""
        super().edit(delta, after_rows)
        self.center = self.center + delta
        if not after_rows:
            self._changed(self.now - 1)

    def add(self, row: Row) -> None:
        """A row that arrived now."""
        super().add(row)
        row = self.rows[-1]
        z = row.z - row.H @ self._reference(row.origin)
        if row.shift is not None:
            z = z - row.H @ row.shift
        seen = row.whitener @ row.H
        eta, J = seen.T @ (row.whitener @ z), seen.T @ seen
        if row.origin in self.said:
            eta, J = eta + self.said[row.origin][0], J + self.said[row.origin][1]
        elif not self.instants or row.origin > self.instants[-1]:
            self.instants.append(row.origin)
        else:
            insort(self.instants, row.origin)
        self.said[row.origin] = eta, J
        self._changed(row.origin)

    def forget(self, limits: Limits) -> None:
        """Drop what no window can reach any more, once a horizon."""
        bound = self.now - limits.reach
        if self.now - self.tidied < limits.horizon:
            return
        self.tidied = self.now
        super().forget(limits)
        self.instants = self.instants[bisect_left(self.instants, bound + 1) :]
        self.said = {time: said for time, said in self.said.items() if time > bound}
        self.oldest = max(self.oldest, min(bound, self.first))
        self.references = {time: x for time, x in self.references.items() if time >= self.oldest}

    def _reference(self, time: int) -> Array:
        """The reference at `time`; before the first step it stands still."""
        return self.references[max(time, self.oldest)]

    def _changed(self, time: int) -> None:
        for fold in (self.whole, self.head, self.tail):
            fold.changed(time)

    # -- folds ------------------------------------------------------------------------------------------

    def _rows_at(self, time: int) -> tuple[Array, Array]:
        n = len(self.center)
        return self.said.get(time) or (np.zeros(n), np.zeros((n, n)))

    def _leaf(self, time: int) -> Segment:
        step = self.step(time + 1)
        drift = step.F @ self._reference(time) - self._reference(time + 1)
        return transition(
            step.F, drift if step.known is None else drift + step.known, step.Q, *self._rows_at(time)
        )

    def _closed(self, fold: SlidingFold, start: int, stop: int) -> Segment:
        """The steps start .. stop, without the transition after the last."""
        before, last = fold(start, stop), closing(*self._rows_at(stop))
        return last if before is None else combine(before, last)

    def solve(self, limits: Limits, lag: int = 0, rows: Sequence[Row] | None = None) -> Solution | None:
        """Minimum-variance estimate over the window; None where its rows do not determine the state."""
        floor = self.now - limits.reach
        wanted = min(limits.horizon, limits.instants) if limits.extends else 0
        place = bisect_left(self.instants, self.now - limits.horizon + 1)
        place = max(0, min(place, len(self.instants) - wanted))
        before, self.start = self.start, None
        if place < len(self.instants) and self.instants[place] > floor:
            for candidate in self._candidates(place, before, floor):
                segment = self._closed(self.whole, self.instants[candidate], self.now)
                deviation = estimate(segment)
                if deviation is not None:
                    if candidate < place and self._determined_since(candidate + 1):
                        break
                    self.start, self.clear = self.instants[candidate], True
                    return self._solution(deviation, segment, len(self.instants) - candidate)
        return None if self.doubtful and self._hopeless(floor) else self._solve_slowly(limits)

    def _determined_since(self, place: int) -> bool:
        """Whether the rows from an instant on determine the state, be it too weakly for folds to tell."""
        oldest = self.instants[place]
        rows = [row for row in self.rows if row.origin >= oldest]
        return self.stack(rows, self.now).window.determined()

    def _hopeless(self, floor: int) -> bool:
        """Whether all rows within reach leave directions unseen that the newest state depends on."""
        oldest = bisect_right(self.instants, floor)
        return hopeless(self._closed(self.whole, self.instants[oldest], self.now))

    def _candidates(self, place: int, before: int | None, floor: int) -> Iterator[int]:
        """Where the window may start: where it should, else as little before as it has done."""
        yield place
        if before is not None and before > floor:
            yield from range(place - 1, bisect_left(self.instants, before) - 1, -1)

    def _solution(self, deviation: Array, segment: Segment, instants: int) -> Solution:
        row = self.rows[-1]
        P = Covariance(covariance, (segment,))
        if row.origin == self.now:
            gain = Covariance(_newest_gain, (P, row))
        else:
            gain = Covariance(_late_gain, (self.copy(), row))
        x = self._reference(self.now) + deviation
        return Solution(x if self.after is None else x + self.after, P, gain, gain, instants)

    def _solve_slowly(self, limits: Limits) -> Solution | None:
        """By the recursion on gains, where the folds lose digits or the window must reach further back."""
        chosen = self.select(limits)
        if chosen is None:
            return None
        self.start = min(row.origin for row in chosen)
        segment = self._closed(self.whole, self.start, self.now)
        deviation = estimate(segment)
        instants = len(self.instants) - bisect_left(self.instants, self.start)
        self.clear = deviation is not None
        if deviation is not None:
            return self._solution(deviation, segment, instants)
        stack, joint = self._designed(chosen, self.now, self.now)
        n = len(self.center)
        x = joint.K[:n] @ stack.Z + stack.known
        newest = max(range(len(stack.rows)), key=lambda index: stack.rows[index].arrival)
        starts = stack.window.starts
        gain = Covariance.of(joint.K[:n, starts[newest] : starts[newest + 1]])
        x = x if self.after is None else x + self.after
        return Solution(x, Covariance.of(joint.P[:n, :n]), gain, gain, instants)

    def _designed(self, rows: Sequence[Row], end: int, aim: int) -> tuple[Stack, Joint]:
        """The joint gain of the states at `end` and `aim` on the rows, and their regression."""
        stack = self.stack(rows, end)
        oldest = end - len(stack.window.F)
        return stack, joint_gain(replace(stack.window, aim=aim - oldest))

    def lagged(self, aim: int, end: int, prior: Prior | None = None) -> Lagged | None:
        """The state at `aim` from the rows up to `end`: those of the window, or those since the prior.

        A state before the oldest row is that row's, carried back together with the noise between. None where
        the rows do not determine it, and before the prior, of which nobody knows what it was made of.
        """
        if prior is None:
            return self._lagged_in_window(aim, end)
        if aim < prior.time:
            return None
        known = known_start(prior.x - self._reference(prior.time), prior.P)
        first = self.head(prior.time, aim)
        # A prior has no other way: it is what the filter was told.
        trusted = np.inf
        found = split(
            known if first is None else combine(known, first), self._closed(self.tail, aim, end), trusted
        )
        return None if found is None else Lagged(self._reference(aim) + found[0], found[1], found[2])

    def _lagged_in_window(self, aim: int, end: int) -> Lagged | None:
        if self.start is None:
            return None
        # After a change of the horizon the folds may hold rows from before the window.
        before = bisect_left(self.instants, aim) < bisect_left(self.instants, self.start)
        if before or not self.clear:
            return self._lagged_slowly(self.start, aim, end)
        n, first = len(self.center), self.head(self.start, aim)
        if first is None:
            first = closing(np.zeros(n), np.zeros((n, n)))
        found = split(first, self._closed(self.tail, aim, end))
        if found is None:
            return self._lagged_slowly(self.start, aim, end)
        return Lagged(self._reference(aim) + found[0], found[1], found[2])

    def _lagged_slowly(self, start: int, aim: int, end: int) -> Lagged | None:
        stack = self.stack([row for row in self.rows if row.origin >= start], aim)
        if not stack.window.determined():
            return None
        window, n = stack.window, len(self.center)
        newest = aim - window.aim + len(window.F)
        after = [self.step(number) for number in range(newest + 1, end + 1)]
        F, Q = [step.F for step in after], [step.Q for step in after]
        joint = joint_gain(replace(window, F=[*window.F, *F], Q=[*window.Q, *Q]))
        return Lagged(joint.K[n:] @ stack.Z + stack.known, joint.P[n:, n:], joint.P[:n, n:])

    def copy(self) -> Segmented:
        """An independent copy; rows, steps and segments are immutable and shared."""
        fork = super().copy()
        if not isinstance(fork, Segmented):
            raise TypeError(f"a copy of {type(self).__name__} is one")
        fork.said, fork.instants = self.said.copy(), self.instants.copy()
        fork.references = self.references.copy()
        leaf = fork._leaf
        fork.whole, fork.head, fork.tail = self.whole.copy(leaf), self.head.copy(leaf), self.tail.copy(leaf)
        return fork


def _newest_gain(P: Covariance, row: Row) -> Array:
    """P H' R^-1: the gain on a row of the newest state."""
    return np.asarray(P.value @ row.H.T @ row.whitener.T @ row.whitener)


def _late_gain(engine: Segmented, row: Row) -> Array:
    """P_{now, origin} H' R^-1: the gain on a row of an older state, zero if the window does not reach it."""
    reached = engine.start is not None and row.origin >= engine.start
    found = engine.lagged(row.origin, engine.now) if reached else None
    if found is None:
        return np.zeros((len(engine.center), len(row.H)))
    return np.asarray(found.cross @ row.H.T @ row.whitener.T @ row.whitener)
