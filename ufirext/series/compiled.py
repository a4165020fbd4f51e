"""The scan as one compiled loop; imported only when somebody asks for engine="numba".

The same recursions as in `scan`, a window after the other. Information on a state is [Lam; eta'] (n + 1, n).
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from .._arrays import Array
from .._rounding import SUSPECT
from .windows import Mask

__all__ = ["scan_series"]


def _product(a: Array, b: Array, out: Array) -> None:
    """out = a b; the innermost loops run along rows, which lie together in memory."""
    rows, columns = out.shape
    for i in range(rows):
        for j in range(columns):
            out[i, j] = 0.0
        for k in range(b.shape[0]):
            factor = a[i, k]
            for j in range(columns):
                out[i, j] += factor * b[k, j]


def _absorb(rows: Array, information: Array) -> None:
    """Rows [H, -z] of a state join the information on it."""
    n = information.shape[1]
    for r in range(rows.shape[0]):
        for i in range(n):
            factor = rows[r, i]
            for j in range(n):
                information[i, j] += factor * rows[r, j]
        for j in range(n):
            information[n, j] -= rows[r, n] * rows[r, j]


def _moved(information: Array, G: Array, temporary: Array, out: Array) -> None:
    """Information on a state as information on the one before, from which G leads to it."""
    n = information.shape[1]
    for i in range(n + 1):
        for j in range(n):
            temporary[i, j] = 0.0
        for k in range(n):
            factor = information[i, k]
            for j in range(n):
                temporary[i, j] += factor * G[k, j]
    # eta' - b' Lam, moved.
    for j in range(n):
        out[n, j] = temporary[n, j]
    for i in range(n):
        factor = G[i, n]
        if factor != 0.0:
            for j in range(n):
                out[n, j] -= factor * temporary[i, j]
    for i in range(n):
        for j in range(n):
            out[i, j] = 0.0
    for k in range(n):
        for i in range(n):
            factor = G[k, i]
            for j in range(n):
                out[i, j] += factor * temporary[k, j]


def _solution(information: Array, weakest: float, lower: Array, x: Array) -> bool:
    """The state of information [Lam; eta'] by Cholesky of the scaled Lam; False where a pivot is weak."""
    n = information.shape[1]
    most = 0.0
    for i in range(n):
        most = max(most, information[i, i])
    for i in range(n):
        if not information[i, i] > SUSPECT * most:
            return False
    for i in range(n):
        for j in range(i + 1):
            entry = information[i, j] / np.sqrt(information[i, i] * information[j, j])
            for k in range(j):
                entry -= lower[i, k] * lower[j, k]
            if i == j:
                if not entry >= weakest * weakest:
                    return False
                lower[i, i] = np.sqrt(entry)
            else:
                lower[i, j] = entry / lower[j, j]
    for i in range(n):
        value = information[n, i] / np.sqrt(information[i, i])
        for k in range(i):
            value -= lower[i, k] * x[k]
        x[i] = value / lower[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= lower[k, i] * x[k]
        x[i] /= lower[i, i]
    for i in range(n):
        x[i] /= np.sqrt(information[i, i])
    return True


def _suffixes(
    G: Array, A: Array, boundary: int, table: Array, leads: Array, temporary: Array, count: int
) -> None:
    """Information of the last 0 .. count - 1 rows before a boundary, and the homogeneous way to it."""
    k = G.shape[1]
    table[0] = 0.0
    leads[0] = np.eye(k)
    for length in range(1, count):
        move = G[boundary - length + 1]
        moved(table[length - 1], move, temporary, table[length])
        absorb(A[boundary - length], table[length])
        product(leads[length - 1], move, leads[length])


def _scan_series(
    G: Array, A: Array, horizon: int, lag: int, weakest: float, states: Array, sound: Mask
) -> None:
    """All windows of a series: homogeneous moves G (T, k, k) and rows A (T, m, k); see `Scan`."""
    steps, k = G.shape[0], G.shape[1]
    n, m, spacing = k - 1, A.shape[1], horizon - lag
    table, leads = np.zeros((spacing, n + 1, n)), np.zeros((spacing, k, k))
    ways, seen = np.zeros((lag + 2, k, k)), np.zeros((m, k))
    temporary, whole, lower, x = np.zeros((n + 1, n)), np.zeros((n + 1, n)), np.zeros((n, n)), np.ones((k, 1))
    oldest, reached = np.ones((k, 1)), np.ones((k, 1))
    for boundary in range(0, steps, spacing):
        suffixes(G, A, boundary, table, leads, temporary, min(spacing, boundary + 1))
        prefix = np.zeros((n + 1, n))
        for offset in range(min(horizon, steps - boundary)):
            step, place = boundary + offset, offset % (lag + 2)
            if offset == 0:
                ways[0] = np.eye(k)
            else:
                product(G[step], ways[(offset - 1) % (lag + 2)], ways[place])
            product(A[step], ways[place], seen)
            absorb(seen, prefix)
            if offset < lag:
                continue
            length = min(horizon - 1 - offset, boundary)
            moved(prefix, leads[length], temporary, whole)
            whole += table[length]
            if solution(whole, weakest, lower, oldest[:, 0]):
                product(leads[length], oldest, reached)
                product(ways[(offset - lag) % (lag + 2)], reached, x)
                states[step, :n] = x[:n]
                sound[step] = True


# Compiled at the first call; untyped, as numba makes them.
product: Any = numba.njit(_product)
absorb: Any = numba.njit(_absorb)
moved: Any = numba.njit(_moved)
solution: Any = numba.njit(_solution)
suffixes: Any = numba.njit(_suffixes)
scan_series: Any = numba.njit(_scan_series)
