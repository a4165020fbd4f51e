"""What clients pass to the verbs, in any of filterpy's forms, as flat arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .._arrays import Array, column, matrix, real
from ..errors import NonFiniteError


def measurement(z: ArrayLike | None, m: int) -> Array | None:
    """z as a flat (m,) array with NaN for missing components, None as None; infinity is refused."""
    if z is None:
        return None
    flat = column(z, m, "z")
    if not flat.dot(flat) < np.inf and np.isinf(flat).any():
        raise NonFiniteError(f"z must be finite (NaN marks a missing component), got {flat}")
    return flat


def input_matrix(B: ArrayLike | None, n: int) -> Array:
    array = real(B, "B") if B is not None else np.zeros((n, 0))
    if array.ndim < 2:
        array = array.reshape(-1, 1) if array.size == n else array
    return matrix(array, (n, None), "B", "(dim_x, dim_u)")


def input_vector(u: ArrayLike, size: int) -> Array:
    array = real(u, "u")
    if array.ndim == 0 and size != 1 and array == 0.0:
        return np.zeros(size)  # filterpy's batch and MMAE pass u = 0 for no input
    flat = column(array, size, "u")
    if not np.isfinite(flat).all():
        raise NonFiniteError(f"u must be finite, got {flat}")
    return flat
