"""The engine for whatever changes from step to step, at a cost free of the window's length."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator
from itertools import dropwhile, takewhile
from operator import attrgetter
from typing import NamedTuple, Self

from .._arrays import Array
from ..window import Row
from .covariance import Covariance
from .exact import window_covariance
from .frames import Frames
from .hands import QuickRow
from .records import Limits, Records, Solution, Step
from .suffixes import Suffixes

# Forgetting a few steps at a time costs the same at every horizon, and no step is long.
FORGET_EVERY = 32


class Varying(Records):
    """Records that keep running sums over their rows; the reference solution where sums would not do.

    The sums are quick ones in the frame before the window (`Frames`), or careful ones in the frame of its
    oldest row (`Suffixes`) where those lose too many digits.
    """

    limits: Limits
    sums: Frames | Suffixes | None = None

    @classmethod
    def over(cls, records: Records, limits: Limits) -> Self:
        """Take over a past."""
        engine = object.__new__(cls)
        engine.__dict__.update(records.__dict__)
        # Covariances that nobody has read yet lean on the other one as it stands.
        engine.steps, engine.rows, engine.peaks = records.steps.copy(), records.rows.copy(), None
        engine._begin(limits)
        return engine

    def __init__(self, first_F: Array, first_Q: Array, now: int, limits: Limits) -> None:
        super().__init__(first_F, first_Q, now)
        self._begin(limits)

    def _begin(self, limits: Limits) -> None:
        self.limits = limits
        # Steps with a row of their own, for a window that need not reach further back.
        self.wanted = min(limits.horizon, limits.instants) if limits.extends else 0
        # What the window counts from: when a row arrived, or where its state lies.
        self._key: Callable[[Row], int] = attrgetter("arrival" if limits.by_arrival else "origin")
        self.sums = None
        self.delays = max((row.arrival - row.origin for row in self.rows), default=0)  # the longest seen
        self.next_forget = self.now
        self.careful_until = self.now  # sums are careful ones before this step,
        self.care = limits.horizon  # and the next time for so many
        self.lost: int | None = None  # the age at which quick ones have lost digits

    def copy(self) -> Self:
        """An independent copy; it builds its sums anew."""
        fork = object.__new__(type(self))
        fork.__dict__.update(self.__dict__)
        fork.steps, fork.rows = self.steps.copy(), self.rows.copy()
        fork.sums = fork.peaks = None
        return fork

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "sums": None}

    # -- transitions -----------------------------------------------------------------------------------------

    def advance(self, F: Array, Q: Array, known: Array | None) -> None:
        """One predict()."""
        super().advance(F, Q, known)
        if self.sums is not None:
            step = self.steps[-1]
            self.sums.advance(self, step.F, step.known)

    def turned(self, sums: Frames, step: Step, F: Array) -> None:
        """One predict() after which nothing was edited; `F` is the step's."""
        self.steps.append(step)
        self.now += 1
        sums.advance(self, F, step.known)

    def edit(self, delta: Array, after_rows: bool) -> None:
        """x was moved from outside."""
        super().edit(delta, after_rows)
        if not after_rows and self.sums is not None:
            self.sums.move(delta)

    def add(self, row: Row) -> None:
        """A row that arrived now."""
        super().add(row)
        row = self.rows[-1]
        self.delays = max(self.delays, self.now - row.origin)
        if self.sums is not None and not self.sums.add(row, self.now):
            self.sums = None

    def _compress(self) -> None:
        """Many rows of one step become few; the sums hold them already."""
        before = len(self.rows)
        super()._compress()
        if len(self.rows) < before and self.sums is not None:
            self.sums.merged([row for row in self.rows[-3:] if row.arrival == row.origin == self.now])

    def forget(self, limits: Limits) -> None:
        """Drop what no window can reach any more, two steps late: covariances are worked out afterwards."""
        if self.now < self.next_forget:
            return
        self.next_forget = self.now + FORGET_EVERY
        bound = self.now - limits.reach - 2
        # In the order of arrival, and no row arrives before its origin.
        del self.rows[: bisect_right(self.rows, bound, key=attrgetter("arrival"))]
        first = bound - self.delays
        if self.sums is not None:  # which still ask for the transitions from their frames on
            first = min(first, self.sums.frame)
        while self.first < first:
            self.steps.popleft()
            self.first += 1

    # -- the estimate ----------------------------------------------------------------------------------------

    def solve(self, limits: Limits, lag: int = 0, rows: object = None) -> Solution | None:
        """Least squares over the window; the reference solution for lags and where sums would not do."""
        if lag or rows is not None or (limits is not self.limits and limits != self.limits):
            return super().solve(limits, lag)
        x = self._from_sums()
        if x is None:
            return super().solve(limits)
        newest = self.rows[-1] if self.rows else None
        x = x if self.after is None else x + self.after
        return estimate_of(self, x, self.now, newest, self.window_rows)

    def joined(self, sums: Frames, row: QuickRow) -> Array | None:
        """x with a row that arrived now; None, with nothing done, where the reference is needed."""
        again = bool(self.rows) and self.rows[-1].arrival == self.now
        if sums.instants + (not again) < self.wanted or not sums.take():
            return None
        if again:
            self._compress()
        self.rows.append(row)
        x = sums.estimate()
        if x is None:
            self.rows.pop()
            self.sums, self.lost = None, sums.age
        elif self.now >= self.next_forget:
            self.forget(self.limits)
        return x

    @property
    def window_rows(self) -> int:
        """Rows in the window, as the sums count them."""
        return 0 if self.sums is None else self.sums.rows

    def _from_sums(self) -> Array | None:
        sums = self.sums
        if sums is None or (self.now >= self.careful_until and isinstance(sums, Suffixes)):
            sums = self.sums = self._summed_up()
        if self.wanted and not self._enough(sums):
            return None
        x = sums.estimate()
        while x is None and isinstance(sums, Frames):
            self.lost = sums.age
            sums = self.sums = self._summed_up()
            x = sums.estimate()
        return x

    def _summed_up(self) -> Frames | Suffixes:
        """All sums anew: the quick ones, unless they have lost digits soon after they were made."""
        lost, self.lost = self.lost, None
        if lost is not None and 2 * lost < self.limits.horizon:
            self.careful_until, self.care = self.now + self.care, 2 * self.care
        kind = Suffixes if self.now < self.careful_until else Frames
        return kind(self, self.limits, self.delays)

    def _enough(self, sums: Frames | Suffixes) -> bool:
        """Whether the window holds rows of enough origins, so that it need not reach further back."""
        if sums.instants >= self.wanted:
            return True
        bound = self.now - self.limits.horizon
        return len({row.origin for row in self.rows if self._key(row) > bound}) >= self.wanted


