"""What arrives through a channel, as rows that a window can hold.

A stamped measurement is an older row as it stands; the channel says which delays there are and which second
copies are none. A measurement whose delay is unknown is a row between two states: its H, R and the
correlation of its noise with the process noise depend on what the filter knows when it comes.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from .._arrays import Array
from ..channels import Channel, Effective, Step
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
from ._window_state import WindowState


class ChannelState(FilterState):
    """A state object behind a channel. Mixed into the state objects of the window filters."""

    channel: Channel

    def behind(self, channel: Channel) -> None:
        """Take measurements from this channel, from the first one on."""
        self.channel = channel


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
    """Measurements without stamps, one step late with a known probability."""

    step: Step | None = None  # the last transition, with all that is known to have moved the state
    start: tuple[Array, Covariance] | None = None  # from which it led
    moved_after: Array | None = None  # edits of x since the last row of this step

    def predict(self, F: Array, Q: Array, known: Array | None) -> None:
        """Time update by F, Q and a known change of the state."""
        start, after = (self.x, self.P), self.moved_after
        super().predict(F, Q, known)
        if after is not None:
            # What came in the step that ends saw the state before it was moved.
            start = (start[0] - after, start[1])
            known = F @ after if known is None else known + F @ after
        self.step, self.start, self.moved_after = Step(F, Q, known), start, None

    def _moved(self, delta: Array) -> None:
        super()._moved(delta)
        if self.step is not None:
            Bu = self.step.Bu
            self.step = self.step._replace(Bu=delta if Bu is None else Bu + delta)
        if self.updated:
            self.moved_after = delta if self.moved_after is None else self.moved_after + delta

    def warm(self) -> None:
        """Every row is another one: there is no hot path."""

    def _known(self) -> tuple[Array, Array]:
        """x and P of now, before the rows of this step."""
        if self.updated:
            return self.prior[0], self.prior[1].value
        return self.x, self.P.value

    def _pair(self) -> Lifted:
        """The present state and the one before, before the rows of this step."""
        if self.step is None or self.start is None:
            raise RuntimeError("there is no state before the first step")
        x, P = self._known()
        before = self.start[1].value
        cross, expected = self.step.F @ before, self.prior[1].value
        pair = Lifted(np.concatenate([x, self.start[0]]), np.block([[expected, cross], [cross.T, before]]))
        return pair if P is expected else with_marginal(pair, P)

    def _left(
        self, z: Array, row: Effective, mask: Any, met: tuple[Array, Covariance], cross: Array | None
    ) -> None:
        """Publish what was measured, and the state it met, in place of what the window took."""
        if self.last is not None:
            gain = self.last.gain
            self.last = LateUpdate(z, row.H, row.R, mask, *met, gain, cross, row.offset)


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

    def _absorb(self, z: Array, H: Array, R: Array, delay: int, cross: Array | None) -> Covariance | None:
        self.correlation = cross
        return super()._absorb(z, H, R, delay, cross)

    def _add(
        self, engine: Ring | Records, z: Array, H: Array, R: Array, delay: int
    ) -> tuple[bool, Solution | None]:
        correlation, self.correlation = self.correlation, None
        if isinstance(engine, Ring):
            raise RuntimeError("a ring holds no correlated rows")
        if correlation is not None:
            unit = root(engine.step(self.now - delay).Q)
            correlation = np.linalg.lstsq(unit, correlation, rcond=None)[0]
        row = Row(self.now - delay, self.now, H, R, z, correlation=correlation)
        if engine.negligible(row):
            return False, None
        self.irregular = self.now
        engine.add(row)
        engine.forget(self.limits)
        return True, None if self._hopeless(engine) else engine.solve(self.limits)


class EffectiveRows(AveragedRows):
    """Each measurement as a row of the present state, by `Channel.effective`."""

    def update(
        self, z: Array | None, H: Array, R: Array, delay: int, cross: Array | None = None, whole: bool = False
    ) -> None:
        """Measurement update; z flat with NaN for missing components, or None."""
        self.channel.check_delay(delay)
        if z is None or self.step is None:
            super().update(z, H, R, 0, cross, whole)
            return
        row = self.channel.row(H, R, [self.step], 0, *self._known())
        if not row.G:
            super().update(z, H, R, 0, cross, whole)
            return
        cross = row.correlation if cross is None else row.correlation + cross
        z_in, H_in, R_in, mask = measured(z + row.offset, row.H, row.R)
        if not mask.any():
            super().update(None, row.H, row.R, 0)
            return
        met = self.x, self.P
        super().update(z_in, H_in, R_in, 0, cross[:, mask])
        self._left(z, row, mask, met, cross)
