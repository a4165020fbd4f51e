"""Segments of consecutive steps as associative elements: neighbours combine, and a window is a combination.

A segment knows what its rows say about its first state, N(x_start; information eta, J), and how its last
state follows from the first given those rows: x_end = A x_start + b + error of covariance C. Särkkä and
García-Fernández, "Temporal parallelization of Bayesian smoothers", IEEE TAC 66(1), 2021, lemma 8, used here
without a prior, equation :eq:`segments`: nothing is downdated, and neither F nor Q is inverted, so the cost
of a sliding window does not depend on its length.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dgesv

from ._arrays import Array, symmetric
from ._rounding import carried_rounding, drowned

__all__ = [
    "Segment",
    "SlidingFold",
    "closing",
    "combine",
    "covariance",
    "estimate",
    "hopeless",
    "known_start",
    "split",
    "transition",
]

# Eigenvalues of the scaled information below the first fraction of the largest are zero; between the two
# nobody can tell, and the window is left to a method that does not square its condition.
NOTHING, SOMETHING = 1e-14, 1e-8
# A direction that is not seen must not reach the last state by more than this.
REACH_TOLERANCE = 1e-8
# Measurements so much better than predictions, as a ratio of variances, cost half of the digits.
TRUSTED = 1e6


class Segment(NamedTuple):
    """x_end = A x_start + b + N(0, C) given the rows; the rows say eta = J x_start + N(0, J).

    `loss` is the largest trace(C J) of the combinations it was made by: (I + C J)^-1 costs so many ulps.
    `rounding`, (n,), is what arithmetic alone may have left on the diagonal of J.
    """

    A: Array
    b: Array
    C: Array
    eta: Array
    J: Array
    loss: float
    rounding: Array


def transition(F: Array, known: Array, Q: Array, eta: Array, J: Array) -> Segment:
    """One step: rows with (eta, J) = (H'R^-1 z, H'R^-1 H) on a state, then F, a known input and Q."""
    return Segment(F, known, Q, eta, J, 0.0, np.zeros(len(eta)))


def closing(eta: Array, J: Array) -> Segment:
    """The newest step: its rows, and no transition after them."""
    n = len(eta)
    return Segment(np.eye(n), np.zeros(n), np.zeros((n, n)), eta, J, 0.0, np.zeros(n))


def known_start(x: Array, P: Array) -> Segment:
    """A state that is known beforehand with mean x and covariance P, whatever was before."""
    n = len(x)
    return Segment(np.zeros((n, n)), x, P, np.zeros(n), np.zeros((n, n)), 0.0, np.zeros(n))


def combine(first: Segment, second: Segment) -> Segment:
    """The segment of both, one after the other; associative."""
    A1, b1, C1, eta1, J1, loss1, rounding1 = first
    A2, b2, C2, eta2, J2, loss2, rounding2 = second
    loss = max(loss1, loss2, float(np.vdot(C1, J2)))
    if not J2.any():
        return Segment(A2 @ A1, A2 @ b1 + b2, A2 @ C1 @ A2.T + C2, eta1, J1, loss, rounding1)
    # D = (I + C1 J2)^-1 on everything at once.
    DA, DC, Db = _shared(A1, C1, b1 + C1 @ eta2, J2)
    back = DA.T
    return Segment(
        A2 @ DA,
        A2 @ Db + b2,
        A2 @ DC @ A2.T + C2,
        back @ (eta2 - J2 @ b1) + eta1,
        back @ J2 @ A1 + J1,
        loss,
        rounding1 + carried_rounding(A1, J2, rounding2),
    )


def _shared(A: Array, C: Array, b: Array, J: Array) -> tuple[Array, Array, Array]:
    """D A, D C, D b with D = (I + C J)^-1, which exists: the eigenvalues of C J are real and not negative."""
    n, columns = C.shape[0], A.shape[1]
    right = np.empty((n, columns + n + 1), order="F")
    right[:, :columns], right[:, columns:-1], right[:, -1] = A, C, b
    left = C @ J
    left.flat[:: n + 1] += 1.0
    solved: Array = dgesv(left, right, overwrite_b=True)[2]
    return solved[:, :columns], solved[:, columns:-1], solved[:, -1]


def estimate(whole: Segment) -> Array | None:
    """Minimum-variance unbiased estimate of the last state; None where it is not clearly determined, or where
    too many digits were lost on the way.
    """
    if whole.loss > TRUSTED:
        return None
    root = _inverse_root(whole.J, whole.A, whole.rounding)
    return None if root is None else whole.A @ (root @ (root.T @ whole.eta)) + whole.b


def covariance(whole: Segment) -> Array:
    """Error covariance of `estimate`: A J^+ A' + C."""
    root = _inverse_root(whole.J, whole.A, whole.rounding)
    if root is None:
        raise RuntimeError("the segment does not determine its last state")
    spread = whole.A @ root
    return symmetric(spread @ spread.T + whole.C)


