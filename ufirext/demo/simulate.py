"""A drive through a city, what a receiver measures of it, and what a radio link makes of the packets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .._arrays import Array
from ..errors import UfirextError

__all__ = ["Arrivals", "Drive", "Link", "city_drive", "transmit"]

GRID = 0.25
"""Distance between two points of a route, m."""

BRAKING, ACCELERATION, CORNER_SPEED, CORNER_RADIUS, CRAWL = 2.0, 1.5, 4.0, 8.0, 0.2
"""m/s^2, m/s^2, m/s, m, m/s: a calm driver."""

Arrivals = list[list[tuple[int, int]]]
"""For each step the packets that arrive then: (step of origin, delay in steps), oldest first."""


@dataclass(frozen=True)
class Drive:
    """True positions over time.

    Attributes
    ----------
    seconds : ndarray, (n,)
        Increasing, s.
    position : ndarray, (n, 2)
        East and north, m.
    """

    seconds: Array
    position: Array

    def __len__(self) -> int:
        return len(self.seconds)


class Link(NamedTuple):
    """What happens to packets on their way.

    Attributes
    ----------
    loss : float
        Probability that a packet never arrives.
    late : float
        Probability that one that arrives is late.
    longest : int
        Late packets are 1 .. longest steps late, each as likely.
    """

    loss: float = 0.0
    late: float = 0.0
    longest: int = 0


def city_drive(
    rng: np.random.Generator,
    *,
    duration: float = 857.0,
    dt: float = 1.0,
    speed: float = 10.0,
    stops: float = 0.3,
) -> Drive:
    """Drive along a grid of streets: blocks, right-angled turns, traffic lights.

    The car brakes before corners and red lights, takes corners at walking pace, and cruises at 0.8 to 1.2
    times `speed` from block to block. The defaults give 858 points at 1 Hz.

    Parameters
    ----------
    rng : numpy.random.Generator
    duration : float
        s.
    dt : float
        Time between two points, s.
    speed : float
        Mean cruising speed, m/s.
    stops : float
        Probability of a red light of 5 to 25 s at the end of a block.

    Returns
    -------
    Drive

    Raises
    ------
    UfirextError
        For a duration, dt or speed that is not positive, or a probability outside 0 .. 1.

    Examples
    --------
    >>> import numpy as np
    >>> from ufirext.demo.simulate import city_drive
    >>> len(city_drive(np.random.default_rng(0)))
    858
    """
    for name, value in (("duration", duration), ("dt", dt), ("speed", speed)):
        if not value > 0:
            raise UfirextError(f"{name} must be positive, got {value!r}")
    _require_probability("stops", stops)
    curvature, limit, wait = _route(rng, 1.2 * speed * duration, speed, stops)
    heading = np.cumsum(curvature) * GRID + rng.uniform(0, 2 * np.pi)
    path = GRID * np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
    clock = np.cumsum(GRID / _speeds(limit) + wait)
    seconds = np.asarray(dt * np.arange(int(duration / dt) + 1), dtype=float)
    start = clock[0]
    position = np.array([np.interp(seconds, clock - start, axis) for axis in path.T]).T
    return Drive(seconds, position)


def _route(rng: np.random.Generator, length: float, speed: float, stops: float) -> tuple[Array, Array, Array]:
    """Curvature 1/m, speed limit m/s and waiting time s along a route, one value every GRID metres."""
    corner = int(0.5 * np.pi * CORNER_RADIUS / GRID)
    curvature, limit, wait = [], [], []
    total = 0
    while total * GRID < length:
        block = int(rng.uniform(80, 300) / GRID)
        turn = rng.choice([-1.0, 0.0, 1.0], p=[0.35, 0.3, 0.35])
        red = rng.random() < stops
        pause = np.zeros(block + corner)
        pause[block - 1] = rng.uniform(5, 25) if red else 0.0
        pace = np.full(block + corner, speed * rng.uniform(0.8, 1.2))
        pace[block - 1] = CRAWL if red else pace[0]
        pace[block:] = min(CORNER_SPEED, speed) if turn else pace[0]
        bend = np.zeros(block + corner)
        bend[block:] = turn * 0.5 * np.pi / (corner * GRID)
        curvature.append(bend)
        limit.append(pace)
        wait.append(pause)
        total += block + corner
    return np.concatenate(curvature), np.concatenate(limit), np.concatenate(wait)


def _speeds(limit: Array) -> Array:
    """The fastest speeds below a limit: v^2 changes by 2 a ds at most, braking or accelerating."""
    along = 2.0 * GRID * np.arange(len(limit))
    squared = limit**2
    braked = np.minimum.accumulate((squared + BRAKING * along)[::-1])[::-1] - BRAKING * along
    reached = np.minimum.accumulate(braked - ACCELERATION * along) + ACCELERATION * along
    speeds: Array = np.sqrt(reached)
    return speeds


def transmit(rng: np.random.Generator, count: int, link: Link) -> Arrivals:
    """Which of `count` packets, one sent at each step, arrive when.

    Raises
    ------
    UfirextError
        For probabilities outside 0 .. 1, or late packets without a longest delay.

    Examples
    --------
    >>> import numpy as np
    >>> from ufirext.demo.simulate import Link, transmit
    >>> transmit(np.random.default_rng(0), 3, Link())
    [[(0, 0)], [(1, 0)], [(2, 0)]]
    """
    _require_probability("loss", link.loss)
    _require_probability("late", link.late)
    if link.late > 0 and link.longest < 1:
        raise UfirextError(f"longest must be at least 1 step where packets are late, got {link.longest}")
    arrives = rng.random(count) >= link.loss
    late = rng.random(count) < link.late
    delays = np.where(late, rng.integers(1, max(link.longest, 1) + 1, count), 0)
    arrivals: Arrivals = [[] for _ in range(count)]
    for origin in np.flatnonzero(arrives).tolist():
        delay = int(delays[origin])
        if origin + delay < count:
            arrivals[origin + delay].append((origin, delay))
    return arrivals


def _require_probability(name: str, value: float) -> None:
    if not 0 <= value <= 1:
        raise UfirextError(f"{name} must be a probability, 0 .. 1, got {value!r}")
