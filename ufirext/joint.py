"""Design of minimum-variance gains: the state now and the state aimed at, from one window.

The universal form K = J + (T - J C) (C' S^-1 C)^+ C' S^-1, J = M S^-1, is never evaluated literally: a prefix
of the window is solved by QR on the null space of the unbiasedness constraint, the rest is a square-root
Kalman recursion on the pair [x_now; x_aim] that carries the rows of the gain. Neither F nor Q is inverted, so
both may be singular, and long windows of unstable models stay accurate. The design is made twice, from the
shortest good prefix and from the longest one; their agreement is the check.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag, solve_triangular

from ._arrays import Array, symmetric
from .errors import CovarianceError, UnobservableWindow
from .prefixes import good_start, head, longest_start, start_length
from .window import Window

__all__ = [
    "InaccurateGainWarning",
    "Joint",
    "joint_gain",
    "require_definite",
    "responses",
    "square_root",
]

# Designs that differ by more than this, relative to a row of the gain, are not trusted silently.
AGREEMENT = 1e-8


class InaccurateGainWarning(UserWarning):
    """Two designs of one gain disagree: the window is too ill conditioned for double precision.

    Examples
    --------
    Two modes that hardly differ, of which only the sum is measured:

    >>> import warnings
    >>> import numpy as np
    >>> from ufirext import InaccurateGainWarning, fms_gain
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always", InaccurateGainWarning)
    ...     gain = fms_gain(np.diag([0.9, 0.9 + 3e-9]), [[1, 1]], np.eye(2), 1, M=40, d=5)
    >>> [warning.category.__name__ for warning in caught]
    ['InaccurateGainWarning']
    """


@dataclass(frozen=True)
class Joint:
    """Gain of the pair [x_now; x_aim] on a window's rows, known inputs and prior.

    Attributes
    ----------
    K : ndarray, (2 * dim_x, components of the window)
        On the raw measurements, oldest first.
    L : ndarray, (2 * dim_x, columns of all inputs)
        On the known inputs, one block a transition, oldest first.
    prior : ndarray, (2 * dim_x, dim_x)
        On the mean of the prior of the oldest state; zero without a prior.
    P : ndarray, (2 * dim_x, 2 * dim_x)
        Joint error covariance.
    """

    K: Array
    L: Array
    prior: Array
    P: Array


def joint_gain(
    window: Window,
    inputs: Sequence[Array] | None = None,
    roots: Sequence[Array] | None = None,
    prior: Array | None = None,
) -> Joint:
    """Minimum-variance gain of [x_now; x_aim]; now is the end of the window's last transition.

    Parameters
    ----------
    window : Window
    inputs : sequence of (dim_x, dim_u), optional
        Input matrix of each transition.
    roots : sequence of (dim_x, p), optional
        Square roots of window.Q, where they are known already.
    prior : (dim_x, dim_x), optional
        Covariance of prior knowledge of the oldest state; without it the gain is unbiased.

    Raises
    ------
    UnobservableWindow
        Without a prior, if the rows do not determine the state aimed at.
    """
    design = _Design(
        window,
        [square_root(Q) for Q in window.Q] if roots is None else roots,
        [np.zeros((window.dim_x, 0))] * len(window.F) if inputs is None else inputs,
    )
    if prior is not None:
        return design.finish(design.from_prior(prior), 0)
    count = start_length(window)
    if count is None:
        raise UnobservableWindow(
            f"the rows of the window must determine all {window.dim_x} states, they have rank {window.rank}; "
            f"lengthen the horizon or measure another state",
            rank=window.rank,
        )
    first = good_start(window, count)
    joint = design.finish(design.from_rows(first), first)
    second = longest_start(window, first)
    if second > first:
        _warn_unless_equal(window, joint, design.finish(design.from_rows(second), second))
    return joint


def square_root(Q: Array) -> Array:
    """S with S S' = Q, as many columns as Q has rank; scaled, so that small states keep their digits."""
    width = np.sqrt(np.maximum(np.diag(Q), 0.0))
    unit = np.where(width > 0.0, width, 1.0)
    values, vectors = np.linalg.eigh(Q / np.outer(unit, unit))
    kept = values > len(Q) * np.finfo(float).eps * values.max(initial=0.0)
    return np.asarray(unit[:, None] * vectors[:, kept] * np.sqrt(values[kept]))


