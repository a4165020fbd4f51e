"""The hot path of a UFIRFilter: work that waits until somebody looks.

On a constant model with nothing written from outside, predict() only moves `mode` from POSTED to PREDICTED,
update() stores z, and x is worked out when it is read (at once where the window has holes). `look` then makes
every field what the slow path would have made it, `settle` leaves the hot path.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .._arrays import Array
from ..engines.covariance import Covariance
from ..engines.lean import intake, reading
from ..engines.ring import Ring
from ..engines.varying import Varying
from ._state import POSTED, PREDICTED, SLOW
from ._varying_state import VaryingState
from ._window_state import MISSING, WINDOWS, checked_horizon

__all__ = ["MISSING", "POSTED", "PREDICTED", "SLOW", "WINDOWS", "UFIRState", "checked_horizon"]


class UFIRState(VaryingState):
    """A window state with a hot path for constant models as well."""

    def __init__(self, dim_x: int, dim_z: int, horizon: int | str, missing: str, window: str) -> None:
        super().__init__(dim_x, dim_z, horizon, missing, window)
        self.ring: Ring | None = None  # the engine, while the hot path holds
        self.put: Callable[[Any], bool] | None = None  # z into the ring
        self.read: Callable[[], Array] | None = None  # x of a full plain window, which can wait until read
        self.readers: tuple[Callable[[], Array], Callable[[], Array]] | None = None  # for either form of x
        self.missed = 0  # hot steps without a measurement, in a row
        self.silent = 0  # of these, the last ones that had no update() either

    def _ring(self, now: int) -> Ring:
        self.put = self.readers = None
        return super()._ring(now)

    def _hot_ring(self) -> Ring:
        ring = self.engine
        if not isinstance(ring, Ring):
            raise RuntimeError("the hot path runs on a ring only")
        return ring

    @property
    def ready(self) -> bool:
        """Whether the rows the window reaches determine the state."""
        return self.mode != SLOW or super().ready

    def warm(self) -> None:
        """Go over to the hot path if nothing stands against it."""
        ring = self.engine
        if self.ready_at != self.now or self.missing != "extend" or self._P_handed is not None:
            return
        if isinstance(ring, Varying):
            self._enter(ring)
        elif (
            isinstance(ring, Ring)
            and ring.raw is None
            and not self.watching
            and not (self.stale and self.policy == "auto")
            and all(a is live.value for a, live in zip(self.anchor, self._model_matrices(), strict=True))
        ):
            self.mode, self.seen, self.ring, self.missed, self.silent = POSTED, ring.now, ring, 0, 0
            if self.put is None:
                self.put = intake(ring)
            self.read = self._reader(ring)
            self.hot_x = None if self.read else self.shaped(self.x)

    def _reader(self, ring: Ring) -> Callable[[], Array] | None:
        """x as one product, for a full window without holes."""
        horizon = ring.limits.horizon
        if not (ring.length == horizon and ring.plain):
            return None
        if self.readers is None:
            gain = ring.plan.gain(horizon)
            if gain is None:
                return None
            self.readers = reading(ring, gain, column=False), reading(ring, gain, column=True)
        return self.readers[self.form == 2]

    def take(self, z: Any) -> bool:
        """The hot path's update() where x cannot wait; False, with nothing done, where the slow path is
        needed.
        """
        ring, put = self.ring, self.put
        if ring is None or put is None:
            raise RuntimeError("the hot path runs on a ring only")
        if z is None:
            missed = self._miss(ring)
            self.silent = 0 if missed else self.silent
            return missed
        if not put(z):
            return False
        if self.read is None and ring.settled:
            self.read = self._reader(ring)
            self.silent = self.missed = 0
        return self.read is not None or self._posted(ring, ring.estimate())

    def coast(self) -> bool:
        """The hot path's predict() after a predict()."""
        if not self._miss(self._hot_ring()):
            return False
        self.silent += 1
        return True

    def _miss(self, ring: Ring) -> bool:
        if self.missed >= ring.limits.horizon:
            return False
        self.missed += 1
        x = self.F.value.dot(self.posted_x())
        ring.hole()
        self.hot_x, self.read = x, None
        return True

    def take_weighted(self, z: Any, R: Any) -> bool:
        """The hot path's update() with an R that is a multiple of the model's."""
        ring, put = self._hot_ring(), self.put
        weight = ring.quick_weight(R)
        if weight is None or put is None or not isinstance(z, float | np.ndarray) or not put(weight * z):
            return False
        irregular = ring.irregular
        ring.weigh(weight, R, z)
        if self._posted(ring, ring.estimate()):
            self.read = None
            return True
        ring.irregular = irregular
        return False

    def _posted(self, ring: Ring, flat: Array | None) -> bool:
        if flat is None:
            ring.unstore()
            return False
        self.hot_x = flat.reshape(-1, 1) if self.form == 2 else flat
        self.missed = self.silent = 0
        return True

    def posted_x(self) -> Array:
        """x after the last update on the hot path, in the client's form."""
        return self.hot_x if self.read is None else self.read()  # type: ignore[return-value]

    def hand_out_x(self) -> Array:
        """The state, editable; edits count from the next verb on."""
        if self._x_handed is None and self.mode:
            if self.lane is not None:
                x = self._x_handed = self.turned_x()
                self._x_raw = x.tobytes()
                return x
            x = self.posted_x()
            if self.mode == PREDICTED:
                x = self.F.value.dot(x)
            elif self.read is None:
                x = x.copy()
            self._x_handed, self._x_raw = x, x.tobytes()
            return x
        return super().hand_out_x()

    def look(self) -> UFIRState:
        """Work out what the hot path left out; every field is then what the slow path would have made it."""
        if not self.mode:
            return self
        if self.lane is not None:
            self._publish_turned(self.lane)
            return self
        ring = self._hot_ring()
        F, Q = self.F.value, self.Q.value
        now = ring.now - self.silent  # the step of the last update()
        if now != self.seen:
            before, P_before = self._stood(now - 1)
            x, P = self._stood(now)
            slot = now - ring.base
            came = bool(ring.arrivals[slot] == now)
            self.prior = F @ before, P_before.predicted(F, Q, self.fading)
            self.post = (x, P) if came else self.prior
            mask = np.full(self.dim_z, came)
            none = Covariance.of(np.zeros((self.dim_x, 0)))
            gain = self.solution.newest_gain if came and self.solution is not None else none
            row = ring.odd.get(now)
            z = (ring.free[slot].copy() if row is None else row.z) if came else None
            R = self.R.value if row is None else row.R
            self._last = (z, self.H.value, R, mask, *self.prior, gain, None)
            self.now = self.seen = now
            self.updated = True
        self.x, self.P = self.post
        for _ in range(self.silent + (self.mode == PREDICTED)):
            self.x, self.P = self.prior = F @ self.x, self.P.predicted(F, Q, self.fading)
        if self._x_handed is not None:
            self.x = np.frombuffer(self._x_raw).copy()  # to the bit what the client was given
        return self

    def _stood(self, step: int) -> tuple[Array, Covariance]:
        """x and P after the update of a step on the hot path."""
        ring = self._hot_ring()
        came, (x, P) = self.seen, self.post
        for earlier in range(step, self.seen, -1):
            if ring.arrivals[earlier - ring.base] == earlier:
                came, solution = earlier, ring.solve_at(earlier)
                x, P = solution.x, solution.covariance
                self.solution, self.ready_at = solution, earlier
                break
        for _ in range(step - came):
            x, P = self.F.value @ x, P.predicted(self.F.value, self.Q.value, self.fading)
        return x, P

    def leave(self) -> None:
        """Leave the hot path."""
        if self.lane is not None:
            self.look()
            self._leave_lane(self.lane)
        elif self.mode:
            self.look()
            if self.mode == PREDICTED:
                self._hot_ring().advance(None)
                self.now += 1 + self.silent
                self.updated, self.silent = False, 0
            self.mode, self.ring, self.read = SLOW, None, None

    def _detach(self) -> None:
        """Work out the covariances that still lean on an engine which is about to have a life of its own."""
        if isinstance(self.engine, Varying):
            for P in (self.P, self.prior[1], self.post[1]):
                P.value  # noqa: B018
            if self.solution is not None:
                self.solution.gain.value, self.solution.newest_gain.value  # noqa: B018
            if self.last is not None:
                self.last.P.value, self.last.gain.value  # noqa: B018

    def __deepcopy__(self, memo: dict[int, Any]) -> UFIRState:
        self.settle()
        self._detach()
        return self._forked(("put", "readers"))

    def __getstate__(self) -> dict[str, Any]:
        self.settle()
        self._detach()
        return self.__dict__ | dict.fromkeys(("_x_handed", "_P_handed", "put", "readers"))
