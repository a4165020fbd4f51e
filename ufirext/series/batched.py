"""Small matrices in large numbers, the batch on the last axis: one vector operation for all of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .._arrays import Array
from .._rounding import SUSPECT

__all__ = ["positive_solution"]


def positive_solution(
    A: Array, b: Array, weakest: float, diagonal: Array | None = None
) -> tuple[Array, NDArray[np.bool_]]:
    """x of A x = b for symmetric positive definite A (n, n, batch), b (n, batch), by Cholesky.

    The matrices are scaled by `diagonal` (n, batch), their own by default. Also where the smallest pivot is
    then at least `weakest`, so that no more digits than those of 1 / weakest^2 are lost, and no diagonal
    entry is so small beside another that it may be rounding; elsewhere x is anything.
    """
    n = len(A)
    entries = A[range(n), range(n)]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        unit = 1.0 / np.sqrt(entries if diagonal is None else diagonal)
        L: list[list[Array]] = []
        sound: NDArray[np.bool_] = np.asarray(np.isfinite(unit).all(axis=0))
        sound &= entries.min(axis=0) >= SUSPECT * entries.max(axis=0)
        y: list[Array] = []
        for i in range(n):
            row: list[Array] = []
            for j in range(i):
                entry = A[i, j] * unit[i] * unit[j]
                for k in range(j):
                    entry -= row[k] * L[j][k]
                entry *= L[j][j]  # diagonals hold inverses
                row.append(entry)
            pivot = A[i, i] * unit[i] * unit[i]
            for k in range(i):
                pivot -= row[k] * row[k]
            sound &= pivot >= weakest * weakest
            row.append(1.0 / np.sqrt(pivot))
            L.append(row)
            value = b[i] * unit[i]
            for k in range(i):
                value -= row[k] * y[k]
            y.append(value * row[i])
        for i in range(n - 1, -1, -1):
            for k in range(i + 1, n):
                y[i] -= L[k][i] * y[k]
            y[i] *= L[i][i]
        return np.array([value * scale for value, scale in zip(y, unit, strict=True)]), sound
