"""Norms of discrete-time systems with poles at 0, as FIR estimators and their loops have them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import control as ct
import numpy as np
from scipy.optimize import minimize_scalar
from scipy.sparse import csr_array

from .._arrays import Array
from .plant import linear_system

__all__ = ["norm"]

# Frequencies looked at, for each state (instant, of an FIR system) and at least, before peaks are refined.
POINTS_A_STATE = 16
FEWEST_POINTS = 1024
# Grid points within this fraction of the highest one may hide the highest peak.
CONTENDERS = 0.9
# Poles as near to the unit circle as this count as on it.
UNSTABLE = 1e-10


def norm(sys: ct.StateSpace, p: int | str = 2, tol: float = 1e-8) -> float:
    """The norm of a discrete-time system, as ``control.norm``, also where that gives up.

    ``control.norm`` refuses the H-infinity norm of systems with poles at 0 unless slycot is installed, and
    gives inf for the H2 norm of loops that hold a signal twice, as a register and a delay line do.

    Parameters
    ----------
    sys : control.StateSpace
        Discrete-time.
    p : {2, "inf"}, optional
        2: root of the power of the outputs under unit white noise at every input. "inf": the largest gain,
        the peak of the largest singular value over frequency; by slycot where it is installed, else from a
        grid of frequencies whose peaks are refined.
    tol : float, optional
        Relative tolerance for p="inf"; without slycot, of the frequency of a peak.

    Returns
    -------
    float
        inf for a system with a pole on or outside the unit circle.

    Raises
    ------
    control.ControlArgument
        For anything but a discrete-time StateSpace with states, or another p.

    Examples
    --------
    A mean of four halves white noise and passes a constant:

    >>> import control as ct
    >>> from ufirext.control import create_ufir_iosystem, norm
    >>> est = create_ufir_iosystem(ct.ss(1, 1, 1, 0, dt=True), horizon=4)
    >>> error = est.error_system()["e[0]", "v[0]"]
    >>> round(norm(error), 9), round(norm(error, "inf"), 9)
    (0.5, 1.0)
    """
    linear_system(sys, "norm")
    if not ct.isdtime(sys, strict=True):
        raise ct.ControlArgument("norm() called with a system that is not discrete-time; use ct.norm(sys, p)")
    if p not in (2, "inf"):
        raise ct.ControlArgument(f"norm computation for p={p!r} not supported; 2 and 'inf' are")
    register = not np.tril(sys.A).any()
    if not register and (np.abs(sys.poles()) >= 1.0 - UNSTABLE).any():
        return float("inf")
    if p == 2:
        return float(np.linalg.norm(_taps(sys))) if register else _h2(sys)
    if ct.exception.slycot_check():
        return float(ct.norm(sys, "inf", tol=tol))
    if register:
        taps = _taps(sys)
        return _peak(_fir_response(taps), max(FEWEST_POINTS, POINTS_A_STATE * len(taps)), tol)
    return _peak(_response(sys), max(FEWEST_POINTS, POINTS_A_STATE * sys.nstates), tol)


def _taps(sys: ct.StateSpace) -> Array:
    """Impulse response (instants, outputs, inputs) of a system whose strictly triangular A makes it end."""
    A = csr_array(sys.A)
    taps, state = [np.array(sys.D)], np.array(sys.B)
    while state.any():
        taps.append(sys.C @ state)
        state = A @ state
    return np.array(taps)


def _h2(sys: ct.StateSpace) -> float:
    """Root of trace(C P C' + D D'), P = sum A^k B B' A^k'; by doubling, P stays positive semidefinite."""
    A, P = sys.A, sys.B @ sys.B.T
    while True:
        more = A @ P @ A.T
        if not (more.diagonal() > np.finfo(float).eps * P.diagonal()).any():
            break
        P, A = P + more, A @ A
    return float(np.sqrt(np.trace(sys.C @ P @ sys.C.T) + (sys.D**2).sum()))


Response = Callable[[Array], Any]


def _response(sys: ct.StateSpace) -> Response:
    """Frequencies in radians a step -> (frequencies, outputs, inputs)."""
    A, B, C, D = sys.A, sys.B, sys.C, sys.D

    def at(omega: Array) -> Any:
        return np.array([C @ np.linalg.solve(np.exp(1j * w) * np.eye(len(A)) - A, B) + D for w in omega])

    return at


def _fir_response(taps: Array) -> Response:
    """The same from an impulse response that ends."""

    def at(omega: Array) -> Any:
        return np.tensordot(np.exp(-1j * np.outer(omega, np.arange(len(taps)))), taps, axes=1)

    return at


def _peak(response: Response, points: int, tol: float) -> float:
    """The highest singular value on [0, pi]."""
    omega = np.linspace(0.0, np.pi, points + 1)
    height = np.concatenate([_largest(response(part)) for part in np.array_split(omega, 1 + points // 512)])
    left, right = np.r_[-np.inf, height[:-1]], np.r_[height[1:], -np.inf]
    tall = (height >= left) & (height >= right) & (height >= CONTENDERS * height.max())
    best = float(height.max())
    for top in map(int, np.flatnonzero(tall)):
        bounds = omega[max(top - 1, 0)], omega[min(top + 1, points)]
        found = minimize_scalar(
            lambda w: -float(_largest(response(np.array([w])))[0]),
            bounds=bounds,
            method="bounded",
            options={"xatol": tol},
        )
        best = max(best, -float(found.fun))
    return best


def _largest(matrices: Any) -> Array:
    return np.asarray(np.linalg.norm(matrices, ord=2, axis=(1, 2)))
