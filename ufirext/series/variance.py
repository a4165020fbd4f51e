"""Minimum-variance windows of series that change from step to step, by blocks whose steps go side by side.

As `scan`, with the associative segments of minimum variance in place of sums: a window is a suffix of
segments before a boundary, a prefix after it, and the rows of its newest step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._arrays import Array
from ..engines.records import Limits
from ..joint import joint_gain
from ..window import Window
from .batched import positive_solution
from .rows import Rows
from .windows import Mask, Windows

__all__ = ["VarianceScan"]

# Scaled pivots below this cost normal equations too many digits: such windows are solved one by one.
WEAK_PIVOT = 0.03
# Numbers that a table of suffixes may hold.
TABLE = 8_000_000


class Segments(NamedTuple):
    """Segments (see `ufirext.segments`), many at once: matrices (.., n, n), vectors (.., n, 1)."""

    A: Array
    b: Array
    C: Array
    eta: Array
    J: Array

    def at(self, index: object) -> Segments:
        """Some of them."""
        return Segments(*(part[index] for part in self))  # type: ignore[call-overload]


def combined(first: Segments, second: Segments) -> Segments:
    """The segments of both, one after the other."""
    A1, b1, C1, eta1, J1 = first
    A2, b2, C2, eta2, J2 = second
    n = A1.shape[-1]
    right = np.concatenate([A1, C1, b1 + C1 @ eta2], axis=-1)
    solved = np.linalg.solve(C1 @ J2 + np.eye(n), right)
    DA, DC, Db = solved[..., :n], solved[..., n : 2 * n], solved[..., 2 * n :]
    back = DA.swapaxes(-1, -2)
    return Segments(
        A2 @ DA,
        A2 @ Db + b2,
        A2 @ DC @ A2.swapaxes(-1, -2) + C2,
        back @ (eta2 - J2 @ b1) + eta1,
        back @ J2 @ A1 + J1,
    )


class VarianceScan(Windows):
    """One series without late rows; Q is (T, n, n)."""

    def __init__(self, rows: Rows, Q: Array, limits: Limits) -> None:
        super().__init__(rows.came, limits, 0, True)
        self.rows, self.Q = rows, Q
        self.P: Array | None = None  # where covariances go, when they are wanted

    def covariances(self) -> tuple[Array, Mask]:
        """P of all windows of the plain length, (T, n, n), and where its digits will do."""
        self.P = np.empty_like(self.Q)
        sound = self.together(np.ones_like(self.came), np.empty(self.Q.shape[:2]))
        return self.P, sound

    def moved(self, x: Array, steps: NDArray[np.int64]) -> Array:
        """A step each."""
        G = self.rows.G[steps]
        return np.asarray((G[:, :-1, :-1] @ x[:, :, None])[:, :, 0] + G[:, :-1, -1])

    def together(self, wanted: Mask, x: Array) -> Mask:
        """All windows of the plain length, block by block."""
        n, horizon, sound = x.shape[1], self.limits.horizon, np.zeros_like(wanted)
        blocks = max(4, TABLE // (horizon * 3 * n * (n + 1)))
        said = self._said()
        for start in range(0, len(x), blocks * horizon):
            count = min(blocks, -(-(len(x) - start) // horizon))
            self._scan(said, start, count, x, sound)
        return sound & wanted

    def _said(self) -> tuple[Array, Array]:
        """eta and J of the rows of every step, (T, n, 1) and (T, n, n)."""
        n = self.Q.shape[1]
        H, z = self.rows.A[:, :, :n], -self.rows.A[:, :, n:]
        turned = H.swapaxes(1, 2)
        return turned @ z, turned @ H

    def _leaves(self, said: tuple[Array, Array], first: int, length: int) -> Segments:
        """Rows of each step and the transition to the next; outside the series nothing happens."""
        n = self.Q.shape[1]
        steps = np.arange(first, first + length)
        own, after = (steps >= 0) & (steps < len(self.Q)), (steps >= 0) & (steps < len(self.Q) - 1)
        leaf = Segments(
            np.tile(np.eye(n), (length, 1, 1)),
            *(np.zeros((length, n, size)) for size in (1, n, 1, n)),
        )
        leaf.eta[own], leaf.J[own] = said[0][steps[own]], said[1][steps[own]]
        G = self.rows.G[steps[after] + 1]
        leaf.A[after], leaf.b[after] = G[:, :n, :n], G[:, :n, n:]
        leaf.C[after] = self.Q[steps[after] + 1]
        return leaf

    def _scan(self, said: tuple[Array, Array], start: int, count: int, x: Array, sound: Mask) -> None:
        horizon, n = self.limits.horizon, x.shape[1]
        leaves = self._leaves(said, start - horizon, (count + 2) * horizon)

        def leaf(offset: int) -> Segments:
            first = horizon + offset
            return leaves.at(slice(first, first + (count - 1) * horizon + 1, horizon))

        nothing = Segments(
            np.tile(np.eye(n), (count, 1, 1)), *(np.zeros((count, n, size)) for size in (1, n, 1, n))
        )
        suffixes = [nothing]
        for length in range(1, horizon):
            suffixes.append(combined(leaf(-length), suffixes[-1]))
        prefix = nothing
        for offset in range(horizon):
            newest = leaf(offset)
            closing = nothing._replace(eta=newest.eta, J=newest.J)
            window = combined(combined(suffixes[horizon - 1 - offset], prefix), closing)
            self._solve(window, start + offset + horizon * np.arange(count), x, sound)
            prefix = combined(prefix, newest)

    def _solve(self, window: Segments, ends: NDArray[np.int64], x: Array, sound: Mask) -> None:
        """x^ = A J^-1 eta + b, P = A J^-1 A' + C."""
        right = window.eta
        if self.P is not None:
            right = np.concatenate([right, window.A.swapaxes(1, 2)], axis=2)
        solution, fine = positive_solution(window.J.transpose(1, 2, 0), right.transpose(1, 2, 0), WEAK_PIVOT)
        fine &= ends < len(x)
        led = window.A[fine] @ solution.transpose(2, 0, 1)[fine]
        x[ends[fine]] = led[:, :, 0] + window.b[fine, :, 0]
        if self.P is not None:
            P = led[:, :, 1:] + window.C[fine]
            self.P[ends[fine]] = 0.5 * (P + P.transpose(0, 2, 1))
        sound[ends[fine]] = True

    def alone(self, step: int, begin: int, lag: int) -> Array | None:
        """One window by the recursion on gains."""
        rows, n = self.rows, self.Q.shape[1]
        chosen = begin + np.flatnonzero(self.came[begin : step + 1])
        if not len(chosen):
            return None
        oldest = int(chosen[0])
        steps = [rows.G[number] for number in range(oldest + 1, step + 1)]
        known = [np.zeros(n)]
        for G in steps:
            known.append(G[:-1, :-1] @ known[-1] + G[:-1, -1])
        A = [rows.A[k][rows.A[k, :, :n].any(axis=1)] for k in chosen]
        window = Window(
            F=[G[:-1, :-1] for G in steps],
            Q=list(self.Q[oldest + 1 : step + 1]),
            H=[a[:, :n] for a in A],
            R=[np.eye(len(a)) for a in A],
            origins=(chosen - oldest).tolist(),
            aim=step - oldest,
            whiteners=[np.eye(len(a)) for a in A],
        )
        if not window.determined():
            return None
        free = [-a[:, n] - a[:, :n] @ known[k - oldest] for a, k in zip(A, chosen.tolist(), strict=True)]
        return np.asarray(joint_gain(window).K[:n] @ np.concatenate(free) + known[-1])
