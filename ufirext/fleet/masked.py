"""Windows with holes and late rows, many tracks at once: masked normal equations, tracks on the last axis.

With the whitened rows C = U S V' of the full window, rows that are there n times each (n = 0 or 1, more where
late rows share an origin) give  x = T V S^-1 y,  Lam y = sum U_i' W z_i,  Lam = sum n_i U_i' U_i. U is
orthonormal, so that Lam is close to the identity where little is missing; one step of correction,
y += Lam^-1 U' (W z - n U y), makes up for what the normal equations lose elsewhere (Bjorck, "Stability
analysis of the method of seminormal equations", Linear Algebra and its Applications 88/89, 1987).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from .._array_api import Space
from .._arrays import Array, readonly
from ..errors import UnobservableWindow
from ..gains import ufir_gain
from ..model import Model
from ..window import model_window
from .history import Batch

# The basis of the full window must reproduce its gain to this, relative to the largest entry.
BASIS_ROUNDING = 1e-12
# Pivots of the full window are 1; where one is below eps to this power, too little is left of it.
PIVOT_POWER = 0.2


class Basis(NamedTuple):
    """Orthonormal rows of the full window by age, newest first, and the way back to the newest state."""

    rows: Array  # (length, dim_z, rank)
    pairs: Array  # (rank (rank + 1) / 2, length * dim_z): products of the rows, lower triangle
    back: Array  # (dim_x, rank)


@lru_cache(maxsize=128)
def basis(model: Model, length: int) -> Basis | None:
    """The basis of the full window of `length` steps; None where it is not as accurate as the gain."""
    try:
        K = ufir_gain(model, length).K
    except UnobservableWindow:
        return None
    window = model_window(model, length)
    if window.overflows:
        return None
    U, s, Vt = window.spectrum
    rank = window.rank
    back = (window.T / window.scale) @ (Vt[:rank].T / s[:rank])
    rows = U[:, :rank].reshape(length, model.dim_z, rank)
    again = back @ (window.W[0].T @ rows).reshape(-1, rank).T
    if not np.abs(again - K).max() <= BASIS_ROUNDING * np.abs(K).max():
        return None
    newest_first = np.ascontiguousarray(rows[::-1])
    flat = newest_first.reshape(-1, rank)
    i, j = np.tril_indices(rank)
    pairs = np.ascontiguousarray((flat[:, i] * flat[:, j]).T)
    return Basis(readonly(newest_first), readonly(pairs), readonly(back))


def by_origin(batch: Batch, space: Space, length: int) -> tuple[Any, Any]:
    """Sums of the rows of each origin and their number, newest first: (length, dim_z, tracks) both."""
    xp = space.xp
    ages, m, tracks = batch.values.shape
    counted = xp.astype(batch.mask, space.dtype)
    if batch.delays is None:
        short = [xp.zeros((length - ages, m, tracks), dtype=space.dtype, **space.placed)]
        return tuple(a if ages == length else xp.concat([a, *short]) for a in (batch.values, counted))
    sums = counts = xp.zeros((length, m, tracks), dtype=space.dtype, **space.placed)
    for delay in np.unique(space.host(batch.delays)).tolist():
        here = xp.astype(batch.delays == delay, space.dtype)[:, None, :]
        above = xp.zeros((delay, m, tracks), dtype=space.dtype, **space.placed)
        below = xp.zeros((length - delay - ages, m, tracks), dtype=space.dtype, **space.placed)
        sums = sums + xp.concat([above, here * batch.values, below])
        counts = counts + xp.concat([above, here * counted, below])
    return sums, counts


def estimates(model: Model, whitener: Any, space: Space, sums: Any, counts: Any) -> tuple[Any, Any]:
    """x (tracks, dim_x) by least squares over the rows, and whether the normal equations can be trusted."""
    xp = space.xp
    length, m, tracks = sums.shape
    found = basis(model, length)
    if found is None:
        shape = (tracks, model.dim_x)
        return xp.full(shape, np.nan, dtype=space.dtype, **space.placed), np.zeros(tracks, bool)
    rows = space.constant(found.rows.reshape(length * m, -1))
    across = xp.permute_dims(rows, (1, 0))
    white = xp.reshape(xp.matmul(whitener, sums), (length * m, tracks))
    counts = xp.reshape(counts, (length * m, tracks))
    factor = Cholesky(xp.matmul(space.constant(found.pairs), counts), len(found.back.T), space)
    y = factor.solve(xp.matmul(across, white))
    y = y + factor.solve(xp.matmul(across, white - counts * xp.matmul(rows, y)))
    x = xp.matmul(space.constant(found.back), y)
    return xp.permute_dims(x, (1, 0)), space.host(factor.pivot > space.eps**PIVOT_POWER)


class Cholesky:
    """Factors of many small matrices at once, each entry an array over the tracks."""

    def __init__(self, lower: Any, size: int, space: Space) -> None:
        xp = space.xp
        self.space, self.size = space, size
        self.factor: dict[tuple[int, int], Any] = {}
        self.pivot = xp.full_like(lower[0, :], np.inf)
        for i in range(size):
            for j in range(i + 1):
                value = lower[i * (i + 1) // 2 + j, :]
                for k in range(j):
                    value = value - self.factor[i, k] * self.factor[j, k]
                if i == j:
                    value = xp.sqrt(xp.where(value > 0.0, value, 0.0))
                    self.pivot = xp.where(value < self.pivot, value, self.pivot)
                    # Tracks with a tiny pivot are answered elsewhere: any divisor keeps the others quiet.
                    value = xp.where(value > space.eps, value, 1.0)
                self.factor[i, j] = value if i == j else value / self.factor[j, j]

    def solve(self, right: Any) -> Any:
        """Solutions (size, tracks) for right-hand sides (size, tracks)."""
        L, y = self.factor, [right[i, :] for i in range(self.size)]
        for i in range(self.size):
            for k in range(i):
                y[i] = y[i] - L[i, k] * y[k]
            y[i] = y[i] / L[i, i]
        for i in reversed(range(self.size)):
            for k in range(i + 1, self.size):
                y[i] = y[i] - L[k, i] * y[k]
            y[i] = y[i] / L[i, i]
        return self.space.xp.stack(y)
