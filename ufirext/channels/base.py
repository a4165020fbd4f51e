"""What every channel answers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .._arrays import Array, column, covariance, integer, readings, real
from ..errors import HorizonError, ShapeError, UfirextError
from ..model import Model
from .effective import Effective, Step

__all__ = ["Channel", "Packet", "probability"]


class Packet(NamedTuple):
    """A measurement that arrives: value, delay as its stamp tells it (0 without stamps), true origin."""

    z: Array
    delay: int
    origin: int


def probability(value: float, name: str) -> float:
    """`value` as a float in [0, 1]."""
    number = float(real(value, name).reshape(()) if np.ndim(value) == 0 else np.nan)
    if not 0.0 <= number <= 1.0:
        raise UfirextError(f"{name} must be a probability between 0 and 1, got {value!r}")
    return number


def _series(zs: ArrayLike) -> Array:
    array = readings(zs, "zs")
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[:, :, 0]
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2:
        raise ShapeError(f"zs must have shape (steps, dim_z), got {array.shape}")
    return array


class Channel(ABC):
    """Base of all channels: what a network does to measurements, as a value.

    Attributes
    ----------
    stamped : bool
        Whether a measurement tells its origin.
    fresh_noise : bool
        Whether a second measurement of the same origin has noise of its own and is kept; else it is a
        duplicate and is dropped.

    Examples
    --------
    >>> from ufirext import BernoulliDelay, Channel, TimeStamped
    >>> [(isinstance(channel, Channel), channel.stamped) for channel in (TimeStamped(3), BernoulliDelay(0.9))]
    [(True, True), (True, False)]
    """

    stamped: ClassVar[bool]
    fresh_noise: ClassVar[bool]

    @property
    @abstractmethod
    def max_delay(self) -> int:
        """The oldest measurement that can arrive, in steps."""

    def effective(
        self,
        model: Model,
        delay: int = 0,
        *,
        past: Sequence[Step] | None = None,
        x: ArrayLike | None = None,
        P: ArrayLike | None = None,
    ) -> Effective:
        """The measurement that arrives now as a measurement of the present state.

        Parameters
        ----------
        model : Model
            Its H and R belong to the measurement; its F and Q to the past, unless `past` is given.
        delay : int, optional
            What the stamp says, in steps. Channels without stamps take 0 only.
        past : sequence of Step, optional
            The transitions of a time-varying model, newest last, at least as many as the measurement is old.
        x, P : array_like, optional
            Prior state and covariance of the filter, which an unknown delay requires: the error made by
            averaging over it grows with E[x x'].

        Returns
        -------
        Effective

        Raises
        ------
        HorizonError
            For a delay that is no integer or outside 0..max_delay.
        UfirextError
            If F cannot be inverted where the formula needs it, or x and P are missing.
        """
        delay = self.check_delay(delay)
        steps = [Step(model.F, model.Q)] * max(self.max_delay, 1) if past is None else list(past)
        if len(steps) < delay:
            raise HorizonError(f"past must hold at least delay = {delay} steps, got {len(steps)}")
        prior = None if x is None else column(x, model.dim_x, "x")
        return self.row(model.H, model.R, steps, delay, prior, None if P is None else real(P, "P"))

    def check_delay(self, delay: int) -> int:
        """`delay` as an int that this channel can produce."""
        if not self.stamped:
            return integer(
                delay, "delay", 0, 0, "this channel has no time stamps: the delay is part of its law"
            )
        return integer(delay, "delay", 0, self.max_delay, "raise max_delay if older measurements can arrive")

    @abstractmethod
    def row(
        self, H: Array, R: Array, past: Sequence[Step], delay: int, x: Array | None, P: Array | None
    ) -> Effective:
        """`effective` on validated arrays."""

    @abstractmethod
    def lifted(self, H: Array, R: Array, delay: int, x: Array, P: Array) -> tuple[Array, Array]:
        """H and R of the measurement on the augmented state [x_n; x_{n-1}; ..] with prior x, P: no F^-1."""

    def sample(
        self, rng: np.random.Generator, zs: ArrayLike, R: ArrayLike | None = None
    ) -> list[list[Packet]]:
        """Send a series through the channel.

        Parameters
        ----------
        rng : numpy.random.Generator
        zs : array_like, (steps, dim_z)
            Measurements as the sensor made them, one a step.
        R : array_like, (dim_z, dim_z), optional
            For noise-free zs: covariance of the noise to add, drawn once for every measurement, or, in a
            channel with fresh noise, once for every arrival.

        Returns
        -------
        list of list of Packet
            What arrives at each step; an empty list where nothing does.

        Examples
        --------
        >>> import numpy as np
        >>> from ufirext import TimeStamped
        >>> packets = TimeStamped(2, law=(0, 0, 1)).sample(np.random.default_rng(0), [[10.0], [11.0], [12.0]])
        >>> [[(float(p.z[0]), p.delay) for p in step] for step in packets]
        [[], [], [(10.0, 2)]]
        """
        series = _series(zs)
        arrivals = self._arrivals(rng, len(series))
        noise = np.zeros((0, series.shape[1]))
        if R is not None:
            count = sum(map(len, arrivals)) if self.fresh_noise else len(series)
            cov = covariance(R, series.shape[1], "R", "(dim_z, dim_z)")
            noise = rng.multivariate_normal(np.zeros(len(cov)), cov, size=count, method="cholesky")
        if len(noise) and not self.fresh_noise:
            series = series + noise
        packets, drawn = [], 0
        for step, origins in enumerate(arrivals):
            packets.append([Packet(series[o].copy(), step - o if self.stamped else 0, o) for o in origins])
            if len(noise) and self.fresh_noise:
                for packet in packets[-1]:
                    packet.z[:] += noise[drawn]
                    drawn += 1
        return packets

    @abstractmethod
    def _arrivals(self, rng: np.random.Generator, steps: int) -> list[list[int]]:
        """The origins of what arrives at each step."""
