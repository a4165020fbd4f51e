"""Naive pieces that the errata of several papers are computed with."""

from __future__ import annotations

import numpy as np
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray

from ufirext import DelayKalmanFilter, Model

__all__ = ["Array", "paths", "power", "settled_ours", "settled_peer", "variance"]

Array = NDArray[np.float64]


def power(F: Array, exponent: int) -> Array:
    """F^exponent, also for negative exponents: the papers' letters."""
    return np.linalg.matrix_power(F if exponent >= 0 else np.linalg.inv(F), abs(exponent))


def paths(rng: np.random.Generator, model: Model, steps: int, count: int) -> tuple[Array, Array]:
    """States (count, steps + 1, dim_x) from rest and the noises w_1 .. w_steps that drove them."""
    w = rng.multivariate_normal(np.zeros(model.dim_x), model.Q, (count, steps))
    x = np.zeros((count, steps + 1, model.dim_x))
    for i in range(steps):
        x[:, i + 1] = x[:, i] @ model.F.T + w[:, i]
    return x, w


def variance(values: Array) -> tuple[float, float]:
    """Mean square and its standard error, for values of zero mean."""
    squares = values**2
    return float(squares.mean()), float(squares.std(ddof=1) / np.sqrt(squares.size))


def settled_ours(model: Model, P0: float, steps: int) -> DelayKalmanFilter:
    """The library's Kalman filter after so many steps of zeros."""
    f = DelayKalmanFilter(model.dim_x, model.dim_z)
    f.F, f.H, f.Q, f.R = model.F, model.H, model.Q, model.R
    f.P = P0 * np.eye(model.dim_x)
    for _ in range(steps):
        f.predict()
        f.update(np.zeros(model.dim_z))
    return f


def settled_peer(model: Model, P0: float, steps: int) -> KalmanFilter:
    """filterpy's after the same."""
    f = KalmanFilter(model.dim_x, model.dim_z)
    f.F, f.H, f.Q, f.R = model.F, model.H, model.Q, model.R
    f.P = P0 * np.eye(model.dim_x)
    for _ in range(steps):
        f.predict()
        f.update(np.zeros(model.dim_z))
    return f