def require_definite(R: Array, name: str = "R") -> None:
    """Raise CovarianceError unless the covariance R is positive definite, whatever the units of its rows."""
    scale = np.sqrt(np.maximum(np.diag(R), 0.0))
    if scale.all() and np.linalg.eigvalsh(R / np.outer(scale, scale))[0] > len(R) * np.finfo(float).eps:
        return
    raise CovarianceError(
        f"{name} must be positive definite, because minimum-variance gains weight rows by its inverse, "
        f"got a singular one; add the variance of the sensor's resolution to its diagonal"
    )


def responses(window: Window, entries: Sequence[Array], times: Sequence[int]) -> tuple[Array, list[Array]]:
    """How rows (whitened) and states at `times` respond to what enters at each transition, oldest first.

    entries[j] : (dim_x, p_j) enters x_{j+1}: square roots of Q for process noise, B for known inputs.
    """
    ends = [0, *np.cumsum([entry.shape[1] for entry in entries]).tolist()]
    state = np.zeros((window.dim_x, ends[-1]))
    rows: list[Array] = []
    at: dict[int, Array] = {}
    for time in range(len(window.F) + 1):
        if time:
            state = window.F[time - 1] @ state
            state[:, ends[time - 1] : ends[time]] = entries[time - 1]
        while len(rows) < len(window.H) and window.origins[len(rows)] == time:
            rows.append(window.W[len(rows)] @ (window.H[len(rows)] @ state))
        if time in times:
            at[time] = state
    return np.concatenate(rows), [at[time] for time in times]


@dataclass(frozen=True)
class _Pair:
    """The recursion's state at `time`: x_now or, once the aim has passed, the pair [x_now; x_aim].

    `gain` has the columns [prior | whitened rows | inputs]; S is a square root of the joint error covariance.
    """

    time: int
    gain: Array
    S: Array


