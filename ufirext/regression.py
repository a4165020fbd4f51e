"""A window as one regression in its oldest state, and the figures that tell an optimal gain from another.

Everything is in units of the noise: rows are whitened by their R, and all the noise e of the window has unit
covariance. Nothing here knows how the library designs its gains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ._arrays import Array
from .joint import responses, square_root
from .window import RANK_TOLERANCE, Window

__all__ = ["Regression", "figures", "row_sizes"]


@dataclass(frozen=True)
class Regression:
    """The window as Z = O x_old + N e, [x at `targets`] = T x_old + E e, cov e = I, rows whitened."""

    O: Array  # noqa: E741
    N: Array
    T: Array
    E: Array

    @classmethod
    def of(cls, window: Window, targets: Sequence[int], noise: bool = True) -> Regression:
        """The regression of `window`; without `noise` of the process only that of the measurements counts."""
        roots = [square_root(Q) if noise else np.zeros((window.dim_x, 0)) for Q in window.Q]
        rows, states = responses(window, roots, sorted(set(targets)))
        at = dict(zip(sorted(set(targets)), states, strict=True))
        count = window.starts[-1]
        own = np.concatenate([at[time] for time in targets])
        return cls(
            O=window.C,
            N=np.hstack([rows, np.eye(count)]),
            T=np.concatenate([window.products[time] for time in targets]),
            E=np.hstack([own, np.zeros((len(own), count))]),
        )

    @cached_property
    def decomposed(self) -> tuple[Array, Array, Array]:
        """O = Q1 R1, and Q2 orthogonal to it: Q1, the (pseudo-)inverse of R1, Q2."""
        scale = np.sqrt((self.O**2).sum(axis=0))
        scale = np.where(scale > 0.0, scale, 1.0)
        U, s, Vt = np.linalg.svd(self.O / scale)
        rank = int((s > RANK_TOLERANCE * s[0]).sum()) if s[0] > 0.0 else 0
        return U[:, :rank], (Vt[:rank].T / s[:rank]) / scale[:, None], U[:, rank:]

    def errors(self, gain: Array) -> Array:
        """The map from e to the estimation errors; its rows' squared norms are the error variances."""
        return np.asarray(self.E - gain @ self.N)


def figures(problem: Regression, H: Array) -> tuple[float, float, float, Array, Array]:
    """Feasibility, gap and stationarity, worst over the rows; error variances and their lower bounds."""
    Q1, inverse, Q2 = problem.decomposed
    error, size = problem.errors(H), row_sizes(H)
    size = np.where(size > 0.0, size, 1.0)
    primal = (error**2).sum(axis=1)
    bias = (H @ problem.O - problem.T) @ inverse
    feasibility = float((np.abs(bias).max(axis=1, initial=0.0) / size).max())
    # Everything an unbiased gain could still change moves the error within the span of Qa.
    reachable = np.linalg.qr((Q2.T @ problem.N).T)[0]
    # A state that is known exactly has no error to compare with but rounding.
    floor = np.finfo(float).eps * (row_sizes(problem.E) + row_sizes(problem.T @ inverse))
    scale = np.sqrt(primal) + floor
    gap = float((row_sizes(error @ reachable) / np.where(scale > 0.0, scale, 1.0)).max())
    slope = -error @ problem.N.T
    steep = row_sizes(H @ problem.N @ problem.N.T)
    stationarity = float((row_sizes(slope @ Q2) / np.where(steep > 0.0, steep, 1.0)).max())
    return feasibility, gap, stationarity, primal, _lower_bounds(problem, slope @ Q1 @ inverse.T)


def _lower_bounds(problem: Regression, multiplier: Array) -> Array:
    """The Lagrange dual function: no unbiased gain has a smaller variance, whatever the multiplier.

    g(l) = |E - H_l N|^2 - 2 l (H_l O - T)', where H_l = (D + l O') S^-1 minimises the Lagrangian.
    """
    S, D = problem.N @ problem.N.T, problem.E @ problem.N.T
    H: Array = np.asarray(np.linalg.solve(S, (D + multiplier @ problem.O.T).T)).T
    slack = (multiplier * (H @ problem.O - problem.T)).sum(axis=1)
    return np.asarray((problem.errors(H) ** 2).sum(axis=1) - 2.0 * slack)


def row_sizes(A: Array) -> Array:
    """Euclidean norms of the rows."""
    return np.asarray(np.sqrt((A**2).sum(axis=1)))
