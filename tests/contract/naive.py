"""Oracles written to be believed, not to be fast: the book's Kalman filter and windowed least squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass
class BookKalman:
    """The Kalman filter as every book prints it."""

    x: Array
    P: Array

    def predict(self, F: Array, Q: Array) -> None:
        self.x, self.P = F @ self.x, F @ self.P @ F.T + Q

    def update(self, z: Array, H: Array, R: Array) -> None:
        K = self.P @ H.T @ np.linalg.inv(H @ self.P @ H.T + R)
        self.x = self.x + K @ (z - H @ self.x)
        self.P = (np.eye(len(self.x)) - K @ H) @ self.P


@dataclass(frozen=True)
class Row:
    """A measurement z = H x_origin + v, cov v = R."""

    origin: int
    z: Array
    H: Array
    R: Array


def extended(rows: list[Row], now: int, horizon: int, instants: int) -> list[Row]:
    """Rows of (now - horizon, now], and older ones, an instant at a time, while there are fewer instants."""
    chosen = [row for row in rows if row.origin > now - horizon]
    older = sorted({row.origin for row in rows} - {row.origin for row in chosen})
    while older and len({row.origin for row in chosen}) < instants:
        chosen += [row for row in rows if row.origin == older[-1]]
        older.pop()
    return chosen


def window_estimate(rows: list[Row], F: Array, Q: Array, now: int) -> tuple[Array, Array]:
    """Weighted least squares over ``rows`` for the state at ``now``, and its exact error covariance.

    P = sum_j D_j Q D_j' + sum_r g_r R_r g_r' with D_j = Phi(now, j) - sum over rows with origin >= j of
    g_r H_r Phi(origin_r, j); j runs over the steps after the oldest origin.
    """
    oldest = min(row.origin for row in rows)

    def phi(to: int, start: int) -> Array:
        return np.linalg.matrix_power(F, to - start)

    whiten = [np.linalg.inv(np.linalg.cholesky(row.R)) for row in rows]
    C = np.vstack([w @ row.H @ phi(row.origin, oldest) for w, row in zip(whiten, rows, strict=True)])
    target = phi(now, oldest)
    x_old = np.linalg.lstsq(
        C, np.concatenate([w @ row.z for w, row in zip(whiten, rows, strict=True)]), rcond=None
    )[0]
    gains = np.split(target @ np.linalg.pinv(C), np.cumsum([len(row.z) for row in rows])[:-1], axis=1)
    gains = [g @ w for g, w in zip(gains, whiten, strict=True)]

    P = sum(g @ row.R @ g.T for g, row in zip(gains, rows, strict=True))
    for j in range(oldest + 1, now + 1):
        D = phi(now, j) - sum(
            (g @ row.H @ phi(row.origin, j) for g, row in zip(gains, rows, strict=True) if row.origin >= j),
            start=np.zeros_like(F),
        )
        P = P + D @ Q @ D.T
    return target @ x_old, P
