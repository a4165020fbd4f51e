"""The hot path of a UFIRFilter whose model changes from step to step.

predict() and update() go straight to the engine's running sums and leave only x; what else a step publishes
is worked out from the engine's records when somebody looks. `look` makes every field what the slow path would
have made it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._arrays import Array
from ..engines.covariance import Covariance
from ..engines.frames import Frames
from ..engines.hands import QuickStep
from ..engines.records import Step
from ..engines.varying import Varying, estimate_of
from ..window import Row
from ._live import Live
from ._state import SLOW, TURNED, TURNING
from ._window_state import WindowState, engine_reach

Estimate = tuple[Array, int, Row | None, int]


class VaryingState(WindowState):
    """A window state that need not leave its hot path when F, H, Q or R change."""

    def __init__(self, dim_x: int, dim_z: int, horizon: int | str, missing: str, window: str) -> None:
        super().__init__(dim_x, dim_z, horizon, missing, window)
        self.lane: Varying | None = None  # the engine, while this hot path holds
        self.hot_x: Array | None = None  # x after the last hot update, in the client's form
        self.seen = 0  # step up to which the published fields are worked out
        self.at = 0  # step of the last update(), which left hot_x
        self.unseen = False  # whether that update() is still to be published
        # Steps for which rows are remembered beyond their window; after so many regular ones the slow path
        # looks for another engine.
        self.memory = self.patience = 0
        self.base: tuple[Array, int] = (self.x, 0)  # hot_x and `at` before it
        # The last estimate and the one before it: x, step, newest row, rows in the window.
        self.latest: Estimate = (self.x, 0, None, 0)
        self.latest_before: Estimate = self.latest
        self.told: Estimate = self.latest  # the one that the published fields go back to
        # What the last update() was given: its row, or the H and R of a measurement that did not come.
        self.given: Row | tuple[Array, Array] = (self.x, self.x)

    def _enter(self, engine: Varying) -> None:
        """Go over to the hot path, after an update() with an estimate, if nothing stands against it."""
        limits = self.limits
        self.memory, self.patience = limits.reach - limits.horizon, engine_reach(limits)
        fit = isinstance(engine.sums, Frames) and engine.after is None
        if fit and self.now - self.irregular <= self.patience and not self._due(self.now):
            self.mode, self.lane, self.unseen = TURNED, engine, False
            self.seen = self.at = self.now
            self.latest = (self.x, self.now, engine.rows[-1], engine.window_rows)
            self.told = self.latest
            self.hot_x = self.shaped(self.x)

    def _due(self, now: int) -> bool:
        """Whether the horizon is to be chosen anew."""
        if not self.stale or self.policy != "auto":
            return False
        return self.refreshed is None or now - self.refreshed >= (self.horizon or 0)

    def touch(self) -> None:
        """A model matrix is about to be changed: steps keep their own, so nothing is lost."""
        if self.lane is None:
            self.leave()

    def assign(self, name: str, value: Any) -> None:
        """A model matrix assigned from outside; one that is plainly right need not leave this hot path."""
        live: Live = getattr(self, name)
        raw = live.check.quick(value) if self.lane is not None and self.watching else None
        if raw is None:
            super().assign(name, value)
        elif live.replace(value, raw):
            self._model_changed()

    def _model_changed(self) -> None:
        self.stale = True
        self.irregular = self.now if self.lane is None else self.lane.now

    # -- the verbs -------------------------------------------------------------------------------------------

    def turn(self, u: ArrayLike | None, B: ArrayLike | None, F: Any, Q: ArrayLike | None) -> bool:
        """predict() on the hot path; False, with nothing done, where the slow path is needed."""
        engine = self.lane
        if engine is None or (sums := engine.sums).__class__ is not Frames:
            return False
        if self.watching:
            if self.policy == "auto":  # a horizon chosen from the model may follow from H and R too
                self._look_again(*self._matrices())
            elif self.F.edited or self.Q.edited or (self.B is not None and self.B.edited):
                self._look_again(self.F, self.Q, self.B)
        now = engine.now
        # The windows that covariances lean on must still be remembered when these are worked out.
        if now - self.latest[1] > self.memory or now - self.irregular > self.patience:
            return False
        if self.stale and self._due(now):
            return False
        raw = None
        if u is None:
            raw = self.F.raw if F is None else self.F.check.quick(F)
        if raw is None:
            step = Step(*self.transition(u, B, F, Q))
            F_now = step.F
        else:
            step = QuickStep.of(raw, self.Q.value if Q is None else self.Q.taken(Q))
            F_now = self.F.present if F is None else F
        constant = F is None and Q is None and step.known is None
        if not constant:
            self.irregular = now
        engine.turned(sums, step, F_now)
        self.mode = TURNING
        return True

    def join(self, z: Any, R: Any, H: Any) -> bool:
        """update() on the hot path; False, with nothing done, where the slow path is needed."""
        engine = self.lane
        if engine is None or (sums := engine.sums).__class__ is not Frames:
            return False
        if self.watching:
            if self.policy == "auto":
                self._look_again(*self._matrices())
            elif self.H.edited or self.R.edited:
                self._look_again(self.H, self.R)
        if z is None:
            return H is None and R is None and self._blank(engine)
        if self.stale and self._due(engine.now):
            return False
        raw_H = raw_R = None
        if H is None:
            H_now, raw_H = self.H.present, self.H.raw
        else:
            H_now = H
        if R is None:
            R_now, raw_R = self.R.present, self.R.raw
        else:
            R_now = R
        row = sums.row(engine.now, z, H_now, R_now, raw_H, raw_R)
        if row is None or engine.negligible(row, engine.limits):
            return False
        if self.mode == TURNED:
            self.look()  # a second row of this step meets what the first one left
        self._known(row, H, R)
        if H is not None or R is not None or self.mode == TURNED:
            self.irregular = engine.now
        x = engine.joined(sums, row)
        if x is None:
            return False
        now = engine.now
        self.base, self.latest_before = (self.hot_x, self.at), self.latest  # type: ignore[assignment]
        self.hot_x = x.reshape(-1, 1) if self.form == 2 else x
        self.at, self.latest, self.unseen, self.mode = now, (x, now, row, sums.rows), True, TURNED
        self.given = row
        return True

    def _known(self, row: Row, H: Any, R: Any) -> None:
        """What is constant is known by identity."""
        if H is None and self.H.handed is None:
            row.H = self.H.value
        if R is None and self.R.handed is None:
            row.R = self.R.value

    def _blank(self, engine: Varying) -> bool:
        """update(None): nothing came."""
        if self.mode == TURNED:
            return False
        self.base, self.latest_before = (self.hot_x, self.at), self.latest  # type: ignore[assignment]
        self.hot_x = self._turned_ahead(engine)
        self.at, self.unseen, self.mode = engine.now, True, TURNED
        self.given = self.H.value, self.R.value
        return True

    # -- what is worked out later ----------------------------------------------------------------------------

    def _turned_ahead(self, engine: Varying) -> Array:
        """x now, from that of the last update()."""
        x: Array = self.hot_x  # type: ignore[assignment]
        for number in range(self.at + 1, engine.now + 1):
            x = _moved(engine.step(number), x)
        return x

    def turned_x(self) -> Array:
        """x of now, in the client's form, for the client to keep."""
        engine: Varying = self.lane  # type: ignore[assignment]
        x: Array = self.hot_x  # type: ignore[assignment]
        return x.copy() if self.at == engine.now else self._turned_ahead(engine)

    def _publish_turned(self, engine: Varying) -> None:
        """Every field as the slow path would have made it."""
        if self.unseen:
            self._publish_update(engine)
        self.x, self.P = self.post
        for number in range(self.at + 1, engine.now + 1):
            step = engine.step(number)
            self.x, self.P = self.prior = _moved(step, self.x), self.P.predicted(step.F, step.Q, self.fading)
        if self._x_handed is not None:
            self.x = np.frombuffer(self._x_raw).copy()  # to the bit what the client was given

    def _publish_update(self, engine: Varying) -> None:
        (x, base), at, start, P = self.base, self.at, self.seen, self.post[1]
        x = x.reshape(-1)
        if self.latest_before is not self.told:
            self.solution = estimate_of(engine, *self.latest_before)
            self.ready_at = start = self.latest_before[1]
            P = self.solution.covariance
        for number in range(start + 1, at + 1):
            step = engine.step(number)
            P = P.predicted(step.F, step.Q, self.fading)
        for number in range(base + 1, at + 1):
            x = _moved(engine.step(number), x)
        if base < at:
            self.prior = x, P
        given = self.given
        row, H, R = (given, given.H, given.R) if isinstance(given, Row) else (None, *given)
        self._last = (None if row is None else row.z, H, R, np.full(len(H), row is not None), x, P)
        self.post = x, P
        gain = Covariance.of(np.zeros((self.dim_x, 0)))
        if row is not None:
            solution = estimate_of(engine, *self.latest)
            self.solution, self.ready_at, gain = solution, at, solution.newest_gain
            self.post = solution.x, solution.covariance
        self._last += (gain, None)
        self.told = self.latest
        self.now = self.seen = at
        self.updated, self.unseen = True, False

    def _leave_lane(self, engine: Varying) -> None:
        if engine.now != self.at:
            self.now, self.updated = engine.now, False
        self.mode, self.lane = SLOW, None


def _moved(step: Step, x: Array) -> Array:
    ahead: Array = step.F.dot(x)
    if step.known is None:
        return ahead
    return ahead + (step.known if x.ndim == 1 else step.known.reshape(-1, 1))
