"""One predict and one update of the Kalman filter, for noise that may be correlated with the error.

Equation :eq:`kalman`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs

from .._arrays import Array, symmetric

__all__ = ["Posterior", "innovation_gain", "predict", "update"]

# Directions of S below this fraction of its largest (scaled) eigenvalue carry no innovation.
SINGULAR = 1e-14
# P - K S K' loses as many digits as R is smaller than S: at most three, else the Joseph form is taken.
BOOK = 1e-3


class Posterior(NamedTuple):
    """What an update returns: state, covariance, and the gain, residual and its covariance behind them."""

    x: Array
    P: Array
    K: Array
    y: Array
    S: Array


def predict(
    x: Array, P: Array, F: Array, Q: Array, Bu: Array | None = None, fading: float = 1.0
) -> tuple[Array, Array]:
    """One step ahead:  x- = F x + B u,  P- = fading F P F' + Q.

    Parameters
    ----------
    x : ndarray, (dim_x,) or (dim_x, 1)
    P, F, Q : ndarray, (dim_x, dim_x)
        Q is positive semidefinite and is never inverted.
    Bu : ndarray, same shape as x, optional
        What the known input adds to the state.
    fading : float, optional
        Fading memory: alpha^2 of filterpy, at least 1.

    Returns
    -------
    x, P : ndarray
        Prior state and covariance, in the shapes of the arguments.
    """
    x = F.dot(x)
    moved = symmetric(F.dot(P).dot(F.T))
    return (x if Bu is None else x + Bu), (moved if fading == 1.0 else fading * moved) + Q


def innovation_gain(C: Array, S: Array) -> Array:
    """K = C S^-1, the linear minimum-variance gain; for a singular S its pseudo-inverse takes the place.

    Parameters
    ----------
    C : ndarray, (dim_x, dim_z)
        Covariance of the error with the residual.
    S : ndarray, (dim_z, dim_z)
        Covariance of the residual, symmetric positive semidefinite.
    """
    return _gain(C, S)[0]


def _gain(C: Array, S: Array) -> tuple[Array, Array | None]:
    """K, and the Cholesky factor of S where S is regular."""
    factor, info = dpotrf(S, lower=1)
    # Every component's residual must keep a share of its variance that the others do not explain.
    if info == 0 and (len(S) == 1 or (factor.diagonal() ** 2 > SINGULAR * S.diagonal()).all()):
        return dpotrs(factor, C.T, lower=1)[0].T, factor
    scale = np.sqrt(np.maximum(np.diag(S), 0.0))
    scale = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(S / np.outer(scale, scale))
    kept = values > SINGULAR * len(S) * max(values[-1], 0.0)
    whitener = (vectors[:, kept] / np.sqrt(values[kept])).T / scale
    return (C @ whitener.T) @ whitener, None


def update(x: Array, P: Array, z: Array, H: Array, R: Array, cross: Array | None = None) -> Posterior:
    """Take in z = H x + v,  cov v = R,  E[e v'] = cross, where e is the prior error.

    K = (P H' + cross) S^-1,  S = H P H' + R + H cross + cross' H', and the Joseph form
    P+ = (I-KH) P (I-KH)' + K R K' - (I-KH) cross K' - K cross' (I-KH)', which stays positive semidefinite.
    With `cross` these are equations (13) and (15) of Uribe-Murcia et al. (2022), the last term of (13)
    corrected. Without it this is the textbook filter (Simon 2006, section 5.1), and P+ = P - K S K' unless
    the measurement is so good that the difference would lose digits.

    Parameters
    ----------
    x : ndarray, (dim_x,) or (dim_x, 1)
    P : ndarray, (dim_x, dim_x)
    z : ndarray, (dim_z,) or (dim_z, 1), like x
    H : ndarray, (dim_z, dim_x)
    R : ndarray, (dim_z, dim_z)
    cross : ndarray, (dim_x, dim_z), optional

    Returns
    -------
    Posterior
    """
    y = z - H.dot(x)
    C = P.dot(H.T)
    if cross is not None:
        C = C + cross
    S = H.dot(C) + R
    if cross is not None:
        S = S + cross.T.dot(H.T)
    K, factor = _gain(C, S)
    if cross is None and factor is not None and (R.diagonal() - BOOK * S.diagonal()).min() > 0.0:
        half = K.dot(factor)
        return Posterior(x + K.dot(y), P - half.dot(half.T), K, y, S)
    return Posterior(x + K.dot(y), joseph(P, K, H, R, cross), K, y, S)


def joseph(P: Array, K: Array, H: Array, R: Array, cross: Array | None = None) -> Array:
    """Covariance after an update with ANY gain K."""
    A = -K.dot(H)
    A.ravel()[:: len(A) + 1] += 1.0
    P = A.dot(P).dot(A.T) + K.dot(R).dot(K.T)
    if cross is not None:
        part = A.dot(cross).dot(K.T)
        P = P - part - part.T
    return symmetric(P)
