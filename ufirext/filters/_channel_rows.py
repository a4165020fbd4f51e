"""What arrives through a channel, as rows that a window can hold.

A stamped measurement is an older row as it stands; the channel says which delays there are and which second
copies are none. A measurement whose delay is unknown is a row between two states: its H, R and the
correlation of its noise with the process noise depend on what the filter knows when it comes.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from .._arrays import Array, symmetric
from ..channels import Channel, Step
from ..channels.effective import through_inverse
from ..engines.covariance import Covariance
from ..engines.records import Records, Solution, Stack, measured
from ..engines.ring import Ring
from ..engines.varying import Varying
from ..growing import root
from ..recursions.augmented import Lifted
from ..window import Row
from ._late import LateUpdate
from ._lifted import with_marginal
from ._state import FilterState
from ._update import innovation_gain, joseph
from ._window_state import WindowState


class ChannelState(FilterState):
    """A state object behind a channel. Mixed into the state objects of the window filters."""

    channel: Channel

    @property
    def plain(self) -> bool:
        """False: what a row is, or whether it counts, the channel decides at each step."""
        return False


class StampedRows(ChannelState):
    """Measurements with time stamps: delays are checked, and duplicates dropped and counted."""

    dropped: int
    received: tuple[int, ...] = ()  # origins, as far back as one can come again

    def update(
        self, z: Array | None, H: Array, R: Array, delay: int, cross: Array | None = None, whole: bool = False
    ) -> None:
        """Measurement update; z flat with NaN for missing components, or None."""
        delay = self.channel.check_delay(delay)
        if self.channel.fresh_noise or z is None or not (whole or measured(z, H, R)[3].any()):
            super().update(z, H, R, delay, cross, whole)
            return
        origin = self.now - delay
        if origin in self.received:
            self.dropped += 1
            super().update(None, H, R, 0)
            return
        super().update(z, H, R, delay, cross, whole)
        oldest = self.now - self.channel.max_delay
        self.received = (*(step for step in self.received if step >= oldest), origin)

    def warm(self) -> None:
        """The hot path keeps no book of what came: only a channel without duplicates may use it."""
        if self.channel.fresh_noise:
            super().warm()


class AveragedRows(ChannelState):
    """Measurements without stamps, one step late with a known probability: rows of [x_n; x_{n-1}]."""

    step: Step | None = None  # the last transition, with all that is known to have moved the state
    start: tuple[Array, Covariance] | None = None  # from which it led
    expected: Covariance | None = None  # and the P to which
    moved_after: Array | None = None  # edits of x since the last row of this step
    met: Lifted | None = None  # [x_n; x_{n-1}] as the row that is taken in finds it
    left: tuple[Lifted, Covariance] | None = None  # and as the last row of the warm-up left it, with its P
    wide: tuple[Array, Array, Array] | None = None  # z, H and R of the row that is taken in

    def predict(self, F: Array, Q: Array, known: Array | None) -> None:
        """Time update by F, Q and a known change of the state."""
        start, after = (self.x, self.P), self.moved_after
        super().predict(F, Q, known)
        if after is not None:
            # What came in the step that ends saw the state before it was moved.
            start = (start[0] - after, start[1])
            known = F @ after if known is None else known + F @ after
        self.step, self.start, self.expected = Step(F, Q, known), start, self.P
        self.moved_after = self.left = None

    def update(
        self, z: Array | None, H: Array, R: Array, delay: int, cross: Array | None = None, whole: bool = False
    ) -> None:
        """Measurement update; z flat with NaN for missing components, or None."""
        self.channel.check_delay(delay)
        if z is None or self.step is None:
            super().update(z, H, R, 0, cross, whole)
            return
        pair = self.met = self._pair()
        both, own = self.channel.lifted(H, R, 0, pair.x, pair.P)
        if not both[:, self.dim_x :].any():
            super().update(z, H, R, 0, cross, whole)
            return
        mask: Any = measured(z, both, own)[3]
        if not mask.any():
            super().update(None, H, R, 0)
            return
        if cross is not None:
            cross = np.vstack([cross, np.zeros_like(cross)])
        super().update(z, both, own, 0, cross)
        if self.last is not None:
            gain = self.last.gain
            self.last = LateUpdate(z, both, own, mask, pair.x, Covariance.of(pair.P), gain, cross)

    def _pair(self) -> Lifted:
        """The present state and the one before; in the warm-up as the rows of this step left them."""
        if self.step is None or self.start is None or self.expected is None:
            raise RuntimeError("there is no state before the first step")
        if self.left is not None:
            (x, P), made = self.left[0], self.left[1]
            pair = Lifted(np.concatenate([self.x, x[self.dim_x :]]), P)
            return pair if self.P is made else with_marginal(pair, self.P.value)
        x, now = self.prior if self.updated else (self.x, self.P)
        before, expected = self.start[1].value, self.expected.value
        cross = self.step.F @ before
        pair = Lifted(np.concatenate([x, self.start[0]]), np.block([[expected, cross], [cross.T, before]]))
        return pair if now is self.expected else with_marginal(pair, now.value)

    def _kalman(self, z: Array, H: Array, R: Array, cross: Array | None) -> Covariance:
        """The book's update of the pair, for as long as the rows do not determine the state."""
        if self.wide is None or self.met is None:
            return super()._kalman(z, H, R, cross)  # type: ignore[misc, no-any-return]
        n, pair, (z, H, R) = self.dim_x, self.met, self.wide
        cross = None if cross is None or len(z) != cross.shape[1] else cross
        K, S = innovation_gain(pair.P, H, R, cross)
        P = joseph(pair.P, K, H, R) if cross is None else pair.P - K @ S @ K.T
        x, marginal = pair.x + K @ (z - H @ pair.x), Covariance.of(P[:n, :n])
        self.left = Lifted(x, P), marginal
        self._publish(x[:n], marginal)
        return Covariance.of(K[:n])

    def _moved(self, delta: Array) -> None:
        super()._moved(delta)
        if self.step is not None:
            Bu = self.step.Bu
            self.step = self.step._replace(Bu=delta if Bu is None else Bu + delta)
        if self.updated:
            self.moved_after = delta if self.moved_after is None else self.moved_after + delta

    def warm(self) -> None:
        """Every row is another one: there is no hot path."""


