"""Accelerations of four shapes, the target that has them, and the three estimators of Table 2.

An acceleration a_i that the model does not know is added to the state x_a: x_{i+1} = A x_i + G w_i +
[0, 0, a_{i+1} - a_i]'. The estimates of many runs are products with constant gains; `streamed` has the same
from the filters themselves, one measurement at a time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ufirext import DelayKalmanFilter, FMSFilterSmoother, filter_series
from validation.s3.tracking import RUNS, STEPS, A, C, D, G, M, Q, R, gain, model

__all__ = [
    "ESTIMATORS",
    "SHAPES",
    "Errors",
    "Shape",
    "at_once",
    "errors",
    "estimates",
    "simulate",
    "streamed",
]

Array = NDArray[np.float64]

ESTIMATORS = ("FMS smoother", "FMS filter", "Kalman filter")


class Shape(NamedTuple):
    """A shape of acceleration.

    Attributes
    ----------
    name : str
    amplitude : float
        Fitted to the FMS-filter row of Table 2.
    profile : callable
        rng, amplitude -> acceleration at 0 .. STEPS - 1.
    """

    name: str
    amplitude: float
    profile: Callable[[np.random.Generator, float], Array]

    def acceleration(self, rng: np.random.Generator) -> Array:
        """The acceleration with the fitted amplitude, (STEPS,)."""
        return self.profile(rng, self.amplitude)


def _step(rng: np.random.Generator, amplitude: float) -> Array:
    i = np.arange(STEPS)
    return np.where((i >= 200) & (i < 400), amplitude, 0.0)


def _ramp(rng: np.random.Generator, amplitude: float) -> Array:
    i = np.arange(STEPS)
    return np.where((i >= 200) & (i < 400), amplitude * (i - 200) / 200, 0.0)


def _triangle(rng: np.random.Generator, amplitude: float) -> Array:
    return np.interp(np.arange(STEPS), [200, 400, 600], [0.0, amplitude, 0.0])


def _random(rng: np.random.Generator, amplitude: float) -> Array:
    knots = np.arange(0, STEPS + 80, 80)
    return np.interp(np.arange(STEPS), knots, rng.uniform(-amplitude, amplitude, len(knots)))


SHAPES = {
    "step": Shape("step", 0.185, _step),
    "ramp": Shape("ramp", 0.175, _ramp),
    "triangle": Shape("triangle", 0.134, _triangle),
    "random": Shape("random", 0.13, _random),
}


def simulate(rng: np.random.Generator, acceleration: Array, runs: int = RUNS) -> tuple[Array, Array]:
    """States (STEPS, 3, runs) from rest, and measured positions (STEPS, runs)."""
    w = G @ np.linalg.cholesky(Q) @ rng.standard_normal((STEPS, len(Q), runs))
    w[:, 2] += np.diff(acceleration, append=acceleration[-1])[:, None]
    x = np.zeros((STEPS, len(A), runs))
    x[0, 2] = acceleration[0]
    for i in range(STEPS - 1):
        x[i + 1] = A @ x[i] + w[i]
    return x, (C @ x)[:, 0] + np.sqrt(R) * rng.standard_normal((STEPS, runs))


def estimates(z: Array) -> dict[str, Array]:
    """States by estimator, (STEPS, 3, runs), from measured positions (STEPS, runs).

    At step i, x^_{i-D} of the smoother, x^_i of the others, all from z_{i-1} and older; NaN where i < M.
    """
    H = gain().H
    windows = np.lib.stride_tricks.sliding_window_view(z[:-1], M, axis=0)
    both = np.full((len(z), 2 * len(A), z.shape[1]), np.nan)
    both[M:] = (windows @ H.T).transpose(0, 2, 1)
    kalman = np.zeros((len(z), len(A), z.shape[1]))
    K, _ = steady()
    for i in range(len(z) - 1):
        kalman[i + 1] = A @ (kalman[i] + K @ (z[i] - C @ kalman[i]))
    kalman[:M] = np.nan
    return dict(zip(ESTIMATORS, (both[:, len(A) :], both[:, : len(A)], kalman), strict=True))


@dataclass(frozen=True)
class Errors:
    """Errors of the position, for each estimator (STEPS - M, runs), from step M on."""

    by: dict[str, Array]

    def table_2(self) -> dict[str, float]:
        """What Table 2 holds: the time average of the absolute value of the mean over the runs."""
        return {name: float(np.abs(e.mean(axis=1)).mean()) for name, e in self.by.items()}

    def rms(self) -> dict[str, float]:
        """The root-mean-square error over all runs and steps."""
        return {name: float(np.sqrt((e**2).mean())) for name, e in self.by.items()}


def errors(x: Array, found: dict[str, Array]) -> Errors:
    """Errors of the position, from states and estimates (STEPS, 3, runs)."""
    lag = {name: D if name == "FMS smoother" else 0 for name in found}
    return Errors({name: e[M:, 0] - x[M - lag[name] : len(x) - lag[name], 0] for name, e in found.items()})


def streamed(z: Array) -> dict[str, Array]:
    """The same as `estimates` for one run, z (STEPS,), from the filters, one measurement at a time."""
    target = model()
    fms = FMSFilterSmoother(3, 1, horizon=M, lag=D - 1)
    kalman = DelayKalmanFilter(3, 1)
    for f in (fms, kalman):
        f.F, f.H, f.Q, f.R = target.F, target.H, target.Q, target.R
    kalman.P = steady()[1]
    found = {name: np.full((len(z), 3, 1), np.nan) for name in ESTIMATORS}
    for i, measured in enumerate(z):
        if i >= M:
            found["FMS smoother"][i] = np.reshape(fms.x_lag, (3, 1))
        for f in (fms, kalman):
            f.predict()
        if i >= M:
            found["FMS filter"][i] = np.reshape(fms.x_prior, (3, 1))
            found["Kalman filter"][i] = np.reshape(kalman.x_prior, (3, 1))
        for f in (fms, kalman):
            f.update(measured)
    return found


def at_once(z: Array) -> dict[str, Array]:
    """The same for filter and smoother from `filter_series`: the whole of z (STEPS,) in one call."""
    target = model()
    noise = (target.Q, target.R)
    found = {name: np.full((len(z), 3, 1), np.nan) for name in ESTIMATORS[:2]}
    now = filter_series(target, z, M, noise=noise).x
    found["FMS filter"][M:, :, 0] = now[M - 1 : -1] @ A.T
    found["FMS smoother"][M:, :, 0] = filter_series(target, z, M, lag=D - 1, noise=noise).x[M - 1 : -1]
    return found


@cache
def steady() -> tuple[Array, Array]:
    """The Kalman filter's gain, (3, 1), and posterior covariance once they have settled."""
    f, target = DelayKalmanFilter(3, 1), model()
    f.F, f.H, f.Q, f.R = target.F, target.H, target.Q, target.R
    for _ in range(500):
        f.predict()
        f.update(0.0)
    return f.K, f.P