def split(first: Segment, second: Segment, trusted: float = TRUSTED) -> tuple[Array, Array, Array] | None:
    """The state between two segments: estimate, covariance, E[(error of the last state) (its error)'].

    With xs = J^+ eta of both and D = (I + C1 J2)^-1: D (A1 xs + b1 + C1 eta2) and D A1 J^+ A1' D' + D C1.
    Given that state the rows of `first` say no more of the last one, so the cross-covariance is A2 P. None
    where the rows do not clearly determine it, or too many digits were lost.
    """
    if max(first.loss, second.loss, float(np.vdot(first.C, second.J))) > trusted:
        return None
    DA, DC, Db = _shared(first.A, first.C, first.b + first.C @ second.eta, second.J)
    # Information of both, as `combine` has it.
    eta = DA.T @ (second.eta - second.J @ first.b) + first.eta
    J = DA.T @ second.J @ first.A + first.J
    rounding = first.rounding + carried_rounding(first.A, second.J, second.rounding)
    root = _inverse_root(J, first.A, rounding)
    if root is None:
        return None
    spread = DA @ root
    P = symmetric(DC + spread @ spread.T)
    return Db + spread @ (root.T @ eta), P, second.A @ P


def hopeless(whole: Segment) -> bool:
    """Whether the rows leave directions unseen, as far as doubles can tell, that reach the last state."""
    diagonal = whole.J.diagonal()
    scale = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(whole.J / (scale[:, None] * scale))
    zero = values <= NOTHING * len(values) * values[-1]
    return bool(zero.any()) and not _hidden(whole.A / scale, vectors[:, zero])


def _inverse_root(J: Array, A: Array, rounding: Array) -> Array | None:
    """W with W W' = J^+; None where what J does not see reaches A x, or nobody can tell what it sees."""
    if drowned(J, rounding):
        return None
    diagonal = J.diagonal()
    scale = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(J / (scale[:, None] * scale))
    if values[0] > SOMETHING * values[-1]:
        return np.asarray(vectors / (scale[:, None] * np.sqrt(values)))
    zero = values <= NOTHING * len(J) * values[-1]
    if (values[~zero] <= SOMETHING * values[-1]).any() or not _hidden(A / scale, vectors[:, zero]):
        return None
    return np.asarray(vectors[:, ~zero] / (scale[:, None] * np.sqrt(values[~zero])))


def _hidden(A: Array, unseen: Array) -> bool:
    """Whether the unit vectors `unseen` do not reach A x, row by row."""
    size = np.sqrt((A**2).sum(axis=1))
    return bool((np.abs(A @ unseen).max(axis=1) <= REACH_TOLERANCE * size).all())


class SlidingFold:
    """Combination of the leaves [start, stop) for bounds that move forward, at a constant cost a step.

    Two stacks without stacks: from `middle` downward the segments [start, middle) are kept for every start
    asked for, upward the segments [middle, stop) for every stop. When the start passes the middle, the middle
    moves.
    """

    def __init__(self, leaf: Callable[[int], Segment]) -> None:
        self.leaf = leaf
        self.reset(0)

    def reset(self, middle: int) -> None:
        """Forget everything, and begin again around `middle`."""
        self.middle = middle
        self.older: list[Segment] = []  # [middle - 1 - i, middle)
        self.newer: list[Segment] = []  # [middle, middle + 1 + i)

    def copy(self, leaf: Callable[[int], Segment]) -> SlidingFold:
        """The same segments for a copy of the leaves."""
        fork = SlidingFold(leaf)
        fork.middle, fork.older, fork.newer = self.middle, self.older.copy(), self.newer.copy()
        return fork

    def changed(self, time: int) -> None:
        """The leaf at `time` is not what it was."""
        if time >= self.middle:
            del self.newer[time - self.middle :]
        else:
            del self.older[self.middle - 1 - time :]

    def __call__(self, start: int, stop: int) -> Segment | None:
        """The combination, None if there is nothing to combine."""
        if start >= stop:
            return None
        if not start <= self.middle <= stop:
            self.reset(stop)
        while self.middle - len(self.older) > start:
            leaf = self.leaf(self.middle - 1 - len(self.older))
            self.older.append(combine(leaf, self.older[-1]) if self.older else leaf)
        while self.middle + len(self.newer) < stop:
            leaf = self.leaf(self.middle + len(self.newer))
            self.newer.append(combine(self.newer[-1], leaf) if self.newer else leaf)
        if start == self.middle:
            return self.newer[stop - self.middle - 1]
        if stop == self.middle:
            return self.older[self.middle - 1 - start]
        return combine(self.older[self.middle - 1 - start], self.newer[stop - self.middle - 1])
