"""Drives to be tracked, and what a network makes of their measurements.

The papers' recordings are not public any more; in their place stands the simulated city drive of
`ufirext demo`: 858 points, one a second, blocks and right-angled turns at some 10 m/s, red lights.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ufirext import Channel, TimeStamped
from ufirext.demo.simulate import city_drive
from validation.study import Study
from validation.vehicle import SIGMA_V

__all__ = ["STEPS", "Scene", "constant_delay", "draw", "scenes", "stacked"]

Array = NDArray[np.float64]

STEPS = 858
"""Points of the papers' track, and of the drive."""

NOISE = SIGMA_V**2 * np.eye(2)


class Scene(NamedTuple):
    """Runs side by side: the truth, and what arrived of it.

    Attributes
    ----------
    truth : ndarray, (runs, steps, 2)
        East and north, m.
    zs : ndarray, (runs, steps, 2)
        What arrives at each step, m; NaN where nothing does.
    origins : ndarray, (runs, steps)
        The step it was measured at, -1 where nothing arrives.
    """

    truth: Array
    zs: Array
    origins: NDArray[np.int64]

    @property
    def delays(self) -> list[list[int | None]]:
        """How late what arrives is, for each run and step; None where nothing does."""
        steps = np.arange(self.origins.shape[1])
        late = np.where(self.origins < 0, -1, steps - self.origins)
        return [[None if k < 0 else k for k in run] for run in late.tolist()]


def constant_delay(k: int) -> TimeStamped:
    """Everything comes k steps late."""
    return TimeStamped(k, law=(0.0,) * k + (1.0,))


def draw(rng: np.random.Generator, channel: Channel) -> Scene:
    """One drive, measured and sent through a channel that brings at most one measurement a step."""
    truth = city_drive(rng).position
    zs = np.full_like(truth, np.nan)
    origins = np.full(len(truth), -1)
    for step, packets in enumerate(channel.sample(rng, truth, NOISE)):
        for packet in packets:
            zs[step], origins[step] = packet.z, packet.origin
    return Scene(truth[None], zs[None], origins[None])


def stacked(drawn: list[Scene]) -> Scene:
    """Runs side by side."""
    return Scene(
        np.concatenate([scene.truth for scene in drawn]),
        np.concatenate([scene.zs for scene in drawn]),
        np.concatenate([scene.origins for scene in drawn]),
    )


def scenes(study: Study, channel: Channel, runs: int) -> Scene:
    """The item's runs: the same drives and noise for every channel of the same kind."""
    return stacked(study.runs(draw, runs, channel))