class CorrelatedRecords(Varying):
    """Records of rows whose noise is correlated with the process noise of their step."""

    def stack(self, rows: Any, aim: int) -> Stack:
        """The rows as a regression, with their correlations."""
        stack = super().stack(rows, aim)
        correlations = [row.correlation for row in stack.rows]
        return stack._replace(window=replace(stack.window, correlations=correlations))

    def _compress(self) -> None:
        """Rows that share a process noise cannot be merged by QR."""

    def copy(self) -> CorrelatedRecords:
        """An independent copy; it builds its sums anew."""
        fork = object.__new__(CorrelatedRecords)
        fork.__dict__.update(super().copy().__dict__)
        return fork


class CorrelatedWindow(WindowState):
    """A window whose rows may have noise that is correlated with the process noise."""

    correlation: Array | None = None  # of the row that is being taken in

    def _regular(self, F: Array, Q: Array) -> bool:
        return False

    def _general(self, F: Array, Q: Array) -> Records:
        return CorrelatedRecords(F, Q, self.now, self.limits)

    def _over(self, records: Records) -> Records:
        return CorrelatedRecords.over(records, self.limits)

    def _add(
        self, engine: Ring | Records, z: Array, H: Array, R: Array, delay: int
    ) -> tuple[bool, Solution | None]:
        correlation, self.correlation = self.correlation, None
        if isinstance(engine, Ring):
            raise RuntimeError("a ring holds no correlated rows")
        if correlation is not None:
            unit = root(engine.step(self.now - delay).Q)
            correlation = np.asarray(np.linalg.lstsq(unit, correlation, rcond=None)[0], dtype=float)
        row = Row(self.now - delay, self.now, H, R, z, correlation=correlation)
        if engine.negligible(row, self.limits):
            return False, None
        self.irregular = self.now
        engine.add(row)
        engine.forget(self.limits)
        return True, None if self._hopeless(engine) else engine.solve(self.limits)


class EffectiveRows(AveragedRows, CorrelatedWindow):
    """Each measurement as a row of the present state alone, as `Channel.effective` has it."""

    def _absorb(self, z: Array, H: Array, R: Array, delay: int, cross: Array | None) -> Covariance | None:
        n, step = self.dim_x, self.step
        self.wide = self.correlation = None
        if H.shape[1] == n or step is None:
            return super()._absorb(z, H, R, delay, cross)
        G = through_inverse(H[:, n:], step.F)
        if self.stale:
            self.refresh()
        self._correlate(-step.Q @ G.T)
        self.wide, self.left = (z, H, R), None
        z = z if step.Bu is None else z + G @ step.Bu
        gain = super()._absorb(z, H[:, :n] + G, symmetric(R + G @ step.Q @ G.T), 0, cross)
        self.wide = None
        return gain

    def _correlate(self, correlation: Array) -> None:
        """The correlation of the coming row's noise with the process noise."""
        self.correlation = correlation