@dataclass(frozen=True)
class _Design:
    window: Window
    roots: Sequence[Array]
    inputs: Sequence[Array]

    @cached_property
    def rows(self) -> int:
        """First column of the gain on rows; the prior's stand before."""
        return self.window.dim_x

    @cached_property
    def entries(self) -> list[int]:
        """Where the columns of each transition's input begin; one more entry than transitions."""
        start = self.rows + self.window.starts[-1]
        return [start, *(start + np.cumsum([B.shape[1] for B in self.inputs], dtype=int)).tolist()]

    def from_prior(self, P: Array) -> _Pair:
        """The oldest state, known with covariance P."""
        gain = np.zeros((self.window.dim_x, self.entries[-1]))
        gain[:, : self.rows] = np.eye(self.window.dim_x)
        return self.clone(_Pair(0, gain, square_root(P)))

    def from_rows(self, count: int) -> _Pair:
        """The oldest `count` rows at once: min ||E - K N|| subject to K C = T, on the null space of C'.

        K = T C+ + Y U', with U orthogonal to the columns of C and Y an unconstrained least-squares solution.
        """
        window, oldest = self.window, head(self.window, count)
        stop, rank, rows = len(oldest.F), oldest.rank, oldest.starts[-1]
        times = [stop, window.aim] if window.aim <= stop else [stop]
        U, s, Vt = oldest.spectrum
        T = np.concatenate([oldest.products[time] for time in times]) / oldest.scale
        K = (T @ (Vt[:rank].T / s[:rank])) @ U[:, :rank].T
        noise, own = responses(oldest, self.roots[:stop], times)
        N = np.hstack([noise, np.eye(rows)])
        E = np.hstack([np.concatenate(own), np.zeros((len(K), rows))])
        unseen = np.linalg.qr(U[:, :rank], mode="complete")[0][:, rank:]
        if unseen.shape[1]:
            basis, triangle = np.linalg.qr((unseen.T @ N).T)
            K = K + solve_triangular(triangle, basis.T @ (E - K @ N).T).T @ unseen.T
        forced, states = responses(oldest, self.inputs[:stop], times)
        gain = np.zeros((len(K), self.entries[-1]))
        gain[:, self.rows : self.rows + rows] = K
        gain[:, self.entries[0] : self.entries[stop]] = np.concatenate(states) - K @ forced
        return _Pair(stop, gain, _lower(E - K @ N))

    def finish(self, pair: _Pair, count: int) -> Joint:
        """The recursion over the remaining rows, from row `count` on, and transitions."""
        window, n = self.window, self.window.dim_x
        for index in range(count, len(window.H)):
            while pair.time < window.origins[index]:
                pair = self.advance(pair)
            pair = self.absorb(pair, index)
        while pair.time < len(window.F):
            pair = self.advance(pair)
        S = _lower(pair.S)
        K = pair.gain[:, self.rows : self.entries[0]] @ block_diag(*window.W)
        return Joint(K, pair.gain[:, self.entries[0] :], pair.gain[:, :n], symmetric(S @ S.T))

    def advance(self, pair: _Pair) -> _Pair:
        """One transition of x_now; x_aim stays."""
        n, time = self.window.dim_x, pair.time
        gain, root = pair.gain.copy(), self.roots[time]
        S = np.hstack([pair.S, np.zeros((len(pair.S), root.shape[1]))])
        F = self.window.F[time]
        gain[:n], S[:n] = F @ gain[:n], F @ S[:n]
        gain[:n, self.entries[time] : self.entries[time + 1]] += self.inputs[time]
        S[:n, pair.S.shape[1] :] = root
        return self.clone(_Pair(time + 1, gain, S))

    def clone(self, pair: _Pair) -> _Pair:
        """From the time of the aim on, the state then is carried along."""
        if pair.time != self.window.aim:
            return pair
        return _Pair(pair.time, np.vstack([pair.gain] * 2), np.vstack([pair.S] * 2))

    def absorb(self, pair: _Pair, index: int) -> _Pair:
        """One row: LQ of [[I, H S], [0, S]] = [[L11, 0], [L21, ..]] and the step L21 L11^-1.

        The new S is Joseph's form [(I - step H) S, step]: L22 would lose the digits of almost exact rows.
        """
        window, n, S = self.window, self.window.dim_x, pair.S
        H = window.W[index] @ window.H[index]
        m, start, seen = len(H), self.rows + window.starts[index], H @ S[:n]
        lower = _lower(np.block([[np.eye(m), seen], [np.zeros((len(S), m)), S]]))
        step = solve_triangular(lower[:m, :m].T, lower[m:, :m].T).T
        gain = pair.gain - step @ (H @ pair.gain[:n])
        gain[:, start : start + m] += step
        return _Pair(pair.time, gain, _lower(np.hstack([S - step @ seen, step])))


def _lower(A: Array) -> Array:
    """Lower triangular (trapezoidal) L with L L' = A A'."""
    return np.asarray(np.linalg.qr(A.T, mode="r")).T


def _warn_unless_equal(window: Window, joint: Joint, other: Joint) -> None:
    """Compare the gains row by row in units of the rows' noise."""
    whole = block_diag(*[np.linalg.inv(W) for W in window.W])
    gain, gap = joint.K @ whole, (joint.K - other.K) @ whole
    size = np.sqrt((gain**2).sum(axis=1))
    worst = float((np.sqrt((gap**2).sum(axis=1)) / np.where(size > 0.0, size, 1.0)).max())
    if worst > AGREEMENT:
        warnings.warn(
            f"two designs of this gain differ by {worst:.1e} of a row, expected below {AGREEMENT:.0e}: the "
            f"window is nearly unobservable, doubles leave {max(0.0, -np.log10(worst)):.0f} digits of it; "
            f"drop states that the measurements hardly show or measure another one",
            InaccurateGainWarning,
            stacklevel=4,
        )
