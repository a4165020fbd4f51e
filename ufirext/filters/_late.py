"""State objects of the filters that take late measurements: Kalman, by two exact ways and two baselines."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .._arrays import Array, symmetric
from ..channels import Channel, Effective
from ..channels.effective import at_block, on_time
from ..engines.covariance import Covariance
from ..engines.records import measured
from ..errors import HorizonError
from ..recursions.augmented import Lifted, lift, predict_lifted
from ..recursions.delayed import Correlation, Delayed, cross_covariance, predict_delayed, update_delayed
from ..recursions.kalman import Posterior, update
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
        regular = F is self.F.value and Q is self.Q.value and known is None and self.P is self.own_P
        x, P = self._ahead(F, Q, known)
        regular = regular and self.edited is None
        self.edited = None
        self._present(x, P)
        self.now += 1
        self.updated = False
        self.prior = (self.x, self.P)
        if self.seen:
            self.seen = tuple(origin for origin in self.seen if origin >= self.now - self.channel.max_delay)
        self._predicted(regular)

    def update(
        self, z: Array | None, H: Array, R: Array, delay: int, cross: Array | None = None, whole: bool = False
    ) -> None:
        """Measurement update; z flat with NaN for missing components, or None; `whole`: none is missing."""
        delay = self._age(delay)
        last: Update | None = None
        if z is not None:
            mask = np.ones(len(H), dtype=bool) if whole else measured(z, H, R)[3]
            if mask.any() and self._wanted(delay):
                last, x, P = self._taken(z, H, R, mask, delay, cross)
                self._present(x, P)
                if self.channel.stamped and not self.channel.fresh_noise:
                    self.seen = (*self.seen, self.now - delay)
        if last is None:
            self._nothing()
            mask = np.zeros(len(H), dtype=bool)
            last = Update(z, H, R, mask, self.x, self.P, Covariance.of(np.zeros((self.dim_x, 0))))
        self._last = last
        plain = whole and delay == 0 and cross is None and not self.updated
        self.updated = True
        self.post = (self.x, self.P)
        if plain:
            self._enter(H, R, last.gain)
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
        self, z: Array, H: Array, R: Array, mask: Array, delay: int, cross: Array | None
    ) -> tuple[Update, Array, Array]:
        """Take the measured components; what the update leaves behind, and x and P of the present state."""
        raise NotImplementedError

    def _nothing(self) -> None:
        """An update() brought nothing."""


class RecursiveState(LateState):
    """The recursion on the present state alone, with all, some or none of the correlation."""

    def __init__(self, dim_x: int, dim_z: int, channel: Channel, correlation: Correlation) -> None:
        super().__init__(dim_x, dim_z, channel)
        self.correlation = correlation
        self.memory = Delayed(self.x, self.P.value)

    def _remembered(self) -> Delayed:
        """The memory with x and P as they are now; another P says nothing of how it goes with past noises."""
        E = self.memory.E if self.P is self.own_P else tuple(np.zeros_like(E) for E in self.memory.E)
        return self.memory._replace(x=self.x, P=self.P.value, E=E)

    def _held(self) -> Delayed:
        return self.memory

    def _resume(self, held: Delayed, steps: int) -> None:
        self.memory, self.own_P = held, self.P

    def _levels(self) -> list[Array]:
        return [self.P.value, *self.memory.E]

    def _repeats(self) -> bool:
        inputs = any(step.Bu is not None for step in self.memory.past)
        return super()._repeats() and not inputs and len(self.memory.past) == self.channel.max_delay

    def _moved(self, delta: Array) -> None:
        super()._moved(delta)
        if not self.updated and self.memory.past:
            *older, newest = self.memory.past
            Bu = delta if newest.Bu is None else newest.Bu + delta
            self.memory = self.memory._replace(past=(*older, newest._replace(Bu=Bu)))

    def _ahead(self, F: Array, Q: Array, known: Array | None) -> tuple[Array, Array]:
        depth = self.channel.max_delay
        state = predict_delayed(self._remembered(), F, Q, known, depth=depth, fading=self.fading)
        if self.edited is not None and depth:
            *older, newest = state.past
            Bu = F @ self.edited if known is None else known + F @ self.edited
            state = state._replace(past=(*older, newest._replace(Bu=Bu)))
        self.memory = state
        return state.x, state.P

    def _taken(
        self, z: Array, H: Array, R: Array, mask: Array, delay: int, cross: Array | None
    ) -> tuple[Update, Array, Array]:
        state = self._remembered()
        row = self._row(state, H, R, delay)
        full_cross = cross_covariance(state, row, self.correlation, cross)
        self.memory, posterior = update_delayed(
            state,
            z[mask],
            _components(row, mask),
            self.correlation,
            None if cross is None else cross[:, mask],
        )
        gain = Covariance.of(posterior.K)
        last = LateUpdate(z, row.H, row.R, mask, state.x, self.P, gain, full_cross, row.offset)
        return last, posterior.x, posterior.P

    def _row(self, state: Delayed, H: Array, R: Array, delay: int) -> Effective:
        if not state.past:
            return on_time(H, R)
        x, P = (self.prior[0], self.prior[1].value) if self.updated else (state.x, state.P)
        row = self.channel.row(H, R, state.past, delay, x, P)
        if delay and self.edited is not None:
            # The measurement saw the state before x was moved.
            row = row._replace(offset=row.offset + row.H @ self.edited)
        return row


class LiftedState(LateState):
    """The Kalman filter of the augmented state [x_n; x_{n-1}; ..]."""

    def __init__(self, dim_x: int, dim_z: int, channel: Channel) -> None:
        super().__init__(dim_x, dim_z, channel)
        self.tall = lift(self.x, self.P.value, channel.max_delay + 1)

    def _settled(self) -> Lifted:
        """The augmented state with x and P as they are now."""
        if self.P is not self.own_P:
            self.tall = _with_marginal(self.tall, self.P.value)
            self.own_P = self.P
        return self.tall

    def _held(self) -> Array:
        return self.tall.P

    def _resume(self, held: Array, steps: int) -> None:
        self.tall, self.own_P = Lifted(self.x, held), self.P

    def _repeats(self) -> bool:
        return super()._repeats() and self.channel.max_delay == 0

    def _moved(self, delta: Array) -> None:
        super()._moved(delta)
        x = self.tall.x.copy()
        x[: self.dim_x] += delta
        self.tall = self.tall._replace(x=x)

    def _ahead(self, F: Array, Q: Array, known: Array | None) -> tuple[Array, Array]:
        n = self.dim_x
        self.tall = predict_lifted(self._closed(self._settled()), F, Q, known, self.fading)
        if self.edited is not None and len(self.tall.x) > n:
            # Rows of the step that ends saw the state before x was moved.
            self.tall.x[n : 2 * n] -= self.edited
        return self.tall.x[:n].copy(), self.tall.P[:n, :n].copy()

    def _taken(
        self, z: Array, H: Array, R: Array, mask: Array, delay: int, cross: Array | None
    ) -> tuple[Update, Array, Array]:
        n, state = self.dim_x, self._start()
        if self.now:
            big_H, R = self.channel.lifted(H, R, delay, state.x, state.P)
        else:
            big_H = at_block(H, 0, len(state.x))
        if cross is not None:
            cross = np.vstack([cross, np.zeros((len(state.x) - n, len(H)))])
        posterior = self._updated(state, z[mask], big_H[mask], R[np.ix_(mask, mask)], _columns(cross, mask))
        self.tall = Lifted(posterior.x, posterior.P)
        prior = Covariance.of(state.P)
        last = LateUpdate(z, big_H, R, mask, state.x, prior, Covariance.of(posterior.K[:n]), cross)
        return last, posterior.x[:n].copy(), posterior.P[:n, :n].copy()

    def lagged(self, lag: int) -> tuple[Array, Array]:
        """The state `lag` steps ago, in the client's form, and its covariance."""
        state, n = self._settled(), self.dim_x
        at = slice(lag * n, (lag + 1) * n)
        return self.shaped(state.x[at]), state.P[at, at].copy()

    def _start(self) -> Lifted:
        """The augmented state that a measurement of this step meets."""
        return self._settled()

    def _closed(self, state: Lifted) -> Lifted:
        """The augmented state at the end of its step."""
        return state

    def _updated(self, state: Lifted, z: Array, H: Array, R: Array, cross: Array | None) -> Posterior:
        return update(state.x, state.P, z, H, R, cross)


def _components(row: Effective, mask: Array) -> Effective:
    """The measured components of a row."""
    if mask.all():
        return row
    return Effective(
        row.H[mask],
        row.R[np.ix_(mask, mask)],
        tuple(G[mask] for G in row.G),
        row.correlation[:, mask],
        row.offset[mask],
    )


def _columns(cross: Array | None, mask: Array) -> Array | None:
    return None if cross is None else cross[:, mask]


def _with_marginal(state: Lifted, P: Array) -> Lifted:
    """Another covariance of the newest block; what the older ones are given the newest stays."""
    n = len(P)
    old, joint = state.P[:n, :n], state.P[n:, :n]
    if not len(joint):
        return state._replace(P=P)
    regression = joint @ np.linalg.pinv(old, hermitian=True)
    big = state.P.copy()
    big[:n, :n] = P
    big[n:, :n] = regression @ P
    big[:n, n:] = big[n:, :n].T
    big[n:, n:] = symmetric(big[n:, n:] + regression @ (P - old) @ regression.T)
    return state._replace(P=big)
