"""The engine for whatever changes from step to step, at a cost free of the window's length.

Suffixes are built by backward recursion and nothing is ever subtracted. While a block serves, the next one's
table is built row by row, so that no step is long.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import dropwhile, takewhile
from operator import attrgetter
from typing import NamedTuple, Self

import numpy as np

from .._arrays import Array
from .._lapack import cholesky_solver
from ..window import Row, well_scaled
from .blocks import Block, Suffix
from .covariance import Covariance
from .exact import window_covariance
from .records import Limits, Records, Solution

# A scaled pivot below this: the normal equations would lose too much, the reference solves instead.
WEAK_PIVOT = 0.03
# Transitions that grow beyond this over a window make start-referenced sums lose digits: likewise.
GROWTH = 1e4
# Two blocks are kept for one part in so many of the steps, in which the table of the next one is built.
OVERLAP = 8


class Varying(Records):
    """Records that keep running sums over their rows; the reference solution where sums would not do."""

    limits: Limits
    active: Block | None = None
    following: Block | None = None

    @classmethod
    def over(cls, records: Records, limits: Limits) -> Self:
        """Take over a past."""
        engine = object.__new__(cls)
        engine.__dict__.update(records.__dict__)
        engine._begin(limits)
        for row in records.rows:
            engine._index(row)
        return engine

    def __init__(self, first_F: Array, first_Q: Array, now: int, limits: Limits) -> None:
        super().__init__(first_F, first_Q, now)
        self._begin(limits)

    def _begin(self, limits: Limits) -> None:
        self.limits = limits
        # What the window counts from: when a row arrived, or where its state lies.
        self._key: Callable[[Row], int] = attrgetter("arrival" if limits.by_arrival else "origin")
        self.active = self.following = None
        self.by_key: dict[int, list[Row]] = {}
        self.spread = 0  # longest delay seen
        # Up to each key: rows, and steps that brought one of their own (at least so many instants).
        self.tallies: dict[int, tuple[int, int]] = {}
        self.next_forget = self.now

    def copy(self) -> Self:
        """An independent copy; it builds its sums anew."""
        fork = object.__new__(type(self))
        fork.__dict__.update(self.__dict__)
        fork.steps, fork.rows = self.steps.copy(), self.rows.copy()
        fork.by_key = {key: rows.copy() for key, rows in self.by_key.items()}
        fork.active = fork.following = None
        return fork

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "active": None, "following": None}

    def _index(self, row: Row) -> None:
        self.by_key.setdefault(self._key(row), []).append(row)
        self.spread = max(self.spread, row.arrival - row.origin)

    # -- transitions -----------------------------------------------------------------------------------------

    def advance(self, F: Array, Q: Array, known: Array | None) -> None:
        """One predict()."""
        super().advance(F, Q, known)
        active, following, now = self.active, self.following, self.now
        if active is None:
            return
        E = self.steps[-1].affine
        active.advance(E)
        self.tallies[now] = self.tallies[now - 1]
        # The following block takes over, `overlap` steps old, when the table of the active one ends.
        horizon, overlap = self.limits.horizon, max(1, self.limits.horizon // OVERLAP)
        if following is not None:
            following.advance(E)
        elif now - active.boundary > horizon - overlap:
            following = self.following = self._block(now - 1)
            following.advance(E)
        if following is not None:
            for _ in range(min(OVERLAP + 1, horizon - overlap + 1 - len(following.suffixes))):
                self._lengthen(following)  # a few at a time, so that no step is long
            if now - active.boundary >= horizon:
                self.active, self.following = following, None

    def edit(self, delta: Array, after_rows: bool) -> None:
        """x was moved from outside."""
        super().edit(delta, after_rows)
        if not after_rows:
            for block in (self.active, self.following):
                if block is not None:
                    block.move(delta)

    def add(self, row: Row) -> None:
        """A row that arrived now."""
        super().add(row)
        row = self.rows[-1]
        spread, key = self.spread, self._key(row)
        self._index(row)
        active, following = self.active, self.following
        if active is None:
            return
        newest = active.boundary if following is None else following.boundary
        if self.spread > spread or key <= newest:
            self.active = self.following = None  # the sums have no place for it
            return
        alone = row.origin == self.now and len(self.by_key[key]) == 1
        for step in range(key, self.now + 1):
            count, instants = self.tallies[step]
            self.tallies[step] = count + 1, instants + alone
        active.add(row.origin, row.gram)
        if following is not None:
            following.add(row.origin, row.gram)

    def _compress(self) -> None:
        """Many rows of one step become few; the sums hold them already."""
        before = len(self.rows)
        super()._compress()
        if len(self.rows) < before:
            here = [row for row in self.rows[-3:] if row.arrival == row.origin == self.now]
            self.by_key[self.now] = here
            if self.active is not None:
                count, instants = self.tallies[self.now - 1]
                self.tallies[self.now] = count + len(here), instants + 1

    def forget(self, limits: Limits) -> None:
        """Drop what no window can reach any more, two steps late: covariances are worked out afterwards."""
        if self.now < self.next_forget:
            return  # in batches: a step costs the same at every horizon
        self.next_forget = self.now + max(32, limits.reach // 2)
        bound = self.now - limits.reach - 2
        self.rows = [row for row in self.rows if self._key(row) > bound]
        kept = bound - self.spread - limits.reach
        for table in (self.by_key, self.tallies):
            while table and (oldest := next(iter(table))) <= kept:
                del table[oldest]
        # The blocks still ask for the transitions from their frames on.
        frames = [block.frame for block in (self.active, self.following) if block is not None]
        first = min([bound, *frames, *(row.origin for row in self.rows)])
        while self.first < first:
            self.steps.popleft()
            self.first += 1

    # -- blocks ----------------------------------------------------------------------------------------------

    def _block(self, boundary: int) -> Block:
        block = Block(boundary, boundary - self.spread, len(self.steps[-1].F))
        for step in range(block.frame + 1, boundary + 1):
            block.advance(self.step(step).affine)
        return block

    def _lengthen(self, block: Block) -> None:
        """One more suffix: the rows of the next older key join, in the frame of the oldest origin."""
        total, lead = block.suffixes[-1]
        rows = self.by_key.get(block.boundary - len(block.suffixes) + 1, ())
        for row in rows:
            while block.oldest > row.origin:
                E = self.step(block.oldest).affine
                total, lead = E.T.dot(total.dot(E)), lead.dot(E)
                block.oldest -= 1
        ahead, step = None, block.oldest
        for row in sorted(rows, key=lambda row: row.origin) if len(rows) > 1 else rows:
            while step < row.origin:
                step += 1
                E = self.step(step).affine
                ahead = E if ahead is None else E.dot(ahead)
            total = total + (row.gram if ahead is None else ahead.T.dot(row.gram.dot(ahead)))
        block.suffixes.append(Suffix(total, lead))

    def _build(self) -> Block:
        """All sums anew."""
        horizon, now = self.limits.horizon, self.now
        start = now - horizon - self.spread
        count = instants = 0
        self.tallies = {start - 1: (0, 0)}
        for step in range(start, now + 1):
            rows = self.by_key.get(step, ()) if step > now - horizon else ()
            count += len(rows)
            instants += any(row.origin == step for row in rows)
            self.tallies[step] = count, instants
        self.following, block = None, self._block(now)
        for _ in range(horizon):
            self._lengthen(block)
        self.active = block
        return block

    # -- the estimate ----------------------------------------------------------------------------------------

    def solve(self, limits: Limits, lag: int = 0, rows: object = None) -> Solution | None:
        """Least squares over the window; the reference solution for lags and where sums would not do."""
        if lag or rows is not None or (limits is not self.limits and limits != self.limits):
            return super().solve(limits, lag)
        x = self._from_sums()
        if x is None:
            return super().solve(limits)
        past = (Past(self, self.now, self.rows[-1] if self.rows else None),)
        return Solution(
            x if self.after is None else x + self.after,
            Covariance(_covariance, past),
            Covariance(_gain, past),
            Covariance(_newest, past),
            self._tally(0),
        )

    def _tally(self, which: int) -> int:
        tallies, before = self.tallies, self.now - self.limits.horizon
        return tallies[self.now][which] - (tallies[before][which] if before in tallies else 0)

    def _enough(self, wanted: int) -> bool:
        """Whether the window holds rows of so many origins."""
        if self._tally(1) >= wanted:
            return True
        window = range(self.now, self.now - self.limits.horizon, -1)
        return len({row.origin for key in window for row in self.by_key.get(key, ())}) >= wanted

    def _from_sums(self) -> Array | None:
        limits, now, block = self.limits, self.now, self.active
        bound = now - limits.horizon
        if block is None or not 0 <= block.boundary - bound < len(block.suffixes):
            block = self._build()
        if limits.extends and not self._enough(min(limits.horizon, limits.instants)):
            return None
        total, ahead = block.window(bound)
        Lam, Phi, flat = total[:-1, :-1], ahead[:-1, :-1], ahead.ravel()
        factor, solution, info = cholesky_solver()(Lam, total[:-1, -1])
        if info or not well_scaled(factor, Lam, WEAK_PIVOT**2):
            return None
        if flat.dot(flat) > GROWTH**2 and np.vdot(Phi, Phi) > GROWTH**2:
            return None
        x: Array = ahead[:-1, -1] - Phi.dot(solution)
        return x


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
