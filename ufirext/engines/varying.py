"""The engine for whatever changes from step to step, at a cost free of the window's length.

Suffixes are built by backward recursion and nothing is ever subtracted. While a block serves, the next one's
table is built row by row, so that no step is long.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .._arrays import Array
from .._lapack import cholesky_solver
from ..window import Row
from .blocks import Block, Suffix
from .covariance import Covariance
from .records import Limits, Records, Solution

# A scaled pivot below this: the normal equations would lose too much, the reference solves instead.
WEAK_PIVOT = 1e-3
# Transitions that grow beyond this over a window make start-referenced sums lose digits: likewise.
GROWTH = 1e4
# x_u starts anew after this many horizons.
REBASE = 3


class Varying(Records):
    """Records that keep running sums over their rows; the reference solution where sums would not do."""

    limits: Limits
    active: Block | None = None
    following: Block | None = None

    @classmethod
    def over(cls, records: Records, limits: Limits) -> Varying:
        """Take over a past."""
        engine = object.__new__(cls)
        engine.__dict__.update(records.__dict__)
        engine.limits = limits
        engine.by_key, engine.active, engine.following = {}, None, None
        engine.spread = 0
        engine.counts, engine.path, engine.x_u, engine.rebuilt = {}, {}, None, records.now
        for row in records.rows:
            engine._index(row)
        return engine

    def __init__(self, first_F: Array, first_Q: Array, now: int, limits: Limits) -> None:
        super().__init__(first_F, first_Q, now)
        self.limits = limits
        self.by_key: dict[int, list[Row]] = {}
        self.spread = 0  # longest delay seen
        self.counts: dict[int, int] = {}
        self.path: dict[int, Array] = {}
        self.x_u: Array | None = None
        self.rebuilt = now

    def copy(self) -> Varying:
        """An independent copy; it builds its sums anew."""
        fork = object.__new__(Varying)
        fork.__dict__.update(self.__dict__)
        fork.steps, fork.rows = self.steps.copy(), self.rows.copy()
        fork.by_key = {key: rows.copy() for key, rows in self.by_key.items()}
        fork.active = fork.following = None
        return fork

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "active": None, "following": None}

    def _key(self, row: Row) -> int:
        return row.arrival if self.limits.by_arrival else row.origin

    def _index(self, row: Row) -> None:
        rows = self.by_key.setdefault(self._key(row), [])
        rows.append(row)
        self.spread = max(self.spread, row.arrival - row.origin)

    # -- transitions -----------------------------------------------------------------------------------------

    def advance(self, F: Array, Q: Array, known: Array | None) -> None:
        """One predict()."""
        if self.active is not None:
            self._advance_sums(F, known)
        super().advance(F, Q, known)

    def _advance_sums(self, F: Array, known: Array | None) -> None:
        block, now = self.active, self.now + 1
        if block is None:
            return
        block.advance(F)
        if self.following is not None:
            self.following.advance(F)
        self.counts[now] = self.counts[now - 1]
        if known is not None and self.x_u is None:
            self.x_u = np.zeros(len(F))
        if self.x_u is not None:
            self.x_u = F.dot(self.x_u) if known is None else F.dot(self.x_u) + known
            self.path[now] = self.x_u
            if now - self.rebuilt > REBASE * self.limits.horizon:
                self.active = None
                return
        self._prepare(block, now, F)

    def _prepare(self, block: Block, now: int, F: Array) -> None:
        """Build the following block a row at a time, and go over to it when its table reaches far enough
        back.
        """
        horizon = self.limits.horizon
        half = horizon // 2
        if self.following is None and now - 1 == block.boundary + half:
            self.following = self._block(now - 1)
            self.following.advance(F)
        following = self.following
        if following is not None:
            if len(following.suffixes) <= half:
                self._lengthen(following)
            if now - following.boundary >= horizon - half:
                self.active, self.following = following, None

    def edit(self, delta: Array, after_rows: bool) -> None:
        """x was moved from outside."""
        super().edit(delta, after_rows)
        if self.active is not None:
            self.x_u = delta if self.x_u is None else self.x_u + delta
            if not after_rows:
                self.path[self.now] = self.x_u

    def add(self, row: Row) -> None:
        """A row that arrived now."""
        super().add(row)
        row = self.rows[-1]
        spread = self.spread
        self._index(row)
        block = self.active
        if block is None:
            return
        if self.spread > spread or self._key(row) <= max(
            block.boundary, self.following.boundary if self.following else 0
        ):
            self.active = self.following = None  # the sums have no place for it
            return
        for step in range(self._key(row), self.now + 1):
            self.counts[step] += 1
        H, z = self._white(row)
        block.add(row.origin, H, z)
        if self.following is not None:
            self.following.add(row.origin, H, z)

    def _compress(self) -> None:
        """Many rows of one step become few; the sums hold them already."""
        before = len(self.rows)
        super()._compress()
        if len(self.rows) < before:
            here = [row for row in self.rows[-3:] if row.arrival == row.origin == self.now]
            self.by_key[self.now] = here
            if self.active is not None:
                self.counts[self.now] = self.counts[self.now - 1] + len(here)

    def _white(self, row: Row) -> tuple[Array, Array]:
        """The row whitened, its measurement free of x_u."""
        z, moved = row.z, self.path.get(row.origin)
        if moved is not None:
            z = z - row.H.dot(moved)
        if row.shift is not None:
            z = z - row.H.dot(row.shift)
        return row.white, row.whitener.dot(z)

    def forget(self, limits: Limits) -> None:
        """Drop what no window can reach any more, two steps late: covariances are worked out afterwards."""
        bound = self.now - limits.reach - 2
        if not self.rows or self._key(self.rows[0]) > bound - max(32, limits.reach // 2):
            return  # in batches: a step costs the same at every horizon
        self.rows = [row for row in self.rows if self._key(row) > bound]
        kept = bound - self.spread - limits.reach
        for table in (self.by_key, self.counts, self.path):
            for step in [step for step in table if step <= kept]:
                del table[step]
        # The blocks still ask for the transitions from their frames on.
        frames = [block.frame for block in (self.active, self.following) if block is not None]
        oldest = min([bound, *frames, *(row.origin for row in self.rows)])
        while self.first < oldest:
            self.steps.popleft()
            self.first += 1

    # -- blocks ----------------------------------------------------------------------------------------------

    def _block(self, boundary: int) -> Block:
        block = Block(boundary, boundary - self.spread, len(self.steps[-1].F))
        for step in range(block.frame + 1, boundary + 1):
            block.advance(self.step(step).F)
        return block

    def _lengthen(self, block: Block) -> None:
        """One more suffix: the rows of the next older key join, in the frame of the oldest origin."""
        Lam, eta, lead = block.suffixes[-1]
        rows = self.by_key.get(block.boundary - len(block.suffixes) + 1, ())
        for row in rows:
            while block.oldest > row.origin:
                F = self.step(block.oldest).F
                Lam, eta, lead = F.T.dot(Lam).dot(F), eta.dot(F), lead.dot(F)
                block.oldest -= 1
        products: dict[int, Array] = {}
        for row in rows:
            H, z = self._white(row)
            if row.origin > block.oldest:
                if not products:
                    products = self._products(block.oldest, max(r.origin for r in rows))
                H = H.dot(products[row.origin])
            Lam, eta = Lam + H.T.dot(H), eta + z.dot(H)
        block.suffixes.append(Suffix(Lam, eta, lead))

    def _products(self, start: int, stop: int) -> dict[int, Array]:
        products = {start: np.eye(len(self.steps[-1].F))}
        for step in range(start + 1, stop + 1):
            products[step] = self.step(step).F.dot(products[step - 1])
        return products

    def _build(self) -> Block:
        """All sums anew, with x_u from zero at the oldest step a window or a late row can need."""
        horizon, now = self.limits.horizon, self.now
        self.following, self.rebuilt = None, now
        start = now - horizon - self.spread
        self._retrace(start)
        self.counts = {start - 1: 0}
        total = 0
        for step in range(start, now + 1):
            total += len(self.by_key.get(step, ())) if step > now - horizon else 0
            self.counts[step] = total
        block = self.active = self._block(now)
        for _ in range(horizon):
            self._lengthen(block)
        return block

    def _retrace(self, start: int) -> None:
        """x_u as a trajectory from zero at `start`; none at all where nothing is known."""
        steps = {step: self.step(step) for step in range(start + 1, self.now + 1)}
        self.path, self.x_u = {}, None
        if self.after is None and all(step.known is None for step in steps.values()):
            return
        moved = np.zeros(len(self.steps[-1].F))
        for number, step in steps.items():
            moved = step.F.dot(moved) if step.known is None else step.F.dot(moved) + step.known
            self.path[number] = moved
        self.x_u = moved if self.after is None else moved + self.after

    # -- the estimate ----------------------------------------------------------------------------------------

    def solve(self, limits: Limits, lag: int = 0, rows: object = None) -> Solution | None:
        """Least squares over the window; the reference solution for lags and where sums would not do."""
        if lag or rows is not None or limits != self.limits:
            return super().solve(limits, lag)
        x = self._from_sums()
        if x is None:
            return super().solve(limits)
        past = Past(self, self.now, self.rows[-1] if self.rows else None)
        return Solution(
            x,
            Covariance(_covariance, (past,)),
            Covariance(_gain, (past,)),
            Covariance(_newest, (past,)),
            self._count(),
        )

    def _count(self) -> int:
        now = self.now
        return self.counts[now] - self.counts.get(now - self.limits.horizon, 0)

    def _enough(self, wanted: int) -> bool:
        """Whether the window holds rows of so many origins."""
        origins = set()
        for key in range(self.now, self.now - self.limits.horizon, -1):
            for row in self.by_key.get(key, ()):
                origins.add(row.origin)
            if len(origins) >= wanted:
                return True
        return False

    def _from_sums(self) -> Array | None:
        limits, now = self.limits, self.now
        block = self.active
        if block is None or not 0 <= block.boundary - now + limits.horizon < len(block.suffixes):
            block = self._build()
        if limits.extends and not self._enough(min(limits.horizon, limits.instants)):
            return None
        Lam, eta, lead = block.suffixes[block.boundary - now + limits.horizon]
        Lam = Lam + lead.T.dot(block.Lam.dot(lead))
        scale = np.sqrt(Lam.diagonal())
        ahead = block.products[now - block.frame].dot(lead)
        if not min(scale.tolist()) > 0.0 or np.vdot(ahead, ahead) > GROWTH**2:
            return None
        factor, solution, info = cholesky_solver()(
            Lam / np.multiply.outer(scale, scale), (eta + block.eta.dot(lead)) / scale
        )
        if info or min(factor.diagonal().tolist()) < WEAK_PIVOT:
            return None
        x: Array = ahead.dot(solution / scale)
        return x if self.x_u is None else x + self.x_u


class Past(NamedTuple):
    """The engine as it stood: enough to work out later what nobody has asked for yet."""

    engine: Varying
    now: int
    newest: Row | None

    def solution(self) -> Solution:
        """The reference solution of then."""
        engine = self.engine
        records = Records.copy(engine)
        rows = engine.rows
        place = next((i for i in range(len(rows) - 1, -1, -1) if rows[i] is self.newest), None)
        if place is None:
            raise RuntimeError("the window of this estimate is gone; read P within the step")
        records.rows = rows[: place + 1]
        while records.now > self.now:
            records.steps.pop()
            records.now -= 1
        records.after = None
        result = Records.solve(records, engine.limits)
        if result is None:
            raise RuntimeError(f"the window of step {self.now} has no estimate")
        return result


def _covariance(past: Past) -> Array:
    return past.solution().covariance.value


def _gain(past: Past) -> Array:
    return past.solution().gain.value


def _newest(past: Past) -> Array:
    return past.solution().newest_gain.value
