"""Series of anything that changes from step to step, by blocks whose steps go side by side.

Boundaries t, t + N, .. cut the series. A window is a suffix of what came before a boundary and a prefix of
what came from it on: normal equations in the state where each begins, the suffix built by backward recursion
(forward products alone, F may be singular) and nothing ever subtracted. The recursions of all blocks run
together: a step is one product of stacks of small matrices, at a cost that does not depend on N.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from .._arrays import Array
from ..engines.records import Limits
from ..gains import least_squares
from ..window import Window
from .batched import gram, laid_out, padded, positive_solution, product
from .rows import Rows
from .windows import Mask, Windows

__all__ = ["Scan", "Scanner"]

# Scaled pivots below this cost normal equations too many digits: such windows are solved one by one.
WEAK_PIVOT = 0.03
# Numbers that a table of suffixes may hold.
TABLE = 8_000_000
# Normal equations that are solved together.
TOGETHER = 4096


Scanner = Callable[[Array, Array, int, int, float, Array, Mask], None]


class Scan(Windows):
    """One series; `scanner` takes the place of the blocks side by side."""

    def __init__(
        self, rows: Rows, limits: Limits, lag: int, coasts: bool, scanner: Scanner | None = None
    ) -> None:
        super().__init__(rows.came, limits, lag, coasts, 1 + rows.longest)
        self.rows, self.scanner = rows, scanner
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
        states[:, -1] = 1.0
        G, A = self.rows.shifted()
        spacing, n = self.limits.horizon - self.lag, x.shape[1]
        if self.scanner is not None:
            self.scanner(G, A, self.limits.horizon, self.lag, WEAK_PIVOT, states, sound)
            x[...] = self.rows.recent(states, self.lag)[:, :-1, 0]
            return sound & wanted
        blocks = max(4, TABLE // (self.limits.horizon * 2 * (n + 1) * n))
        for start in range(0, len(x), blocks * spacing):
            count = min(blocks, -(-(len(x) - start) // spacing))
            _scan(G, A, start, count, self.limits.horizon, self.lag, states, sound)
        x[...] = self.rows.recent(states, self.lag)[:, :-1, 0]
        return sound & wanted

    def alone(self, step: int, begin: int, lag: int) -> Array | None:
        """One window by orthogonal transformations."""
        rows, n = self.rows, self.rows.G.shape[1] - 1
        chosen = begin + np.flatnonzero(self.came[begin : step + 1])
        if not len(chosen):
            return None
        chosen = chosen[np.argsort(self.origins[chosen], kind="stable")]
        oldest, aim = min(int(self.origins[chosen[0]]), step - lag), step - lag
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
    around = -(-horizon // spacing)  # blocks that windows of a block reach into, on either side
    first, length = start - around * spacing, (count + 2 * around) * spacing
    # Outside the series nothing comes and nothing moves: windows begin with its first row.
    moves = padded(G, first, length, np.eye(G.shape[1]))
    if first <= 0:
        moves[-first] = np.eye(G.shape[1])
    blocks = _Blocks(moves, padded(A, first, length, np.zeros(A.shape[1:])), around, count, spacing)
    # [.., length, block] is the window that ends N - 1 - length after the block's boundary.
    ends = start + horizon - 1 - np.arange(spacing)[:, None] + spacing * np.arange(count)
    _solve(*blocks.windows(lag), ends.reshape(-1), states, sound)


class _Blocks:
    """Blocks of `spacing` steps, `count` of them between `around` others on either side.

    Steps of all blocks stand side by side on the last axis: (.., .., step in the block, block). Information
    on a state is [Lam; eta'] (n + 1, n).
    """

    def __init__(self, moves: Array, rows: Array, around: int, count: int, spacing: int) -> None:
        self.around, self.count, self.spacing = around, count, spacing
        n = moves.shape[1] - 1
        self.F = self._side_by_side(moves[:, :n, :n])
        # Rows are [H, z]: information is what they have in common with H.
        self.rows = self._side_by_side(rows)
        self.rows[:, n] *= -1.0
        inputs = moves[:, :n, n:]
        self.b = self._side_by_side(inputs) if inputs.any() else None

    def _side_by_side(self, series: Array) -> Array:
        blocks = series.reshape(-1, self.spacing, *series.shape[1:]).transpose(2, 3, 1, 0)
        ordered = laid_out(*blocks.shape)
        ordered[...] = blocks
        return ordered

    def at(self, series: Array, offset: int) -> Array:
        """What the series has `offset` steps after every boundary, (.., .., count)."""
        shift, place = divmod(offset, self.spacing)
        first = self.around + shift
        return series[:, :, place, first : first + self.count]

    def windows(self, lag: int) -> tuple[Array, Array, Array]:
        """Of all windows, flat on the last axis: information on the oldest state, and the way from it.

        (n + 1, n, ..), (n, n, ..) and (n, 1, ..): the state wanted is way @ oldest + known.
        """
        n = len(self.F)
        table = laid_out(2 * n + 1, n, self.spacing, self.count)
        known = np.zeros((n, 1, self.spacing, self.count))
        self._suffixes(table, known)
        self._complete(table, known, lag)
        flat = [a.reshape(*a.shape[:2], -1) for a in (table[: n + 1], table[n + 1 :], known)]
        return flat[0], flat[1], flat[2]

    def _suffixes(self, table: Array, known: Array) -> None:
        """Information [Lam; eta'; lead] of the last rows before each boundary, and the known part there."""
        n = len(self.F)
        table[: n + 1, :, 0], table[n + 1 :, :, 0] = 0.0, np.eye(n)[:, :, None]
        for length in range(1, self.spacing):
            F, own = self.at(self.F, 1 - length), self.at(self.rows, -length)
            before, after = table[:, :, length - 1], table[:, :, length]
            if self.b is not None:
                b = self.at(self.b, 1 - length)
                known[:, :, length] = known[:, :, length - 1] + product(before[n + 1 :], b)
                before = before.copy()
                before[n] -= product(before[:n], b)[:, 0]
            moved = product(before, F)
            after[n:] = moved[n:]
            after[:n] = gram(F, moved[:n])
            after[: n + 1] += gram(own, own[:, :n])

    def _complete(self, table: Array, known: Array, lag: int) -> None:
        """Suffixes become windows, a prefix after each; the way leads to the state wanted."""
        n, horizon = len(self.F), self.spacing + lag
        ahead = np.broadcast_to(np.eye(n)[:, :, None], (n, n, self.count))
        path = np.zeros((n, 1, self.count))
        information: Array = np.zeros((n + 1, n, self.count))
        ways = deque([(ahead, path)], maxlen=lag + 1)
        for offset in range(horizon):
            if offset:
                F = self.at(self.F, offset)
                ahead = product(F, ahead)
                if self.b is not None:
                    path = product(F, path) + self.at(self.b, offset)
                ways.append((ahead, path))
            own = self.at(self.rows, offset)
            seen = np.concatenate([product(own[:, :n], ahead), own[:, n:]], axis=1)
            if self.b is not None:
                seen[:, n:] -= product(own[:, :n], path)
            information = information + gram(seen, seen[:, :n])
            if offset >= lag:
                length = horizon - 1 - offset
                self._join(table[:, :, length], known[:, :, length], information, *ways[0])

    def _join(self, window: Array, known: Array, information: Array, way: Array, path: Array) -> None:
        """A suffix and a prefix, in place."""
        n = len(way)
        lead = window[n + 1 :]
        if self.b is not None:
            information = information.copy()
            information[n] -= product(information[:n], known)[:, 0]
            known[...] = product(way, known) + path
        moved = product(information, lead)
        window[:n] += gram(lead, moved[:n])
        window[n] += moved[n]
        lead[...] = product(way, lead)


def _solve(
    information: Array, way: Array, known: Array, ends: NDArray[np.int64], states: Array, sound: Mask
) -> None:
    """States of windows, put where they end."""
    n = len(way)
    for start in range(0, len(ends), TOGETHER):
        part, at = slice(start, start + TOGETHER), ends[start : start + TOGETHER]
        normal = np.ascontiguousarray(information[:, :, part])
        solution, fine = positive_solution(normal[:n], normal[n], WEAK_PIVOT)
        fine &= at < len(states)
        with np.errstate(over="ignore", invalid="ignore"):
            reached = product(way[:, :, part], solution[:, None])[:, 0] + known[:, 0, part]
        states[at[fine], :n, 0] = reached[:, fine].T
        sound[at[fine]] = True
