"""State objects of the filters that take late measurements: Kalman, by two exact ways and two baselines."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._arrays import Array
from ..channels import Channel
from ..engines.covariance import Covariance
from ..engines.records import measured
from ..errors import HorizonError
from ._steady import SteadyState
from ._update import Update


@dataclass(frozen=True)
class LateUpdate(Update):
    """An update with the measurement expressed by the present (or augmented) state: z + offset = H x + v."""

    offset: Array | None = None

    @cached_property
    def y(self) -> Array:
        """Innovation, 0 where nothing was measured."""
        if self.z is None:
            return np.zeros(len(self.H))
        z = self.z if self.offset is None else self.z + self.offset
        return np.where(self.mask, np.where(self.mask, z, 0.0) - self.H @ self.x, 0.0)

    @cached_property
    def K(self) -> Array:
        """Gain on the present state, zero columns where nothing was measured."""
        gain = self.gain.value
        K = np.zeros((len(gain), len(self.H)))
        K[:, self.mask] = gain
        return K


Mask = NDArray[np.bool_]
# What an update leaves behind: an Update, or its arguments, from which it is made when somebody asks.
Left = Update | tuple[Any, ...]


class LateState(SteadyState):
    """What all filters with a channel share: which measurements are taken, and edits of x between them."""

    def __init__(self, dim_x: int, dim_z: int, channel: Channel) -> None:
        super().__init__(dim_x, dim_z)
        self.channel = channel
        self.dropped = 0
        self.seen: tuple[int, ...] = ()  # origins received, as far back as one can come again
        self.edited: Array | None = None  # moves of x since the last row of this step
        self.own_P = self.P

    # -- verbs ----------------------------------------------------------------------

    def predict(self, F: Array, Q: Array, known: Array | None) -> None:
        """Time update by F, Q and a known change of the state."""
        x, P = self._ahead(F, Q, known)
        self.edited = None
        self._present(x, P)
        self.now += 1
        self.updated = False
        self.prior = (self.x, self.P)
        if self.seen:
            self.seen = tuple(origin for origin in self.seen if origin >= self.now - self.channel.max_delay)
        self._predicted(F, Q)

    def update(
        self, z: Array | None, H: Array, R: Array, delay: int, cross: Array | None = None, whole: bool = False
    ) -> None:
        """Measurement update; z flat with NaN for missing components, or None; `whole`: none is missing."""
        delay = self._age(delay)
        last: Left | None = None
        if z is not None:
            mask = None if whole else measured(z, H, R)[3]
            if (mask is None or mask.any()) and self._wanted(delay):
                last, x, P = self._taken(z, H, R, mask, delay, cross)
                self._present(x, P)
                if self.channel.stamped and not self.channel.fresh_noise:
                    self.seen = (*self.seen, self.now - delay)
        if last is None:
            self._nothing()
            gain = Covariance.of(np.zeros((self.dim_x, 0)))
            last = (z, H, R, np.zeros(len(H), dtype=bool), self.x, self.P, gain, None)
        self._last = last
        plain = whole and delay == 0 and cross is None and not self.updated
        self.updated = True
        self.post = (self.x, self.P)
        if plain and self.regular:
            gain = last[6] if isinstance(last, tuple) else last.gain
            self._enter(H, R, gain)
        else:
            self.levels = None
        self.regular = False

    def _repeats(self) -> bool:
        return self.channel.stamped and self.channel.fresh_noise

    def _age(self, delay: int) -> int:
        if delay == 0:
            return 0
        if self.channel.stamped and self.channel.max_delay == 0:
            raise HorizonError(
                f"delay must be 0 in a filter without delays, got {delay}; give the filter a max_delay"
            )
        return self.channel.check_delay(delay)

    def _wanted(self, delay: int) -> bool:
        """False for a duplicate, and for a measurement from before the start."""
        origin = self.now - delay
        if origin < 0 or (not self.channel.fresh_noise and self.channel.stamped and origin in self.seen):
            self.dropped += 1
            return False
        return True

    def _present(self, x: Array, P: Array) -> None:
        self.own_P = Covariance.of(P)
        self._publish(x, self.own_P)

    def _moved(self, delta: Array) -> None:
        if self.updated:
            self.edited = delta if self.edited is None else self.edited + delta

    # -- what a way of filtering does ----------------------------------------------------------------------

    def _ahead(self, F: Array, Q: Array, known: Array | None) -> tuple[Array, Array]:
        """Predict; x and P of the present state."""
        raise NotImplementedError

    def _taken(
        self, z: Array, H: Array, R: Array, mask: Mask | None, delay: int, cross: Array | None
    ) -> tuple[Left, Array, Array]:
        """Take the measured components (`mask`, None: all): what is left behind, x and P of now."""
        raise NotImplementedError

    def _nothing(self) -> None:
        """An update() brought nothing."""


def measured_part(
    mask: Mask | None, z: Array, H: Array, R: Array, cross: Array | None
) -> tuple[Array, Array, Array, Array | None]:
    """The measured components of a measurement."""
    if mask is None:
        return z, H, R, cross
    return z[mask], H[mask], R[np.ix_(mask, mask)], None if cross is None else cross[:, mask]


def left_behind(
    z: Array,
    H: Array,
    R: Array,
    mask: Mask | None,
    x: Array,
    P: Covariance,
    K: Array,
    cross: Array | None,
    offset: Array | None,
) -> Left:
    """What an update leaves behind, of which only a late one needs more than its arguments."""
    taken: Any = np.ones(len(H), dtype=bool) if mask is None else mask
    if offset is None and H.shape[1] == len(K):
        return (z, H, R, taken, x, P, Covariance.of(K), cross)
    return LateUpdate(z, H, R, taken, x, P, Covariance.of(K), cross, offset)
