"""The filters of S0 for data that are k steps late, the paper's and the right ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from ufirext import DelayHInfinityFilter, DelayKalmanFilter, Model, ThetaTooLarge, TimeStamped
from validation.drives import STEPS, Scene
from validation.linear import Finite, Recursion, recursion
from validation.scores import rmse, squares
from validation.vehicle import HORIZON, vehicle

__all__ = ["MODEL", "best_theta", "effective", "kalman", "robust", "robust_squares", "theta_limit", "ufir"]

MODEL = vehicle()


def effective(k: int) -> Model:
    """A measurement that is k steps late as one of the present state: equations (6) and (8)."""
    row = TimeStamped(k).effective(MODEL, k)
    return replace(MODEL, H=row.H, R=row.R)


def ufir(k: int, horizon: int = HORIZON) -> Finite:
    """The UFIR filter, equations (33) to (45)."""
    return Finite.ufir(MODEL, horizon, k)


def kalman(k: int, method: str) -> Recursion:
    """method="white" is the paper's, equations (14) to (17); "exact" is the optimum."""
    f = DelayKalmanFilter(4, 2, max_delay=k, method=method)
    delays = [None if step < k else k for step in range(STEPS)]
    return recursion(f, MODEL, delays, effective(k).H)


def robust(k: int, theta: float, form: str = "mixed") -> Recursion:
    """form="mixed" is the paper's, gain (19) under the condition (22); "posterior" has a guarantee.

    It starts when the first measurement arrives.

    Raises
    ------
    ThetaTooLarge
        Where the condition fails.
    """
    found = recursion(DelayHInfinityFilter(4, 2, theta=theta, form=form), effective(k), [0] * (STEPS - k))
    return replace(found, K=np.concatenate([np.zeros((k, *found.K.shape[1:])), found.K]))


def theta_limit(k: int, form: str = "mixed", digits: float = 1e-2) -> float:
    """The theta beyond which the condition fails at some step, by bisection."""
    low, high = 0.0, 0.1
    while high - low > digits * high:
        theta = 0.5 * (low + high)
        try:
            robust(k, theta, form)
            low = theta
        except ThetaTooLarge:
            high = theta
    return low


def robust_squares(k: int, theta: float, scene: Scene, form: str = "mixed") -> np.ndarray:
    """Mean squared errors of every run, infinite where there is no such filter."""
    try:
        tracker = robust(k, theta, form)
    except ThetaTooLarge:
        return np.full(len(scene.truth), np.inf)
    return squares(tracker.track(scene.zs), scene.truth)


def best_theta(k: int, scene: Scene, form: str = "mixed") -> float:
    """The theta of least error, looking at the truth as the paper does."""
    limit = theta_limit(k, form)

    def error(fraction: float) -> float:
        return min(rmse(robust_squares(k, fraction * limit, scene, form)).value, 1e6)

    found = minimize_scalar(error, bounds=(0.0, 1.0), method="bounded", options={"xatol": 0.03})
    return 0.0 if error(0.0) <= found.fun else float(found.x) * limit
