"""LAPACK's Cholesky routines, loaded when first needed, so that importing ufirext stays light."""

from __future__ import annotations

import sys
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@cache
def cholesky_solver() -> Any:
    """dposv: factor, solution, info of A x = b for symmetric positive definite A; an eighth of
    np.linalg.solve.
    """
    from scipy.linalg.lapack import dposv

    return dposv


def is_positive_definite(array: Array) -> bool:
    """Whether a symmetric matrix has a Cholesky factor; by LAPACK itself once SciPy is there anyway."""
    lapack = sys.modules.get("scipy.linalg.lapack")
    if lapack is not None:
        factor, failed = lapack.dpotrf(array)
        if failed:
            return False
    else:
        try:
            factor = np.linalg.cholesky(array)
        except np.linalg.LinAlgError:
            return False
    # A pivot that is NaN, there or by overflow, does not fail: it makes the last one NaN.
    return not len(array) or bool(factor.item(-1) > 0.0)
