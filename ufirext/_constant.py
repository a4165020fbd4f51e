"""The gain of a constant model without a loop over the window: powers by doubling, scaled CholeskyQR2."""

from __future__ import annotations

import math

import numpy as np

from ._arrays import Array, symmetric
from ._rounding import SUSPECT
from .model import Model
from .window import whitener

# Condition of the scaled rows up to which this path is as accurate as the general one.
WELL_CONDITIONED = 1e4
# Rounding of the noise paths, relative to the error's standard deviation, beyond which they are not trusted.
PATH_ROUNDING = 1e-12


def constant_gain(model: Model, horizon: int, lag: int) -> Array | None:
    """K = T C+ on the raw rows of the full window (dim_x, horizon * dim_z); None where ill-conditioned."""
    W = whitener(model.R)
    with np.errstate(over="ignore", invalid="ignore"):
        C = observations(W @ model.H, model.F, horizon)
        T = np.linalg.matrix_power(model.F, horizon - 1 - lag)
        scale = np.sqrt(np.einsum("ij,ij->j", C, C))
    if not (np.isfinite(scale).all() and scale.all()) or scale.min() ** 2 < SUSPECT * scale.max() ** 2:
        return None
    C /= scale  # in place: fresh pages of memory cost as much as the arithmetic
    normal = C.T @ C
    values = np.linalg.eigvalsh(normal)
    if values[0] * WELL_CONDITIONED**2 < values[-1]:
        return None
    # CholeskyQR2 (Yamamoto et al. 2015). The inverse is a preconditioner: both sides carry it, it cancels.
    near = np.linalg.inv(np.linalg.cholesky(normal))
    rows = near @ C.T
    K: Array = np.linalg.solve(rows @ rows.T, near @ (T / scale).T).T @ rows
    # Back to raw rows; the usual diagonal R spares a product of very thin matrices.
    weights = np.diag(W)
    if np.count_nonzero(W) == np.count_nonzero(weights):
        K *= np.tile(weights, horizon)
        return K
    return np.asarray((K.reshape(-1, model.dim_z) @ W).reshape(model.dim_x, -1))


def observations(H: Array, F: Array, horizon: int) -> Array:
    """[H; H F; ..; H F^{horizon - 1}], (horizon * dim_z, dim_x), by doubling."""
    m, n = H.shape
    C = np.empty((horizon * m, n))
    C[:m] = H
    filled, power = m, F
    while filled < len(C):
        fresh = min(filled, len(C) - filled)
        np.matmul(C[:fresh], power, out=C[filled : filled + fresh])
        filled += fresh
        if filled < len(C):
            power = power @ power
    return C


def constant_covariance(model: Model, K: Array, lag: int) -> Array | None:
    """Exact error covariance of the estimate K Z over the full window; None where rounding would spoil it.

    The backward recursion D_j = D_{j+1} F - g_j H (+ I at the state aimed at), for all j at once: within
    blocks, then between them. D_0 = T - K C is zero for an unbiased gain: what stands there is rounding.
    """
    n, m = model.dim_x, model.dim_z
    horizon = K.shape[1] // m
    size = max(1, math.isqrt(horizon))
    count = -(-horizon // size)
    flat = np.zeros((count * size, n, n))
    columns = np.ascontiguousarray(K.T).reshape(horizon, m, n)
    flat[:horizon] = -(model.H.T @ columns).transpose(0, 2, 1)
    flat[horizon - 1 - lag] += np.eye(n)
    # paths[step, block]: response of the estimate to noise that enters at j = block * size + step.
    paths = np.ascontiguousarray(flat.reshape(count, size, n, n).transpose(1, 0, 2, 3)).reshape(size, -1, n)
    powers = [model.F]
    with np.errstate(over="ignore", invalid="ignore"):
        for step in range(size - 2, -1, -1):
            paths[step] += paths[step + 1] @ model.F
            powers.append(powers[-1] @ model.F)
        starts = paths[0].reshape(count, n, n)
        for block in range(count - 2, -1, -1):
            starts[block] += starts[block + 1] @ powers[-1]
        paths[1:, :-n] += paths[0, n:] @ np.array(powers[-2::-1]).reshape(-1, n, n)
        first = starts[0]
        wide = paths.reshape(-1, n, n).transpose(1, 0, 2)
        noise = (wide @ model.Q).reshape(n, -1) @ wide.reshape(n, -1).T
        noise += (K.reshape(-1, m) @ model.R).reshape(n, -1) @ K.T
        rounding = np.einsum("ij,jk,ik->i", first, model.Q, first)
    if not (rounding <= PATH_ROUNDING**2 * np.diag(noise)).all():
        return None
    return symmetric(noise)
