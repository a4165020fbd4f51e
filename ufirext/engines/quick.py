"""A measurement as a row, quickly: what is plainly a row of arrays of floats passes, and nothing else."""

from __future__ import annotations

from math import hypot, inf
from typing import Any

import numpy as np

from .._arrays import FLOAT
from ..window import Row

__all__ = ["quick_row"]


def quick_row(now: int, z: Any, H: Any, R: Any) -> Row | None:
    """A row of this step from arrays of floats, H and R not copied; None for whatever needs a closer look.

    That is: other types and shapes, NaN, infinity, an R that is plainly no covariance, an H with a row of
    zeros, which measures nothing.
    """
    if not (H.__class__ is R.__class__ is np.ndarray and H.dtype is R.dtype is FLOAT and H.ndim == 2):
        return None
    m = len(H)
    if R.shape != (m, m):
        return None
    if z.__class__ is np.ndarray and z.dtype is FLOAT and z.shape in ((m, 1), (m,)):
        flat = z.flatten()
    elif z.__class__ is float and m == 1:
        flat = np.array([z])
    else:
        return None
    total = sum(flat.tolist())
    if total - total != 0.0:
        return None
    information = 0.0
    variances = R.diagonal().tolist()
    for numbers, variance in zip(H.tolist(), variances, strict=True):
        norm = hypot(*numbers)
        if not (0.0 < norm < inf and 0.0 < variance < inf):
            return None
        information += norm * norm / variance
    row = Row(now, now, H, R, flat)
    if np.count_nonzero(R) == m:
        row._information = information
        row.precision = [1.0 / variance for variance in variances]
    elif R.tobytes() != R.T.tobytes() or not np.vdot(R, R) < inf:
        return None
    return row