def estimate_of(engine: Varying, x: Array, now: int, newest: Row | None, rows: int) -> Solution:
    """x, the estimate of a window as it stood at a step, and what can be asked about it."""
    past = (Past(engine, now, newest),)
    covariance, gain, newest_gain = (Covariance(later, past) for later in (_covariance, _gain, _newest))
    return Solution(x, covariance, gain, newest_gain, rows)


class Past(NamedTuple):
    """The engine as it stood: enough to work out later what nobody has asked for yet."""

    engine: Varying
    now: int
    newest: Row | None

    def rows(self) -> Iterator[Row]:
        """All rows of then, the last to arrive first."""
        return dropwhile(lambda row: row is not self.newest, reversed(self.engine.rows))

    def solution(self) -> Solution:
        """The reference solution of then."""
        engine = self.engine
        records = Records.copy(engine)
        records.rows = list(self.rows())[::-1]
        while records.now > self.now:
            records.steps.pop()
            records.now -= 1
        records.after = None
        result = Records.solve(records, engine.limits)
        if result is None:
            raise RuntimeError("the window of this estimate is gone; read P within the step")
        return result

    def covariance(self) -> Array:
        """P of then."""
        engine, earlier = self.engine, self.rows()
        bound = self.now - engine.limits.horizon
        if engine.limits.by_arrival:
            earlier = takewhile(lambda row: row.arrival > bound, earlier)
        rows = [row for row in earlier if engine._key(row) > bound]
        if not rows:
            raise RuntimeError("the window of this estimate is gone; read P within the step")
        if all(row.correlation is None for row in rows):
            P = window_covariance(rows, engine.step, self.now)
            if P is not None:
                return P
        return self.solution().covariance.value


def _covariance(past: Past) -> Array:
    return past.covariance()


def _gain(past: Past) -> Array:
    return past.solution().gain.value


def _newest(past: Past) -> Array:
    return past.solution().newest_gain.value
