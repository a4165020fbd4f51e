"""What one update left behind, and filterpy's derived quantities as functions of it."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .._arrays import Array, symmetric
from ..engines.covariance import Covariance

LOG_SMALLEST = math.log(sys.float_info.min)


@dataclass(frozen=True)
class Update:
    """One update(): the measurement, the prior it met and the gain it got (arrays flat, z None if missing).

    `mask` marks the measured components; `gain` gives K on them. `cross` is filterpy's M, used by
    update_correlated.
    """

    z: Array | None
    H: Array
    R: Array
    mask: Array
    x: Array
    P: Covariance
    gain: Covariance
    cross: Array | None = None

    @cached_property
    def y(self) -> Array:
        """Innovation z - H x_prior, 0 where nothing was measured."""
        if self.z is None:
            return np.zeros(len(self.H))
        if self.mask.all():
            innovation: Array = self.z - self.H.dot(self.x)
            return innovation
        return np.where(self.mask, np.where(self.mask, self.z, 0.0) - self.H @ self.x, 0.0)

    @cached_property
    def S(self) -> Array:
        """Innovation covariance H P_prior H' + R."""
        S = self.P.innovation(self.H, self.R)
        if self.cross is not None:
            S = symmetric(S + self.H @ self.cross + self.cross.T @ self.H.T)
        return S

    @cached_property
    def K(self) -> Array:
        """Gain of the newest row, zero columns where nothing was measured."""
        K = np.zeros((self.H.shape[1], len(self.H)))
        if self.z is not None and self.mask.any():
            K[:, self.mask] = self.gain.value
        return K

    def log_likelihood(self) -> float:
        """log N(y; 0, S) over the measured components (all of them, at y = 0, where nothing was measured)."""
        if self.z is None or not self.mask.any():
            return log_normal(np.zeros(len(self.H)), self.S)
        mask = self.mask
        return log_normal(self.y[mask], self.S[np.ix_(mask, mask)])


def log_normal(y: Array, S: Array) -> float:
    """log of the normal density N(y; 0, S); on the range of S where it is singular."""
    try:
        L = np.linalg.cholesky(S)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(S)
        kept = values > 1e-12 * max(float(values[-1]), sys.float_info.min)
        white = (vectors.T @ y)[kept] / np.sqrt(values[kept])
        return float(-0.5 * (white @ white + np.log(2 * np.pi * values[kept]).sum()))
    white = np.linalg.solve(L, y)
    return float(-0.5 * (white @ white + len(y) * math.log(2 * math.pi)) - np.log(np.diag(L)).sum())


def innovation_gain(P: Array, H: Array, R: Array, cross: Array | None = None) -> tuple[Array, Array]:
    """The book's Kalman gain and innovation covariance."""
    PHt = P @ H.T
    S = H @ PHt + R
    if cross is not None:
        S = S + H @ cross + cross.T @ H.T
        PHt = PHt + cross
    try:
        return np.asarray(np.linalg.solve(S, PHt.T).T, dtype=float), S
    except np.linalg.LinAlgError:
        return PHt @ np.linalg.pinv(S), S


def joseph(P: Array, K: Array, H: Array, R: Array) -> Array:
    """(I - K H) P (I - K H)' + K R K'."""
    rest = np.eye(len(P)) - K @ H
    return symmetric(rest @ P @ rest.T + K @ R @ K.T)
