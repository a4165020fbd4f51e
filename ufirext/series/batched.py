"""Small matrices in large numbers, the batch on the last axis: one vector operation for all of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .._arrays import Array
from .._rounding import SUSPECT

__all__ = ["gram", "laid_out", "padded", "positive_solution", "product"]

# Matrices with so many rows are multiplied one by one, smaller ones entry by entry.
WIDE = 6


def padded(series: Array, first: int, length: int, outside: Array) -> Array:
    """series[first : first + length], with `outside` before and after its ends."""
    inner = series[max(first, 0) : max(first + length, 0)]
    whole = np.empty((length, *outside.shape))
    before = min(max(-first, 0), length)
    whole[:before], whole[before + len(inner) :] = outside, outside
    whole[before : before + len(inner)] = inner
    return whole


def laid_out(*shape: int) -> Array:
    """An array (rows, columns, ..): small matrices are spread over the batch, large ones are whole."""
    if shape[1] < WIDE:
        return np.empty(shape)
    return np.empty((*shape[2:], *shape[:2])).transpose(-2, -1, *range(len(shape) - 2))


def product(a: Array, b: Array) -> Array:
    """Products of matrices (.., .., batch)."""
    if b.shape[1] < WIDE:
        return np.asarray(np.einsum("ikb,kjb->ijb", a, b))
    return np.asarray((a.transpose(2, 0, 1) @ b.transpose(2, 0, 1)).transpose(1, 2, 0))


def gram(a: Array, b: Array) -> Array:
    """a' b of matrices (.., .., batch)."""
    return product(a.transpose(1, 0, 2), b)


def positive_solution(
    A: Array, b: Array, weakest: float, diagonal: Array | None = None
) -> tuple[Array, NDArray[np.bool_]]:
    """x of A x = b for symmetric positive definite A (n, n, batch), b (n, .., batch), by Cholesky.

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
