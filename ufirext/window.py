"""The window: rows of measurements, stacked as equations in its oldest state. Only here indices are counted.

A datum is a row (origin, H, R, z): z = H x_origin + v, cov v = R. With a the oldest origin of the window and
Phi(j, a) = F_j .. F_{a+1}, the rows stack to  Z = C x_a + D w + v,  and the state aimed at is
x_aim = T x_a + E w, equation :eq:`window`. A delayed measurement is only an older row.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ._arrays import Array
from ._lapack import cholesky_solver
from ._rounding import without_rounding
from .errors import CovarianceError
from .model import Model

# Singular values of the column-scaled rows below this fraction of the largest count as zero.
RANK_TOLERANCE = 1e-10
# ... and a direction the rows do not see must not reach the state aimed at by more than this.
REACH_TOLERANCE = 1e-8
# Eigenvalues of a singular R are lifted to this fraction of the largest, so that it can be a weight.
R_FLOOR = 1e-12
# Squared scaled pivots of an R above this: it is far from singular.
GOOD_PIVOT = 1e-6
# Variances below this, though not zero, make weights that overflow when squares are summed up.
LEAST_VARIANCE = 1e-280
# Entries of the stacked rows beyond this would overflow when squared.
LARGEST = 1e150


@dataclass(eq=False)  # not frozen, which would cost more than all the rest; nobody writes to a row
class Row:
    """One measurement: `z` = H x_origin + v, cov v = R, received at step `arrival`.

    `shift` is the known change of the state between the reference of its origin and the row (an edit of x
    made within the same step, before this row came), None when there is none. `correlation`,
    (dim_x, rows of H), is E[e v'] with the process noise w = root(Q) e, cov e = 1, that entered at the step
    of its origin; None where v knows nothing of it.
    """

    origin: int
    arrival: int
    H: Array
    R: Array
    z: Array
    shift: Array | None = None
    correlation: Array | None = None
    _raw: Array | None = field(default=None, init=False, repr=False)
    _gram: Array | None = field(default=None, init=False, repr=False)
    _information: float | None = field(default=None, init=False, repr=False)

    @cached_property
    def whitener(self) -> Array:
        """W with W R W' = I; rows are weighted by their R."""
        return whitener(self.R)

    @property
    def raw(self) -> Array:
        """[H, -z], (m, dim_x + 1): times [x; 1] it is noise of covariance R."""
        if self._raw is None:
            m, n = self.H.shape
            rows = self._raw = np.empty((m, n + 1))
            rows[:, :n] = self.H
            rows[:, n] = -self.z if self.shift is None else self.H.dot(self.shift) - self.z
        return self._raw

    @cached_property
    def affine(self) -> Array:
        """The whitened [H, -z]: noise of covariance I."""
        white: Array = self.whitener.dot(self.raw)
        return white

    @property
    def gram(self) -> Array:
        """[H, -z]' R^-1 [H, -z], (dim_x + 1, dim_x + 1)."""
        if self._gram is None:
            factor, weighted, info = cholesky_solver()(self.R, self.raw)
            plain = info == 0 and well_scaled(factor, self.R, GOOD_PIVOT)
            if not plain or self.R.diagonal().min() < LEAST_VARIANCE:
                self._gram = self.affine.T.dot(self.affine)
            else:
                self._gram = self.raw.T.dot(weighted)
        return self._gram

    @property
    def white(self) -> Array:
        """The whitened H."""
        return self.affine[:, :-1]

    @property
    def information(self) -> float:
        """trace(H' R^-1 H), by which negligible rows are recognised."""
        if self._information is None:
            self._information = sum(self.gram.diagonal()[:-1].tolist())
        return self._information


def well_scaled(factor: Array, matrix: Array, least: float) -> bool:
    """Whether no squared pivot of the Cholesky factor falls below `least` of the diagonal entry: scaling rows
    and columns changes nothing.
    """
    for pivot, entry in zip(factor.diagonal().tolist(), matrix.diagonal().tolist(), strict=True):
        if not pivot * pivot >= least * entry:
            return False
    return True


def whitener(R: Array) -> Array:
    """W with W R W' = I, after lifting the eigenvalues of a singular R."""
    least = min((variance for variance in R.diagonal().tolist() if variance > 0.0), default=1.0)
    if least < LEAST_VARIANCE:
        raise CovarianceError(
            f"R must hold variances of at least {LEAST_VARIANCE:g}, or 0 where a component is exact, for its "
            f"inverse weights the rows, got {least:.3g}; measure in a smaller unit"
        )
    if R.shape == (1, 1):
        return np.array([[1.0 / np.sqrt(R[0, 0])]]) if R[0, 0] > 0.0 else np.eye(1)
    scale = np.sqrt(np.maximum(R.diagonal(), 0.0))
    if scale.min() ** 2 > R_FLOOR * scale.max() ** 2 and np.count_nonzero(R) == len(R):
        return np.diag(1.0 / scale)
    if not scale.any():
        return np.eye(len(R))
    scale = np.where(scale > 0.0, scale, scale.max())
    values, vectors = np.linalg.eigh(R / np.outer(scale, scale))
    lifted = np.maximum(values, R_FLOOR * values[-1])
    return np.asarray((vectors / np.sqrt(lifted)).T / scale)


@dataclass(frozen=True)
class Window:
    """Rows sorted by origin, and the transitions from the oldest origin (time 0) to the newest time used.

    Parameters
    ----------
    F, Q : sequences of (dim_x, dim_x)
        F[j] leads from time j to time j + 1, where noise of covariance Q[j] enters.
    H, R : sequences of (m, dim_x) and (m, m)
        One entry a row; rows may have different numbers of components.
    origins : sequence of int
        Times of the rows, ascending, the first one 0.
    aim : int
        Time of the state that is wanted, 0 <= aim <= len(F).
    correlations : sequence of (dim_x, m) or None, optional
        Those of the rows; empty where none has any.
    """

    F: Sequence[Array]
    Q: Sequence[Array]
    H: Sequence[Array]
    R: Sequence[Array]
    origins: Sequence[int]
    aim: int
    whiteners: Sequence[Array] = field(default=())
    correlations: Sequence[Array | None] = field(default=())

    @cached_property
    def dim_x(self) -> int:
        """Number of states."""
        return int(self.H[0].shape[1])

    @cached_property
    def W(self) -> Sequence[Array]:
        """The rows' whiteners."""
        return self.whiteners or [whitener(R) for R in self.R]

    @cached_property
    def starts(self) -> list[int]:
        """Where each row's components begin in Z; one more entry than rows."""
        return [0, *np.cumsum([len(H) for H in self.H]).tolist()]

    @cached_property
    def products(self) -> list[Array]:
        """Phi(j, 0) for j = 0 .. len(F): forward products only, so F may be singular."""
        result = [np.eye(self.dim_x)]
        with np.errstate(over="ignore", invalid="ignore"):
            for F in self.F:
                result.append(F @ result[-1])
            return list(without_rounding(np.array(result)))

    @cached_property
    def C(self) -> Array:
        """(rows, dim_x): whitened observation matrix, Z = C x_oldest + noise."""
        with np.errstate(over="ignore", invalid="ignore"):
            rows = [W @ (H @ self.products[o]) for W, H, o in zip(self.W, self.H, self.origins, strict=True)]
        return np.concatenate(rows)

    @cached_property
    def overflows(self) -> bool:
        """True where powers of an unstable F leave the range of floating point: only prefixes can be used."""
        return not (np.abs(self.C) < LARGEST).all()

    @property
    def T(self) -> Array:
        """(dim_x, dim_x): from the oldest state to the one aimed at."""
        return self.products[self.aim]

    @cached_property
    def scale(self) -> Array:
        """(dim_x,): column norms of C, 1 for a state the rows never see."""
        norms = np.sqrt((self.C**2).sum(axis=0))
        return np.where(norms > 0.0, norms, 1.0)

    @cached_property
    def spectrum(self) -> tuple[Array, Array, Array]:
        """U, s, V' of the column-scaled C; raises where it overflows."""
        return np.linalg.svd(self.C / self.scale, full_matrices=False)

    @cached_property
    def rank(self) -> int:
        """Numerical rank of the column-scaled C."""
        if self.overflows:
            return max((prefix.rank for prefix in self.prefixes() if not prefix.overflows), default=0)
        s = self.spectrum[1]
        return int((s > RANK_TOLERANCE * s[0]).sum()) if s[0] > 0.0 else 0

    @cached_property
    def condition(self) -> float:
        """Condition of C on the directions it sees."""
        if self.overflows:
            return np.inf
        s = self.spectrum[1]
        return float(s[0] / s[self.rank - 1]) if self.rank else np.inf

    def determined(self) -> bool:
        """True when the rows determine the state aimed at: T null(C) = 0.

        Long windows of unstable models drown the early rows, so shorter prefixes of the rows (oldest first)
        are asked as well: what a prefix determines, all rows determine.
        """
        return _reaches(self) or any(_reaches(prefix) for prefix in self.prefixes())

    def prefixes(self) -> Iterator[Window]:
        """Shorter windows of the oldest rows, shortest first, same aim."""
        for size in (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64):
            if size < len(self.H):
                yield self.prefix(size)

    def prefix(self, count: int) -> Window:
        """The `count` oldest rows, same aim."""
        rows = slice(count)
        shorter = Window(
            self.F, self.Q, self.H[rows], self.R[rows], self.origins[rows], self.aim, self.W[rows]
        )
        # The equations are the same ones: no need to stack them again.
        shorter.__dict__.update(products=self.products, C=self.C[: self.starts[count]])
        return shorter


def _reaches(window: Window) -> bool:
    """T null(C) = 0, row by row relative to T."""
    if window.overflows:
        return False
    if window.rank == window.dim_x:
        return True
    if window.rank == 0:
        return not window.T.any()
    T = window.T / window.scale
    seen = window.spectrum[2][: window.rank]
    unseen = T - (T @ seen.T) @ seen
    size = np.sqrt((T**2).sum(axis=1))
    if (np.sqrt((unseen**2).sum(axis=1)) > REACH_TOLERANCE * size).any():
        return False
    basis = np.linalg.qr(seen.T, mode="complete")[0][:, window.rank :]
    basis[np.abs(basis) < REACH_TOLERANCE] = 0.0  # rounding, which would pass for a direction of its own
    return _dies(basis / window.scale[:, None], window.F[: window.aim])


def _dies(unseen: Array, transitions: Sequence[Array]) -> bool:
    """Whether the transitions annihilate every direction (columns), each in one step, as a singular F does.

    A direction that decays, or that others outgrow, becomes small beside T as well, yet it stays unknown.
    """
    if all(F is transitions[0] for F in transitions):
        transitions = transitions[
            : len(unseen)
        ]  # what a constant F ever annihilates, it does within dim_x steps
    for F in transitions:
        moved, size = F @ unseen, np.abs(F) @ np.abs(unseen)
        moved[np.abs(moved) <= REACH_TOLERANCE * size] = 0.0
        unit = size.max(axis=1, keepdims=True)
        _, s, Vt = np.linalg.svd(moved / np.where(unit > 0.0, unit, 1.0), full_matrices=False)
        alive = moved @ Vt[s > REACH_TOLERANCE].T
        if not alive.size:
            return True
        unseen = alive / np.abs(alive).max(axis=0)
    return False


def model_window(model: Model, horizon: int, lag: int = 0) -> Window:
    """The full window of a constant model: a row at each of `horizon` steps; `lag` before the newest."""
    steps = range(horizon)
    return Window(
        F=[model.F] * (horizon - 1),
        Q=[model.Q] * (horizon - 1),
        H=[model.H for _ in steps],
        R=[model.R for _ in steps],
        origins=steps,
        aim=horizon - 1 - lag,
        whiteners=[whitener(model.R)] * horizon,
    )
