"""The H-infinity norm of discrete-time systems with poles at 0, as FIR estimators have them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import control as ct
import numpy as np
from scipy.optimize import minimize_scalar

from .._arrays import Array
from .plant import linear_system

__all__ = ["hinfinity_norm"]

# Frequencies looked at, for each state and at least, before the highest peaks are refined.
POINTS_A_STATE = 16
FEWEST_POINTS = 1024
# Grid points within this fraction of the highest one may hide the highest peak.
CONTENDERS = 0.9


def hinfinity_norm(sys: ct.StateSpace, tol: float = 1e-8) -> float:
    """The largest gain of a discrete-time system: the peak of its largest singular value over frequency.

    By slycot where it is installed (``control.norm(sys, "inf")``). Without it python-control refuses systems
    with poles at 0; here a grid of frequencies finds the peaks, which are then refined.

    Parameters
    ----------
    sys : control.StateSpace
        Discrete-time.
    tol : float, optional
        Relative tolerance; of a peak's frequency without slycot.

    Returns
    -------
    float
        inf for a system with a pole on or outside the unit circle.

    Raises
    ------
    control.ControlArgument
        For anything but a discrete-time StateSpace.

    Examples
    --------
    The noise of a mean of four passes at frequency 0 without loss:

    >>> import control as ct
    >>> from ufirext.control import create_ufir_iosystem, hinfinity_norm
    >>> est = create_ufir_iosystem(ct.ss(1, 1, 1, 0, dt=True), horizon=4)
    >>> round(hinfinity_norm(est.error_system()["e[0]", "v[0]"]), 9)
    1.0
    """
    linear_system(sys, "hinfinity_norm")
    if not ct.isdtime(sys, strict=True):
        raise ct.ControlArgument("hinfinity_norm() needs a discrete-time system; use ct.norm(sys, 'inf')")
    register = not np.tril(sys.A).any()
    if not register and (np.abs(sys.poles()) >= 1.0 - 1e-12).any():
        return float("inf")
    if ct.exception.slycot_check():
        return float(ct.norm(sys, "inf", tol=tol))
    response = _fir_response(sys) if register else _response(sys)
    return _peak(response, max(FEWEST_POINTS, POINTS_A_STATE * sys.nstates), tol)


Response = Callable[[Array], Any]


def _response(sys: ct.StateSpace) -> Response:
    """Frequencies in radians a step -> (frequencies, outputs, inputs)."""
    A, B, C, D = sys.A, sys.B, sys.C, sys.D

    def at(omega: Array) -> Any:
        return np.array([C @ np.linalg.solve(np.exp(1j * w) * np.eye(len(A)) - A, B) + D for w in omega])

    return at


def _fir_response(sys: ct.StateSpace) -> Response:
    """The same for a strictly triangular A, whose impulse response ends."""
    taps, state = [np.array(sys.D)], np.array(sys.B)
    while state.any():
        taps.append(sys.C @ state)
        state = sys.A @ state
    impulse = np.array(taps)

    def at(omega: Array) -> Any:
        return np.tensordot(np.exp(-1j * np.outer(omega, np.arange(len(impulse)))), impulse, axes=1)

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
