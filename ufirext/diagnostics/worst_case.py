"""The exact worst case of a filter: the disturbance of unit energy that does the most harm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .._arrays import Array, covariance, finite, matrix, one_of, real, shown, square
from ..errors import ShapeError, UfirextError
from ..recursions.hinfinity import Form, weight_root

__all__ = ["WorstCase", "worst_case_gain"]


class WorstCase(NamedTuple):
    """The largest ratio of weighted error energy to disturbance energy, and the disturbance that attains it.

    Attributes
    ----------
    gain : float
        sup sum_n theta_n |e_n|_S^2 / (|x_0 - x^_0|^2_{P0^-1} + sum |w_n|^2_{Q^-1} + sum |v_n|^2_{R^-1}).
        An H-infinity filter guarantees at most 1.
    x0 : ndarray, (dim_x,)
        Initial error of the worst disturbance, of unit energy in all.
    w : ndarray, (steps, dim_x)
    v : list of ndarray, (dim_z,)
    errors : ndarray, (steps, dim_x)
        What it does to the error that is bounded.
    """

    gain: float
    x0: Array
    w: Array
    v: list[Array]
    errors: Array

    def __repr__(self) -> str:
        energy = float(np.vdot(self.w, self.w))
        return (
            f"WorstCase(gain={self.gain:.6g}, {len(self.w)} steps; "
            f"|x0|^2 = {float(self.x0 @ self.x0):.3g}, sum |w|^2 = {energy:.3g}, "
            f"sum |v|^2 = {sum(float(v @ v) for v in self.v):.3g})"
        )


def worst_case_gain(
    K: Sequence[ArrayLike],
    F: ArrayLike | Sequence[ArrayLike],
    H: ArrayLike | Sequence[ArrayLike],
    Q: ArrayLike | Sequence[ArrayLike],
    R: ArrayLike | Sequence[ArrayLike],
    P0: ArrayLike,
    *,
    S: ArrayLike = 1.0,
    theta: ArrayLike = 1.0,
    form: Form = "posterior",
) -> WorstCase:
    """The exact worst case of a filter x^_n = F x^_{n-1} + K_n (z_n - H F x^_{n-1}), whatever its gains.

    It is the largest singular value, squared, of the map from the disturbances, each in units of its own
    covariance, to the errors, equation :eq:`worst-case`: no theory of H-infinity filters enters.

    Parameters
    ----------
    K : sequence of array_like, (dim_x, dim_z)
        The gains, one a step; no columns where nothing was measured.
    F, Q : array_like, (dim_x, dim_x), or sequences with one entry a step
        Of the plant. Singular Q, P0: only disturbances in their range.
    H, R : array_like, (dim_z, dim_x) and (dim_z, dim_z), or sequences with one entry a step
        Of the measurements.
    P0 : array_like, (dim_x, dim_x)
        Weight of the initial error.
    S : array_like, (dim_x, dim_x), optional
        Weight of the errors, positive semidefinite.
    theta : float or sequence, optional
        Of the steps; with 1 the gain is the bound itself, to be compared with 1/theta.
    form : {"posterior", "prior"}, optional
        Which error: x_n - x^_n after the update, or x_n - F x^_{n-1} before it.

    Returns
    -------
    WorstCase

    Raises
    ------
    ShapeError, NonFiniteError, CovarianceError
    UfirextError
        For a negative theta or a form that is none.

    Examples
    --------
    >>> from ufirext.diagnostics import worst_case_gain
    >>> round(worst_case_gain(K=[[[0.5]]], F=[[1.0]], H=[[1.0]], Q=[[0.0]], R=[[1.0]], P0=[[1.0]]).gain, 6)
    0.5
    """
    one_of(form, ("posterior", "prior"), "form")
    if not _holds_something(K):
        raise ShapeError(f"K must hold at least one gain (dim_x, dim_z), one for each step, got {shown(K)}")
    steps, start = len(K), real(P0, "P0")
    n = len(start if start.ndim == 2 else matrix(K[0], (None, None), "K[0]", "(dim_x, dim_z)"))
    gains = [matrix(gain, (n, None), f"K[{i}]") for i, gain in enumerate(K)]
    Fs = [square(value, n, "F") for value in _per_step(F, steps, "F")]
    Qs = [covariance(value, n, "Q") for value in _per_step(Q, steps, "Q")]
    Hs, Rs = _observed(gains, H, R)
    thetas = finite(real(theta, "theta"), "theta")
    if thetas.shape not in ((), (steps,)) or (thetas < 0.0).any():
        raise UfirextError(
            f"theta must be a number that is not negative, or ({steps},) of them, got {shown(theta)}"
        )
    thetas = np.broadcast_to(thetas, (steps,))
    roots = [_root(value) for value in (covariance(start, n, "P0"), *Qs, *Rs)]
    starts = np.cumsum([0, *(root.shape[1] for root in roots)])
    maps = _error_map(gains, Fs, Hs, roots, starts, form)
    L = weight_root(covariance(S, n, "S"))
    weighted = np.concatenate([np.sqrt(t) * (L @ error) for t, error in zip(thetas, maps, strict=True)])
    top, direction = _largest(weighted)
    parts = [root @ direction[a:b] for root, a, b in zip(roots, starts, starts[1:], strict=False)]
    errors = np.array([error @ direction for error in maps])
    return WorstCase(top, parts[0], np.array(parts[1 : steps + 1]), parts[steps + 1 :], errors)


def _holds_something(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.ndim > 0 and len(value) > 0
    return isinstance(value, Sequence) and len(value) > 0


def _error_map(
    gains: list[Array], Fs: list[Array], Hs: list[Array], roots: list[Array], starts: Array, form: Form
) -> list[Array]:
    """The error of every step as a linear map of the normalised disturbances [x0; w_1; ..; v_1; ..]."""
    steps = len(gains)
    error = np.zeros((len(roots[0]), int(starts[-1])))
    error[:, : starts[1]] = roots[0]
    maps = []
    for step, (K, F, H) in enumerate(zip(gains, Fs, Hs, strict=True)):
        error = F @ error
        error[:, starts[1 + step] : starts[2 + step]] += roots[1 + step]
        prior = error
        error = error - K @ (H @ error)
        error[:, starts[1 + steps + step] : starts[2 + steps + step]] -= K @ roots[1 + steps + step]
        maps.append(prior if form == "prior" else error)
    return maps


def _largest(A: Array) -> tuple[float, Array]:
    """Largest squared singular value of A, and its right singular vector; zeros where A has no rows."""
    if not len(A):
        return 0.0, np.zeros(A.shape[1])
    if A.shape[0] < A.shape[1]:
        values, vectors = np.linalg.eigh(A @ A.T)
        direction = A.T @ vectors[:, -1]
    else:
        values, vectors = np.linalg.eigh(A.T @ A)
        direction = vectors[:, -1]
    size = float(np.linalg.norm(direction))
    return max(float(values[-1]), 0.0), direction / size if size else direction


def _root(cov: Array) -> Array:
    """B with B B' = cov."""
    return weight_root(cov).T


