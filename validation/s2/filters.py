"""The filters of S2 for data that are one step late with an unknown realisation, known by probability."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ufirext import BernoulliDelay, DelayHInfinityFilter, DelayKalmanFilter, Model, ThetaTooLarge
from validation.drives import NOISE, STEPS, Scene, scenes
from validation.linear import Finite, Linear, Recursion, expected_squares, recursion
from validation.scores import squares
from validation.study import Study
from validation.vehicle import HORIZON, misjudged, vehicle

__all__ = [
    "GAMMAS",
    "TRUE",
    "averaged",
    "drawn",
    "exact_kalman",
    "expectation",
    "kalman",
    "limits",
    "robust",
    "robust_squares",
    "ufir",
]

Array = NDArray[np.float64]

MODEL = vehicle()
TRUE = 0.8
GAMMAS = (0.2, 0.5, 0.8)
# A measurement of step 0 that is late is one of step -1, which there is not.
PATTERN = (None, *[0] * (STEPS - 1))


def drawn(study: Study, runs: int, gamma: float = TRUE) -> Scene:
    """Drives, each of whose data is late with probability 1 - gamma."""
    return scenes(study, BernoulliDelay(gamma), runs)


def averaged(gamma: float, beta: float = 1.0) -> Model:
    """What the paper's filters believe: equations (6) and (8), with beta^2 R and Q / beta^2."""
    believed = misjudged(MODEL, beta)
    late = np.linalg.solve(believed.F.T, believed.H.T).T
    H = np.asarray(gamma * believed.H + (1.0 - gamma) * late)
    R = np.asarray(believed.R + (1.0 - gamma) ** 2 * late @ believed.Q @ late.T)
    return replace(believed, H=H, R=R)


def ufir(gamma: float, beta: float = 1.0) -> Finite:
    """The UFIR filter with the mean H of (6): neither Q nor R matter to it."""
    return Finite.ufir(averaged(gamma, beta), HORIZON)


def kalman(gamma: float, beta: float = 1.0) -> Recursion:
    """The paper's KF: the effective noise (8) taken for white."""
    return recursion(DelayKalmanFilter(4, 2), averaged(gamma, beta), PATTERN)


def robust(gamma: float, theta: float, beta: float = 1.0, form: str = "mixed") -> Recursion:
    """The H-infinity filter; form="mixed" is the papers'.

    Raises
    ------
    ThetaTooLarge
    """
    f = DelayHInfinityFilter(4, 2, theta=theta, form=form)
    found = recursion(f, averaged(gamma, beta), PATTERN[1:])
    return replace(found, K=np.concatenate([np.zeros((1, *found.K.shape[1:])), found.K]))


def robust_squares(scene: Scene, gamma: float, theta: float, beta: float = 1.0, form: str = "mixed") -> Array:
    """Mean squared errors of every run; infinite where there is no such filter."""
    try:
        return squares(robust(gamma, theta, beta, form).track(scene.zs), scene.truth)
    except ThetaTooLarge:
        return np.full(len(scene.truth), np.inf)


def limits(gamma: float, beta: float = 1.0, digits: float = 1e-2) -> tuple[float, float]:
    """The thetas beyond which the a-priori and the a-posteriori filter do not exist, by bisection."""
    found = []
    for form in ("prior", "posterior"):
        low, high = 0.0, 0.5
        while high - low > digits * high:
            theta = 0.5 * (low + high)
            try:
                robust(gamma, theta, beta, form)
                low = theta
            except ThetaTooLarge:
                high = theta
        found.append(low)
    return found[0], found[1]


def exact_kalman(zs: Array, gamma: float, beta: float = 1.0) -> Array:
    """Estimates (steps, 4) of one run by the KF that knows the channel, with the E[x x'] that (8) lacks."""
    believed = misjudged(MODEL, beta)
    f = DelayKalmanFilter(4, 2, channel=BernoulliDelay(gamma))
    f.F, f.H, f.Q, f.R = believed.F, believed.H, believed.Q, believed.R
    first = zs[np.isfinite(zs).all(axis=1)][0]
    f.x = np.array([first[0], 0.0, first[1], 0.0])
    states = np.empty((len(zs), 4))
    for step, z in enumerate(zs):
        f.predict()
        f.update(z if np.isfinite(z).all() else None)
        states[step] = f.x.ravel()
    return states


def expectation(tracker: Linear, truth: Array, gamma: float = TRUE) -> Array:
    """Mean squared errors of every run averaged over delays and noise, by algebra."""
    before = np.concatenate([truth[:, :1], truth[:, :-1]], axis=1)
    moved = truth - before
    V = NOISE + gamma * (1.0 - gamma) * moved[..., None] * moved[..., None, :]
    return expected_squares(tracker, gamma * truth + (1.0 - gamma) * before, V, truth)
