"""H-infinity filters in game-theoretic form, without inverses of P or Q.

Both filters guarantee  sum theta |e|^2_S <= |x_0 - x^_0|^2_{P0^-1} + sum |w|^2_{Q^-1} + sum |v|^2_{R^-1}
(D. Simon, Optimal State Estimation, 2006, chapter 11; Hassibi, Sayed and Kailath, IEEE TAC 41(1), 1996). They
differ in the error that is bounded and in the condition under which they exist:

* a-posteriori: e = x_n - x^_n, gain of the Kalman filter; exists iff P-^-1 + H'R^-1H - theta S > 0;
* a-priori: e = x_n - x^-_n, gain from the tilted prior; exists iff P-^-1 - theta S > 0, which is stronger.

In both, P-_{n+1} = F J^-1 F' + Q with J = P-^-1 - theta S + H'R^-1H, equation :eq:`hinfinity`. `tilt`
computes (P^-1 - theta S)^-1.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from .._arrays import Array, symmetric
from ..errors import UfirextError
from ..joint import square_root
from .kalman import innovation_gain, joseph

__all__ = ["Form", "Robust", "ThetaTooLarge", "largest_theta", "robust_gain", "tilt", "tilted", "weight_root"]

Form = Literal["posterior", "prior", "mixed"]


class ThetaTooLarge(UfirextError):
    """theta is beyond the largest value for which the H-infinity filter exists, equation :eq:`theta-max`.

    Attributes
    ----------
    step : int or None
        The step at which the condition fails.
    theta, theta_max : float
        What was asked, and the limit it must stay below.

    Examples
    --------
    >>> from ufirext import DelayHInfinityFilter, ThetaTooLarge
    >>> f = DelayHInfinityFilter(dim_x=1, dim_z=1, theta=5.0)
    >>> f.F, f.H = [[1.0]], [[1.0]]
    >>> try:
    ...     f.predict()
    ...     f.update(0.0)
    ... except ThetaTooLarge as error:
    ...     print(error.step, error.theta, round(error.theta_max, 9))
    1 5.0 1.5
    """

    def __init__(self, theta: float, theta_max: float, step: int | None = None) -> None:
        at = "" if step is None else f" at step {step}"
        super().__init__(
            f"theta must be below theta_max = {theta_max:.6g}{at} for the H-infinity filter to exist, "
            f"got {theta:.6g}; lower theta, or use theta='auto' or on_violation='clip'"
        )
        self.step = step
        self.theta = theta
        self.theta_max = theta_max

    def __reduce__(self) -> tuple[object, ...]:
        return (ThetaTooLarge, (self.theta, self.theta_max, self.step))


class Robust(NamedTuple):
    """One step of an H-infinity filter.

    Attributes
    ----------
    K : ndarray, (dim_x, dim_z)
    P : ndarray, (dim_x, dim_x)
        J^-1, from which P- of the next step is F J^-1 F' + Q.
    theta, theta_max : float
        What was used, and the limit of this step.
    """

    K: Array
    P: Array
    theta: float
    theta_max: float


def weight_root(S: Array) -> Array:
    """L with L' L = S, as many rows as the positive semidefinite S has rank, whatever the units."""
    return square_root(S).T


def largest_theta(P: Array, L: Array) -> float:
    """The theta below which P^-1 - theta L'L > 0: 1 / lambda_max(L P L'), also for a singular P.

    Parameters
    ----------
    P : ndarray, (dim_x, dim_x)
        Positive semidefinite.
    L : ndarray, (rank, dim_x)
        Root of the weight, S = L' L.
    """
    if not len(L):
        return np.inf
    top = float(np.linalg.eigvalsh(symmetric(L.dot(P).dot(L.T)))[-1])
    return 1.0 / top if top > 0.0 else np.inf


def tilt(P: Array, L: Array, theta: float) -> Array:
    """(P^-1 - theta L'L)^-1 = P + P L' (theta^-1 I - L P L')^-1 L P, also for a singular P.

    Raises
    ------
    ThetaTooLarge
        Unless theta < largest_theta(P, L).
    """
    if theta == 0.0 or not len(L):
        return P
    limit = largest_theta(P, L)
    if not theta < limit:
        raise ThetaTooLarge(theta, limit)
    return tilted(P, L, theta)


def tilted(P: Array, L: Array, theta: float) -> Array:
    """`tilt` by a theta that is known to be below its limit."""
    if theta == 0.0 or not len(L):
        return P
    LP = L.dot(P)
    middle = np.eye(len(L)) / theta - symmetric(LP.dot(L.T))
    return symmetric(P + LP.T.dot(np.linalg.solve(middle, LP)))


def robust_gain(P: Array, H: Array, R: Array, L: Array, theta: float, form: Form = "posterior") -> Robust:
    """Gain and J^-1 of one step.

    Parameters
    ----------
    P : ndarray, (dim_x, dim_x)
        Prior P- of the step.
    H, R : ndarray, (dim_z, dim_x) and (dim_z, dim_z)
        No rows where nothing was measured.
    L : ndarray, (rank, dim_x)
        Root of the weight S of the errors, S = L' L.
    theta : float
        Not negative; 0 is the Kalman filter.
    form : {"posterior", "prior", "mixed"}, optional
        Which error is bounded: after the update (exists iff P-^-1 + H'R^-1H - theta S > 0) or before it
        (P-^-1 - theta S > 0). "mixed" is the pairing that Uribe-Murcia et al. (2018) print, the gain of the
        second with the condition of the first: it guarantees nothing and can be unstable between the limits.

    Returns
    -------
    Robust

    Raises
    ------
    ThetaTooLarge
    """
    if form == "prior":
        limit = largest_theta(P, L)
        K, updated = _kalman(tilt(P, L, theta), H, R)
        return Robust(K, updated, theta, limit)
    K, updated = _kalman(P, H, R)
    limit = largest_theta(updated, L)
    tilted = tilt(updated, L, theta)
    if form == "mixed" and len(H):
        K = np.linalg.solve(R, H.dot(tilted)).T
    return Robust(K, tilted, theta, limit)


def _kalman(P: Array, H: Array, R: Array) -> tuple[Array, Array]:
    """The Kalman gain and the covariance after it."""
    if not len(H):
        return np.zeros((len(P), 0)), P
    C = P.dot(H.T)
    K = innovation_gain(C, symmetric(H.dot(C) + R))
    return K, joseph(P, K, H, R)
