"""Series of anything that changes from step to step, by blocks whose steps go side by side.

Boundaries t, t + N, .. cut the series. A window is a suffix of what came before a boundary and a prefix of
what came from it on: normal equations in the state where each begins, the suffix built by backward recursion
(forward products alone, F may be singular) and nothing ever subtracted. The recursions of all blocks run
together: a step is one product of stacks of small matrices, at a cost that does not depend on N.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from .._arrays import Array
from ..engines.records import Limits
from ..gains import least_squares
from ..window import Window
from .batched import positive_solution
from .rows import Rows
from .windows import Mask, Windows

__all__ = ["Scan"]

# Scaled pivots below this cost normal equations too many digits: such windows are solved one by one.
WEAK_PIVOT = 0.03
# Numbers that a table of suffixes may hold.
TABLE = 8_000_000
# Normal equations that are solved together.
TOGETHER = 4096


class Scan(Windows):
    """One series."""

    def __init__(self, rows: Rows, limits: Limits, lag: int, coasts: bool) -> None:
        super().__init__(rows.came, limits, lag, coasts, 1 + rows.longest)
        self.rows = rows
        self.origins = np.arange(len(rows.came)) - rows.delays

    def instants(self, step: int, begin: int) -> int:
        """Number of instants measured by the rows that came in begin .. step."""
        window = slice(begin, step + 1)
        return len(np.unique(self.origins[window][self.came[window]]))

    def moved(self, x: Array, steps: NDArray[np.int64]) -> Array:
        """A step each."""
        G = self.rows.G[steps]
        return np.asarray((G[:, :-1, :-1] @ x[:, :, None])[:, :, 0] + G[:, :-1, -1])

    def together(self, wanted: Mask, x: Array) -> Mask:
        """All windows of the plain length, block by block."""
        sound = np.zeros_like(wanted)
        states = np.zeros((len(x), x.shape[1] + 1, 1))
        G, A = self.rows.shifted()
        spacing = self.limits.horizon - self.lag
        size = G.shape[1]
        blocks = max(4, TABLE // (self.limits.horizon * 2 * size * size))
        for start in range(0, len(x), blocks * spacing):
            count = min(blocks, -(-(len(x) - start) // spacing))
            _scan(G, A, start, count, self.limits.horizon, self.lag, states, sound)
        x[...] = self.rows.recent(states, self.lag)[:, :-1, 0]
        return sound & wanted

    def alone(self, step: int, begin: int) -> Array | None:
        """One window by orthogonal transformations."""
        rows, n = self.rows, self.rows.G.shape[1] - 1
        chosen = begin + np.flatnonzero(self.came[begin : step + 1])
        if not len(chosen):
            return None
        chosen = chosen[np.argsort(self.origins[chosen], kind="stable")]
        oldest, aim = min(int(self.origins[chosen[0]]), step - self.lag), step - self.lag
        newest = max(aim, int(self.origins[chosen[-1]]))
        steps = [rows.step(number) for number in range(oldest + 1, newest + 1)]
        known = [np.zeros(n)]
        for G in steps:
            known.append(G[:-1, :-1] @ known[-1] + G[:-1, -1])
        A = [rows.A[k][rows.A[k, :, :n].any(axis=1)] for k in chosen]
        places = [int(o) - oldest for o in self.origins[chosen]]
        window = Window(
            F=[G[:-1, :-1] for G in steps],
            Q=[],
            H=[a[:, :n] for a in A],
            R=[np.eye(len(a)) for a in A],
            origins=places,
            aim=aim - oldest,
            whiteners=[np.eye(len(a)) for a in A],
        )
        if not window.determined():
            return None
        free = [-a[:, n] - a[:, :n] @ known[place] for a, place in zip(A, places, strict=True)]
        return np.asarray(least_squares(window) @ np.concatenate(free) + known[aim - oldest])


def _scan(
    G: Array, A: Array, start: int, count: int, horizon: int, lag: int, states: Array, sound: Mask
) -> None:
    """Windows that end in start + lag .. of `count` blocks: homogeneous states, and where they are good."""
    spacing = horizon - lag
    first, stop = start - horizon + 1, start + (count - 1) * spacing + horizon
    # Outside the series nothing comes and nothing moves: windows begin with its first row.
    moves = _around(G, first, stop, np.eye(G.shape[1]))
    if first <= 0:
        moves[-first] = np.eye(G.shape[1])
    blocks = _Blocks(moves, _around(A, first, stop, np.zeros(A.shape[1:])), horizon - 1, count, spacing)
    table = blocks.suffixes()
    blocks.complete(table, lag)
    # table[length, block] is the window that ends N - 1 - length after the block's boundary.
    ends = start + horizon - 1 - np.arange(spacing)[:, None] + spacing * np.arange(count)
    _solve(table.reshape(-1, *table.shape[2:]), ends.reshape(-1), states, sound)


def _around(series: Array, first: int, stop: int, outside: Array) -> Array:
    """series[first:stop], with `outside` before and after its ends."""
    inner = series[max(first, 0) : max(stop, 0)]
    whole = np.empty((stop - first, *outside.shape))
    before = min(max(-first, 0), len(whole))
    whole[:before], whole[before + len(inner) :] = outside, outside
    whole[before : before + len(inner)] = inner
    return whole


class _Blocks:
    """Boundaries `origin` + j `spacing`, j < count, in series of moves (.., k, k) and rows (.., m, k)."""

    def __init__(self, moves: Array, rows: Array, origin: int, count: int, spacing: int) -> None:
        self.moves, self.rows = moves, rows
        self.origin, self.count, self.spacing = origin, count, spacing

    def at(self, series: Array, offset: int) -> Array:
        """What the series has `offset` steps after every boundary."""
        first = self.origin + offset
        return series[first : first + (self.count - 1) * self.spacing + 1 : self.spacing]

    def suffixes(self) -> Array:
        """(spacing, count, 2 k, k): information of the last rows before each boundary, and the way to it."""
        k = self.moves.shape[1]
        table = np.empty((self.spacing, self.count, 2 * k, k))
        table[0, :, :k], table[0, :, k:] = 0.0, np.eye(k)
        for length in range(1, self.spacing):
            move, own = self.at(self.moves, 1 - length), self.at(self.rows, -length)
            new = table[length]
            np.matmul(table[length - 1], move, out=new)
            new[:, :k] = move.transpose(0, 2, 1) @ new[:, :k]
            new[:, :k] += own.transpose(0, 2, 1) @ own
        return table

    def complete(self, table: Array, lag: int) -> None:
        """Suffixes become windows: normal equations of the oldest state, and the way to the one wanted."""
        k, horizon = self.moves.shape[1], self.spacing + lag
        ahead = np.broadcast_to(np.eye(k), (self.count, k, k))
        information = np.zeros((self.count, k, k))
        ways = deque([ahead], maxlen=lag + 1)
        for offset in range(horizon):
            if offset:
                ahead = self.at(self.moves, offset) @ ahead
                ways.append(ahead)
            own = self.at(self.rows, offset) @ ahead
            information += own.transpose(0, 2, 1) @ own
            if offset >= lag:
                window = table[horizon - 1 - offset]
                lead = window[:, k:].copy()
                window[:, :k] += lead.transpose(0, 2, 1) @ (information @ lead)
                np.matmul(ways[0], lead, out=window[:, k:])


def _solve(windows: Array, ends: NDArray[np.int64], states: Array, sound: Mask) -> None:
    """Homogeneous states of the windows (count, 2 k, k), put where they end."""
    k = windows.shape[2]
    n = k - 1
    for start in range(0, len(windows), TOGETHER):
        part, at = windows[start : start + TOGETHER], ends[start : start + TOGETHER]
        normal = np.ascontiguousarray(part[:, :n].transpose(1, 2, 0))
        solution, fine = positive_solution(normal[:, :n], -normal[:, n], WEAK_PIVOT)
        fine &= at < len(states)
        at = at[fine]
        oldest = np.concatenate([solution.T[fine], np.ones((len(at), 1))], axis=1)
        states[at] = part[fine, k:] @ oldest[:, :, None]
        sound[at] = True