def _per_step(value: ArrayLike | Sequence[ArrayLike], steps: int, name: str) -> list[Array]:
    """One matrix for all steps, or a sequence with one for each."""
    if isinstance(value, list | tuple) and value and real(value[0], name).ndim == 2:
        entries = [real(entry, name) for entry in value]
    else:
        array = real(value, name)  # type: ignore[arg-type]
        entries = list(array) if array.ndim == 3 else [array] * steps
    if len(entries) != steps:
        raise ShapeError(f"{name} must hold one matrix for each of the {steps} steps, got {len(entries)}")
    return entries


def _observed(
    gains: list[Array], H: ArrayLike | Sequence[ArrayLike], R: ArrayLike | Sequence[ArrayLike]
) -> tuple[list[Array], list[Array]]:
    """H and R of each step, without rows where the gain has no columns."""
    n = len(gains[0])
    Hs, Rs = [], []
    steps = len(gains)
    for K, H_now, R_now in zip(gains, _per_step(H, steps, "H"), _per_step(R, steps, "R"), strict=True):
        m = K.shape[1]
        Hs.append(matrix(H_now, (m, n), "H", "(columns of K, dim_x)") if m else np.zeros((0, n)))
        Rs.append(covariance(R_now, m, "R", "(columns of K)") if m else np.zeros((0, 0)))
    return Hs, Rs
