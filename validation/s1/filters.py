"""The two networks of S1, and its filters for them."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ufirext import (
    Channel,
    CompensatedBernoulli,
    DelayKalmanFilter,
    Model,
    StampedLoss,
    TimeStamped,
    UFIRFilter,
)
from ufirext.demo.simulate import city_drive
from validation.linear import Recursion, recursion
from validation.study import Study
from validation.vehicle import HORIZON, SIGMA_V, misjudged, vehicle

__all__ = [
    "COUNT",
    "NETWORKS",
    "PRINTED",
    "SUITED",
    "Group",
    "groups",
    "kalman",
    "mean_row",
    "tracked",
    "truths",
    "ufir",
    "windowed",
]

Array = NDArray[np.float64]

PRINTED, SUITED = vehicle(0.2, 0.25), vehicle(2.0, 0.25)
"""Q as printed, sigma_w = 0.2 m/s; and with the 2 m/s of S0, which suits a car that turns corners."""

UNSTAMPED = CompensatedBernoulli(0.7, 0.9)
NETWORKS: dict[int, Channel] = {3: StampedLoss(0.7, 0.9), 5: UNSTAMPED}
"""By the number of the equation."""

COUNT = 1000
"""Steps: the paper's pictures go beyond 920."""
SPEED = 11.0


class Group(NamedTuple):
    """Runs that share the pattern of arrivals, and so the gains, but neither track nor noise.

    Attributes
    ----------
    truth, zs : ndarray, (runs, steps, 2)
        m; zs NaN where nothing arrives.
    delays : list of int or None
        What the stamps say (0 without stamps).
    late : ndarray of bool, (steps,)
        Whether what arrives is a step late.

    Duplicates do not count as arrivals.
    """

    truth: Array
    zs: Array
    delays: list[int | None]
    late: NDArray[np.bool_]


def tracked(found: list[Group], network: int, model: Model, beta: float = 1.0) -> Array:
    """The KF's states of all runs."""
    return np.concatenate([kalman(group, network, model, beta).track(group.zs) for group in found])


def windowed(study: Study, found: list[Group], network: int, missing: str = "extend") -> Array:
    """UFIR's states of all runs."""
    each = [(run, group) for group in found for run in group.zs]
    return np.array(study.sweep(_windowed, each, network, missing))


def _windowed(pair: tuple[Array, Group], network: int, missing: str) -> Array:
    return ufir(*pair, network, missing)


def truths(found: list[Group]) -> Array:
    """The true positions of all runs."""
    return np.concatenate([group.truth for group in found])


def _drive(rng: np.random.Generator) -> Array:
    return city_drive(rng, duration=float(COUNT - 1), speed=SPEED).position


def _obeying(rng: np.random.Generator) -> Array:
    """A vehicle that obeys the printed Q exactly."""
    root = np.linalg.svd(PRINTED.Q)
    noise = rng.standard_normal((COUNT, 4)) * np.sqrt(root.S) @ root.U.T
    heading = rng.uniform(0.0, 2.0 * np.pi)
    x = np.array([0.0, SPEED * np.cos(heading), 0.0, SPEED * np.sin(heading)])
    states = np.empty((COUNT, 4))
    for step, w in enumerate(noise):
        x = PRINTED.F @ x + w
        states[step] = x
    return states[:, ::2]


def draw(rng: np.random.Generator, network: int, size: int, obeying: bool = False) -> Group:
    """One pattern of arrivals for `size` tracks."""
    truth = np.stack([(_obeying if obeying else _drive)(rng) for _ in range(size)])
    beside = truth.swapaxes(0, 1).reshape(COUNT, 2 * size)
    arrivals = NETWORKS[network].sample(rng, beside, SIGMA_V**2 * np.eye(2 * size))
    zs = np.full_like(beside, np.nan)
    delays: list[int | None] = [None] * COUNT
    late = np.zeros(COUNT, dtype=bool)
    received = set()
    for step, packets in enumerate(arrivals):
        for packet in packets:
            # A second copy has the same noise: it says nothing new.
            if packet.origin not in received:
                zs[step], delays[step], late[step] = packet.z, packet.delay, packet.origin < step
                received.add(packet.origin)
    return Group(truth, zs.reshape(COUNT, size, 2).swapaxes(0, 1), delays, late)


def groups(study: Study, network: int, obeying: bool = False) -> list[Group]:
    """The item's runs: the same tracks and noise for every filter."""
    count, size = study.choose((2, 3), (10, 10))
    return study.runs(draw, count, network, size, obeying)


def mean_row(model: Model, gamma: float) -> Model:
    """A measurement on time with probability gamma, else a step late: mean H, and R as corrected.

    The printed R of (8) and (12) subtracts H Q H' and is indefinite; it must add H F^-1 Q F^-T H'.
    """
    late = TimeStamped(1).effective(model, 1).H
    H = np.asarray(gamma * model.H + (1.0 - gamma) * late)
    R = np.asarray(model.R + (1.0 - gamma) ** 2 * late @ model.Q @ late.T)
    return replace(model, H=H, R=R)


def kalman(group: Group, network: int, model: Model, beta: float = 1.0) -> Recursion:
    """The paper's KF, corrected: with the stamps, or with the mean H where there are none.

    A lost datum has no innovation. With stamps phi is taken into account, as in (13) to (16).
    """
    believed = misjudged(model, beta)
    if network == 3:
        f = DelayKalmanFilter(4, 2, channel=NETWORKS[3], method="correlated")
        rows = [TimeStamped(1).effective(believed, k or 0).H for k in group.delays]
        return recursion(f, believed, group.delays, np.stack(rows))
    return recursion(DelayKalmanFilter(4, 2), mean_row(believed, UNSTAMPED.gamma), group.delays)


def ufir(zs: Array, group: Group, network: int, missing: str = "extend", model: Model = PRINTED) -> Array:
    """UFIR estimates (steps, 4) of one run: late rows where they belong, or the mean H without stamps."""
    believed = model if network == 3 else mean_row(model, UNSTAMPED.gamma)
    f = UFIRFilter(4, 2, horizon=HORIZON, missing=missing)
    f.F, f.H, f.Q, f.R = model.F, believed.H, model.Q, model.R
    states = np.full((COUNT, 4), np.nan)
    for step, (z, delay) in enumerate(zip(zs, group.delays, strict=True)):
        f.predict()
        f.update(None if delay is None else z, delay=delay or 0)
        if f.ready:
            states[step] = f.x.ravel()
    return states
