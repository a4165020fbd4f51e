"""LAPACK's Cholesky solver, loaded when first needed, so that importing ufirext stays light."""

from __future__ import annotations

from functools import cache
from typing import Any


@cache
def cholesky_solver() -> Any:
    """dposv: factor, solution, info of A x = b for symmetric positive definite A; an eighth of np.linalg.solve."""
    from scipy.linalg.lapack import dposv

    return dposv
