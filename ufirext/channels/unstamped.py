"""Channels whose measurements do not tell when they were made."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from .._arrays import Array
from ..errors import UfirextError
from .base import Channel, probability
from .effective import Effective, Step, averaged, averaged_lifted

__all__ = ["BernoulliDelay", "CompensatedBernoulli"]


class _Unstamped(Channel):
    """A measurement that is one step late with a known probability."""

    stamped: ClassVar[bool] = False

    @property
    def max_delay(self) -> int:
        """One step, or none where nothing is ever late."""
        return int(self._on_time < 1.0)

    @property
    @abstractmethod
    def _on_time(self) -> float:
        """Probability that what arrived is the newest measurement."""

    def row(
        self, H: Array, R: Array, past: Sequence[Step], delay: int, x: Array | None, P: Array | None
    ) -> Effective:
        """The average over the delay."""
        return averaged(H, R, past, self._on_time, x, P)

    def lifted(self, H: Array, R: Array, delay: int, x: Array, P: Array) -> tuple[Array, Array]:
        """The average over the delay, between two blocks."""
        return averaged_lifted(H, R, self._on_time, x, P)


@dataclass(frozen=True)
class BernoulliDelay(_Unstamped):
    """Each step brings the newest measurement with probability `gamma`, else the one before, without a stamp.

    Equation :eq:`unknown-delay`: Uribe-Murcia et al. (2019), (3) to (8), with the term in E[x x'] that (8)
    lacks. The error made by averaging over the delay grows with the distance moved in one step.

    Parameters
    ----------
    gamma : float
        Probability of no delay.

    Raises
    ------
    UfirextError
        If gamma is outside [0, 1].

    Examples
    --------
    >>> import numpy as np
    >>> from ufirext import BernoulliDelay, kinematic
    >>> BernoulliDelay(0.8).effective(kinematic(1, 1, 1.0), x=[0.0, 10.0], P=np.eye(2)).H.round(2)
    array([[ 1. , -0.2]])
    """

    gamma: float
    fresh_noise: ClassVar[bool] = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "gamma", probability(self.gamma, "gamma"))

    @property
    def _on_time(self) -> float:
        return self.gamma

    def _arrivals(self, rng: np.random.Generator, steps: int) -> list[list[int]]:
        origins = np.arange(steps) - (rng.random(steps) >= self.gamma)
        return [[int(o)] if o >= 0 else [] for o in origins]


@dataclass(frozen=True)
class CompensatedBernoulli(_Unstamped):
    """No stamps, known probabilities: on time, or one step late if it was not on time before, or lost.

    Equation (5) of Uribe-Murcia et al. (2022): on time with probability a0, one step late with probability
    (1 - a0)^2 a1, else lost. Their compensation of a loss by the filter's own prediction carries no
    information, so a loss is a missing measurement here, and what arrives was on time with probability
    a0 / (a0 + (1 - a0)^2 a1).

    Parameters
    ----------
    a0, a1 : float
        Probabilities that a measurement is on time, and that one which was not arrives a step later.

    Raises
    ------
    UfirextError
        If a probability is outside [0, 1], or both are 0 and nothing could ever arrive.

    Examples
    --------
    >>> from ufirext import CompensatedBernoulli
    >>> round(CompensatedBernoulli(0.7, 0.9).gamma, 4)
    0.8963
    """

    a0: float
    a1: float
    fresh_noise: ClassVar[bool] = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "a0", probability(self.a0, "a0"))
        object.__setattr__(self, "a1", probability(self.a1, "a1"))
        if self.a0 == 0.0 and self.a1 == 0.0:
            raise UfirextError("a0 and a1 must not both be 0: nothing could ever arrive")

    @property
    def gamma(self) -> float:
        """Probability that a measurement which arrived was on time."""
        return self.a0 / (self.a0 + (1.0 - self.a0) ** 2 * self.a1)

    @property
    def _on_time(self) -> float:
        return self.gamma

    def _arrivals(self, rng: np.random.Generator, steps: int) -> list[list[int]]:
        prompt = rng.random(steps + 1) < self.a0
        late = rng.random(steps) < self.a1
        arrivals: list[list[int]] = []
        for step in range(steps):
            if prompt[step + 1]:
                arrivals.append([step])
            else:
                arrivals.append([step - 1] if step and not prompt[step] and late[step] else [])
        return arrivals
