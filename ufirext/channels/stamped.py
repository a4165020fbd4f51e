"""Channels whose measurements carry time stamps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from .._arrays import Array, integer
from ..errors import UfirextError
from .base import Channel, probability
from .effective import Effective, Step, at_block, stamped

__all__ = ["StampedLoss", "TimeStamped"]


class _Stamped(Channel):
    """A measurement that tells its origin."""

    stamped: ClassVar[bool] = True

    def row(
        self, H: Array, R: Array, past: Sequence[Step], delay: int, x: Array | None, P: Array | None
    ) -> Effective:
        """The measurement of x_{n-delay}, F inverted `delay` times."""
        return stamped(H, R, past, delay)

    def lifted(self, H: Array, R: Array, delay: int, x: Array, P: Array) -> tuple[Array, Array]:
        """H at the block of x_{n-delay}."""
        return at_block(H, delay, len(x)), R


@dataclass(frozen=True)
class TimeStamped(_Stamped):
    """Every measurement carries the time it was made and arrives up to `max_delay` steps late, in any order.

    Equation :eq:`late-row`, (2) to (8) of Uribe-Murcia et al. (2018). A second measurement of the same origin
    has noise of its own (their v_n is a sample at arrival) and is kept.

    Parameters
    ----------
    max_delay : int
        The oldest measurement that is taken in, in steps.
    law : sequence of float, optional
        Probabilities of the delays 0..max_delay, for `sample`. Default: all alike.
    loss : float, optional
        Probability that a measurement never arrives, for `sample`.

    Raises
    ------
    HorizonError
        If max_delay is no integer or negative.
    UfirextError
        If law or loss are no probabilities, or law does not sum to 1.

    Examples
    --------
    >>> from ufirext import TimeStamped, kinematic
    >>> TimeStamped(3).effective(kinematic(1, 1, 1.0), delay=2).H
    array([[ 1., -2.]])
    """

    max_delay: int = 0
    law: tuple[float, ...] | None = None
    loss: float = 0.0
    fresh_noise: ClassVar[bool] = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "max_delay", integer(self.max_delay, "max_delay", 0))
        object.__setattr__(self, "loss", probability(self.loss, "loss"))
        if self.law is None:
            return
        law = tuple(probability(value, f"law[{i}]") for i, value in enumerate(self.law))
        if len(law) != self.max_delay + 1 or abs(sum(law) - 1.0) > 1e-9:
            raise UfirextError(
                f"law must hold max_delay + 1 = {self.max_delay + 1} probabilities that sum to 1, "
                f"got {len(law)} with sum {sum(law):.6g}"
            )
        object.__setattr__(self, "law", law)

    def _arrivals(self, rng: np.random.Generator, steps: int) -> list[list[int]]:
        delays = rng.choice(self.max_delay + 1, size=steps, p=self.law)
        lost = rng.random(steps) < self.loss
        arrivals: list[list[int]] = [[] for _ in range(steps)]
        for origin in range(steps):
            arrival = origin + int(delays[origin])
            if arrival < steps and not lost[origin]:
                arrivals[arrival].append(origin)
        return arrivals


@dataclass(frozen=True)
class StampedLoss(_Stamped):
    """At each step the newest measurement, or the one before it, or nothing, and the stamp says which.

    Equation (3) of Uribe-Murcia et al. (2022). A measurement that was received already comes with the same
    noise: it is a duplicate and is dropped. Several sensors of one step are one measurement: give them in one
    call, with stacked H and R.

    Parameters
    ----------
    on_time : float, optional
        Probability that what arrives is the newest measurement (their alpha), for `sample`.
    received : float, optional
        Probability that anything arrives (their beta), for `sample`.

    Raises
    ------
    UfirextError
        If a probability is outside [0, 1].

    Examples
    --------
    >>> from ufirext import StampedLoss
    >>> StampedLoss(on_time=0.7, received=0.9).max_delay
    1
    """

    on_time: float = 1.0
    received: float = 1.0
    fresh_noise: ClassVar[bool] = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "on_time", probability(self.on_time, "on_time"))
        object.__setattr__(self, "received", probability(self.received, "received"))

    @property
    def max_delay(self) -> int:
        """One step."""
        return 1

    def _arrivals(self, rng: np.random.Generator, steps: int) -> list[list[int]]:
        late = rng.random(steps) >= self.on_time
        kept = rng.random(steps) < self.received
        origins = np.arange(steps) - late
        return [[int(o)] if keep and o >= 0 else [] for o, keep in zip(origins, kept, strict=True)]
