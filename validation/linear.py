"""Filters as linear maps of the measurements, applied to many runs at once.

Where the gains do not depend on the data (the same delays and losses in all runs) a filter of `ufirext` is
asked for its gains once, and every run gets them. What noise does to such a filter can also be computed
without drawing any: its error is the estimate from the mean measurements, minus the truth, plus noise of a
known covariance. Monte Carlo is held against that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ufirext import Model, ufir_gain
from validation.scores import SETTLING

__all__ = ["Finite", "Linear", "Recursion", "expected_squares", "recursion"]

Array = NDArray[np.float64]

REPEATS = 1e-10
"""Gains that change by less than this fraction from step to step have settled."""


class Linear(Protocol):
    """A filter whose gains are known before the data come."""

    def track(self, zs: Array) -> Array:
        """Estimates (runs, steps, dim_x) from measurements (runs, steps, dim_z)."""

    def spread(self, V: Array) -> Array:
        """Error covariances (runs, steps, dim_x, dim_x) from those of the measurements' noise."""


@dataclass(frozen=True)
class Recursion:
    """x^_n = F x^_{n-1} + K_n (z_n - H F x^_{n-1}): every Kalman and H-infinity filter.

    Attributes
    ----------
    F : ndarray, (dim_x, dim_x)
    H : ndarray, (dim_z, dim_x) or (steps, dim_z, dim_x)
        Of the measurement that arrives, as one of the present state.
    K : ndarray, (steps, dim_x, dim_z)
        0 where nothing arrives.
    """

    F: Array
    H: Array
    K: Array

    @property
    def radius(self) -> float:
        """Spectral radius of (I - K H) F at the last step: above 1 the errors grow without end."""
        return float(np.abs(np.linalg.eigvals(self.closed[-1])).max())

    @property
    def closed(self) -> Array:
        """(I - K H) F, (steps, dim_x, dim_x)."""
        return np.asarray(self.F - self.K @ self.H @ self.F)

    def track(self, zs: Array) -> Array:
        """Estimates from the first measurement on, at rest there."""
        x = _at_rest(zs, self.F)
        estimates = np.empty((*zs.shape[:2], len(self.F)))
        nothing = np.abs(self.K).sum(axis=(1, 2)) == 0.0
        arrived = zs.copy()
        arrived[:, nothing] = 0.0
        driven = np.einsum("rsz,sxz->rsx", arrived, self.K)
        moved = self.closed.swapaxes(1, 2)
        with np.errstate(over="ignore", invalid="ignore"):
            for step, A in enumerate(moved):
                x = x @ A + driven[:, step]
                estimates[:, step] = x
        return estimates

    def spread(self, V: Array) -> Array:
        """C_n = A C_{n-1} A' + K V_n K'; the start is taken as known."""
        runs, steps = V.shape[:2]
        C = np.zeros((runs, len(self.F), len(self.F)))
        result = np.empty((runs, steps, *C.shape[1:]))
        with np.errstate(over="ignore", invalid="ignore"):
            for step, (A, K) in enumerate(zip(self.closed, self.K, strict=True)):
                C = A @ C @ A.T + K @ V[:, step] @ K.T
                result[:, step] = C
        return result


@dataclass(frozen=True)
class Finite:
    """x^_n = F^delay K Z: an FIR filter whose measurements all come `delay` steps late.

    Attributes
    ----------
    K : ndarray, (dim_x, horizon * dim_z)
        Oldest measurement first.
    F : ndarray, (dim_x, dim_x)
    delay : int
    """

    K: Array
    F: Array
    delay: int = 0

    @classmethod
    def ufir(cls, model: Model, horizon: int, delay: int = 0) -> Finite:
        """The UFIR filter of a full window: with a constant delay it is the filter without, moved ahead."""
        return cls(ufir_gain(model, horizon).K, model.F, delay)

    @property
    def moved(self) -> Array:
        """F^delay K."""
        return np.asarray(np.linalg.matrix_power(self.F, self.delay) @ self.K)

    def track(self, zs: Array) -> Array:
        """Estimates, NaN until the window is full."""
        runs, steps, size = zs.shape
        horizon = self.K.shape[1] // size
        windows = np.lib.stride_tricks.sliding_window_view(zs, horizon, axis=1).swapaxes(2, 3)
        estimates = np.full((runs, steps, len(self.K)), np.nan)
        estimates[:, horizon - 1 :] = windows.reshape(runs, -1, horizon * size) @ self.moved.T
        return estimates

    def spread(self, V: Array) -> Array:
        """The sum over the window of g V g'."""
        runs, steps, size = V.shape[:3]
        blocks = self.moved.reshape(len(self.K), -1, size).swapaxes(0, 1)
        result = np.full((runs, steps, len(self.K), len(self.K)), np.nan)
        last = steps - len(blocks) + 1
        result[:, len(blocks) - 1 :] = sum(
            (g @ V[:, row : row + last] @ g.T for row, g in enumerate(blocks)),
            start=np.zeros((runs, last, len(self.K), len(self.K))),
        )
        return result


def recursion(f: Any, model: Model, delays: Sequence[int | None], H: Array | None = None) -> Recursion:
    """A filter's gains over a pattern of delays; None where nothing arrives.

    Parameters
    ----------
    f : DelayKalmanFilter or DelayHInfinityFilter
        Fresh. It is given the model's F, H, Q, R, and keeps its P.
    model : Model
    delays : sequence of int or None
        Of what arrives, one a step.
    H : ndarray, optional
        Of the measurement that arrives, if it is not the model's.
    """
    f.F, f.H, f.Q, f.R = model.F, model.H, model.Q, model.R
    K = np.zeros((len(delays), model.dim_x, model.dim_z))
    z = np.zeros(model.dim_z)
    start = 0
    for delay, group in groupby(delays):
        stop = start + len(list(group))
        for step in range(start, stop):
            f.predict()
            if delay is None:
                f.update(None)
                continue
            known = f.dropped
            f.update(z, delay=delay)
            if f.dropped > known:
                continue  # a duplicate
            K[step] = f.K
            if step > start and np.abs(K[step] - K[step - 1]).max() <= REPEATS * np.abs(K[step]).max():
                K[step:stop] = K[step]
                break
        start = stop
    return Recursion(model.F, model.H if H is None else H, K)


def expected_squares(tracker: Linear, means: Array, V: Array, truth: Array, axis: int = 1) -> Array:
    """The mean squared position error of every run, (runs,), averaged over the noise without drawing any.

    Parameters
    ----------
    tracker : Linear
    means : ndarray, (runs, steps, 2)
        Expected measurements.
    V : ndarray, (runs, steps, 2, 2)
        Covariances of their noise, independent from step to step.
    truth : ndarray, (runs, steps, 2)
    axis : int
        1: north; 0: east.
    """
    state = 2 * axis
    with np.errstate(over="ignore", invalid="ignore"):
        bias = tracker.track(means)[:, SETTLING:, state] - truth[:, SETTLING:, axis]
        variance = tracker.spread(V)[:, SETTLING:, state, state]
        mean: Array = np.mean(bias**2 + variance, axis=1)
    return np.where(np.isfinite(mean), mean, np.inf)


def _at_rest(zs: Array, F: Array) -> Array:
    """States at the first measurement of every run, with no velocity."""
    x = np.zeros((len(zs), len(F)))
    first = np.argmax(np.isfinite(zs).all(axis=2), axis=1)
    x[:, ::2] = zs[np.arange(len(zs)), first]
    return x
