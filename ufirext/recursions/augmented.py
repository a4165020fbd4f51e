"""The augmented state X_n = [x_n; x_{n-1}; ..; x_{n-k}]: a late measurement is one of an older block.

It is the optimum for any delays and needs no inverse of F; the price is a (k+1) times larger covariance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .._arrays import Array, integer, symmetric
from ..model import Model, require_model

__all__ = ["Lifted", "augmented_model", "lift", "predict_lifted"]


class Lifted(NamedTuple):
    """Augmented state and covariance: x (blocks * dim_x,), P (blocks * dim_x, blocks * dim_x).

    Blocks of times before the start are zero; a measurement of them has no meaning.
    """

    x: Array
    P: Array


def lift(x: Array, P: Array, blocks: int) -> Lifted:
    """The augmented state at the start, where only x_0 exists."""
    n = len(P)
    big_x, big_P = np.zeros(blocks * n), np.zeros((blocks * n, blocks * n))
    big_x[:n] = x.reshape(-1)
    big_P[:n, :n] = P
    return Lifted(big_x, big_P)


def predict_lifted(state: Lifted, F: Array, Q: Array, Bu: Array | None = None, fading: float = 1.0) -> Lifted:
    """One step ahead: the newest block moves by F, the others move down, the oldest drops out.

    Fading memory magnifies the error of the newest block by sqrt(fading).
    """
    n = len(F)
    x, P = np.empty_like(state.x), np.empty_like(state.P)
    x[n:] = state.x[:-n] if len(state.x) > n else ()
    x[:n] = F.dot(state.x[:n]) + (0.0 if Bu is None else Bu.reshape(-1))
    kept = len(P) - n
    moved = F if fading == 1.0 else np.sqrt(fading) * F
    P[:n, :n] = symmetric(moved.dot(state.P[:n, :n]).dot(moved.T)) + Q
    P[n:, n:] = state.P[:kept, :kept]
    P[:n, n:] = moved.dot(state.P[:n, :kept])
    P[n:, :n] = P[:n, n:].T
    return Lifted(x, P)


def augmented_model(model: Model, delay: int) -> Model:
    """A model whose state holds the last delay + 1 states and whose measurement is `delay` steps old.

    Equation :eq:`augmented`.

    Parameters
    ----------
    model : Model
    delay : int
        Steps, at least 0.

    Returns
    -------
    Model
        dim_x is (delay + 1) times larger; F is singular (poles at 0), Q too.

    Raises
    ------
    HorizonError
        If delay is no integer or negative.

    Examples
    --------
    >>> from ufirext import augmented_model, kinematic
    >>> augmented_model(kinematic(1, 1, 1.0), delay=2)
    Model(dim_x=6, dim_z=1, dt=1)
    """
    require_model(model)
    delay = integer(delay, "delay", 0)
    n, size = model.dim_x, model.dim_x * (delay + 1)
    F, Q, H = np.zeros((size, size)), np.zeros((size, size)), np.zeros((model.dim_z, size))
    F[:n, :n], Q[:n, :n] = model.F, model.Q
    F[n:, :-n] = np.eye(size - n)
    H[:, size - n :] = model.H
    B = None if model.B is None else np.vstack([model.B, np.zeros((size - n, model.dim_u))])
    return Model(F, H, Q, model.R, B, model.dt)
