"""What an FMSFilterSmoother remembers: a ring while all is regular, folds of segments when it is not."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .._arrays import Array
from ..engines.covariance import Covariance
from ..engines.lean import intake
from ..engines.pairs import PairRing, pair_plan
from ..engines.records import Limits, Solution
from ..engines.segmented import Prior, Segmented
from ..errors import CovarianceError
from ..minimum_variance import shortest_window
from ..window import Row
from ._fms_lag import LaggedState
from ._state import POSTED, PREDICTED, SLOW, WATCHED

# What belongs to one filter and is made anew for a copy.
TORN = ("put", "intake", "read", "read_lagged")


class FMSState(LaggedState):
    """Minimum variance over a window, of the newest state and a lagged one; a Kalman filter until then."""

    def __init__(self, dim_x: int, dim_z: int, horizon: int, lag: int) -> None:
        super().__init__(dim_x, dim_z, horizon, lag)
        self.index: int | None = None
        self.unchecked = True  # whether the model has still to be looked at
        self.anchor: tuple[Array, ...] = ()  # F, H, Q, R the ring was made for
        self.tried = 0  # step at which a ring was last looked for
        self.solution: Solution | None = None
        self.ready_at: int | None = None  # step of the last update that left the filter ready
        self.dropped = 0
        self.read_lagged: Callable[[], Array] | None = None
        self.reading = 0  # form of x that the readers give
        self.seen = 0  # step up to which the published fields are worked out

    # -- horizon and lag --------------------------------------------------------------------------------

    @property
    def limits(self) -> Limits:
        """The window's rules."""
        return Limits(self.horizon, (self.index or 1) + 2, True, False)

    def set_window(self, horizon: int, lag: int) -> None:
        """Another horizon and lag, from the next verb on."""
        if self.engine is not None:
            self._folds()
        self.horizon, self.lag = horizon, lag
        self.unchecked, self.lagged_then = True, None

    def check(self) -> None:
        """Look at the model once: raise if the window can never determine the states that are wanted."""
        self.unchecked = False
        self.index = shortest_window(self.model(), self.horizon, self.lag)

    # -- engines ----------------------------------------------------------------------------------------

    def _begin(self, F: Array, Q: Array) -> Segmented | PairRing:
        if self.unchecked:
            self.check()
        if self.engine is None:
            self.known, self.own_P = Prior(self.now, self.x, self.P.value), self.P
            self.engine = Segmented(F, Q, self.now, self.x)
            self.engine.doubtful = self.index is None
        return self.engine

    def _ring(self, engine: Segmented, F: Array, Q: Array) -> PairRing | None:
        """A ring in place of the folds, if their window is full and plain; looked for once a horizon."""
        regular = F is self.F.value and Q is self.Q.value and self.index is not None
        if not regular or self.now - self.tried < self.horizon:
            return None
        self.tried = self.now
        plan = pair_plan(self.model(), self.horizon, self.lag)
        ring = PairRing.of(plan, engine) if plan.determined else None
        if ring is not None:
            self.anchor = (self.F.value, self.H.value, self.Q.value, self.R.value)
            self.put = self.intake = None
        return ring

    def _folds(self) -> Segmented:
        """The engine for everything that a ring cannot hold."""
        engine = self.engine
        if isinstance(engine, PairRing):
            if engine.now == self.lag_at:
                self.lagged_then = engine.lagged()
            folds = engine.segmented()
            if engine.now < self.now:
                known = None
                if engine.path is not None and engine.ahead is not None:
                    known = engine.ahead - self.anchor[0] @ engine.path[-1]
                folds.advance(self.anchor[0], self.anchor[2], known)
            self.engine, self.tried = folds, self.now
            return folds
        if engine is None:
            raise RuntimeError("the filter has not begun")
        return engine

    # -- verbs ------------------------------------------------------------------------------------------

    def _advance(self, F: Array, Q: Array, known: Array | None) -> None:
        engine = self._begin(F, Q)
        if isinstance(engine, Segmented):
            engine = self.engine = self._ring(engine, F, Q) or engine
        if isinstance(engine, PairRing):
            if F is self.anchor[0] and Q is self.anchor[2] and engine.now == self.now:
                engine.advance(known)
                return
            engine = self._folds()
        engine.center = self.x
        engine.advance(F, Q, known)

    def _moved(self, delta: Array) -> None:
        engine = self.engine
        super()._moved(delta)
        if isinstance(engine, PairRing) and self.updated == (engine.now == self.now):
            engine.edit(delta, self.updated)
        elif engine is not None:
            self._folds().edit(delta, self.updated)

    def _absorb(self, z: Array, H: Array, R: Array, delay: int, cross: Array | None) -> Covariance | None:
        check_weight(R)
        engine = self._begin(self.F.value, self.Q.value)
        if delay >= self.horizon:
            self.dropped += 1
            return None
        if isinstance(engine, PairRing):
            plain = delay == 0 and engine.now == self.now - 1
            if plain and H is self.anchor[1] and R is self.anchor[3] and engine.put(z):
                return self._solved(engine.solve())
        folds = self._folds()
        row = Row(self.now - delay, self.now, H, R, z)
        if folds.negligible(row, self.limits):
            return None
        solution = self._entered(folds, row)
        if solution is not None:
            return self._solved(solution)
        if delay:
            return Covariance.of(np.zeros((self.dim_x, len(z))))
        return self._kalman(z, H, R, cross)

    def _entered(self, folds: Segmented, row: Row) -> Solution | None:
        """The row in the window, and what the window says; None where it does not determine the state."""
        self.lagged_then = None  # of the rows without this one
        folds.add(row)
        folds.forget(self.limits)
        solution = folds.solve(self.limits)
        if solution is None:
            self.solution = None
            self._lost()
        return solution

    def _solved(self, solution: Solution) -> Covariance:
        self.solution, self.ready_at, self.known, self.coasted = solution, self.now, None, ()
        self._publish(solution.x, solution.covariance)
        return solution.newest_gain

    # -- the hot path -----------------------------------------------------------------------------------

    def warm(self) -> None:
        """Go over to the hot path if nothing stands against it."""
        ring = self.engine
        if not isinstance(ring, PairRing) or ring.path is not None or self._P_handed is not None:
            return
        if ring.now == self.now == self.ready_at and self._anchored():
            self.mode, self.seen = WATCHED if self.watching else POSTED, ring.now
            if self.intake is None:
                self.intake, self.reading = intake(ring), 0
            if self.reading != self.form:
                (self.read, self.read_lagged), self.reading = ring.readers(self.form == 2), self.form
            self._choose_put()

    def coast(self) -> bool:
        """A step without an update always goes the slow path."""
        return self.mode == WATCHED and self._intact()

    def take(self, z: Any, R: Any = None, delay: int = 0) -> bool:
        """The hot path's update(); False, with nothing done, where the slow path is needed."""
        if self.mode != PREDICTED or R is not None or delay or self.intake is None or not self._intact():
            return False
        return self.intake(z)

    def hand_out_x(self) -> Array:
        """The state, editable; edits count from the next verb on."""
        if self._x_handed is None and self.mode and self.read is not None:
            x = self.read()
            if self.mode == PREDICTED:
                x = self.F.value.dot(x)
            self._x_handed, self._x_raw = x, x.tobytes()
            return x
        return super().hand_out_x()

    def hand_out_lagged(self) -> Array:
        """The lagged state as of the last update(), in the client's form, a copy."""
        if self.mode and self.read_lagged is not None:
            return self.read_lagged()
        return self.shaped(self.pair().x)

    def look(self) -> FMSState:
        """Work out what the hot path left out; every field is then what the slow path would have made it."""
        ring = self.engine
        if not self.mode or not isinstance(ring, PairRing):
            return self
        F, Q = self.F.value, self.Q.value
        if ring.now != self.seen:
            before, solution = ring.solve(before=1), ring.solve()
            self.prior = F @ before.x, before.covariance.predicted(F, Q, self.fading)
            self.post = solution.x, solution.covariance
            z, mask = ring.free[ring.end - 1].copy(), np.ones(self.dim_z, dtype=bool)
            self._last = (z, self.H.value, self.R.value, mask, *self.prior, solution.newest_gain, None)
            self.solution = solution
            self.now = self.seen = self.ready_at = self.lag_at = ring.now
            self.updated, self.lagged_then = True, None
        self.x, self.P = self.post
        if self.mode == PREDICTED:
            self.x, self.P = self.prior = F @ self.x, self.P.predicted(F, Q, self.fading)
        self.own_P = self.P
        if self._x_handed is not None:
            self.x = np.frombuffer(self._x_raw).copy()  # to the bit what the client was given
        return self

    def leave(self) -> None:
        """Leave the hot path."""
        if self.mode:
            self.look()
            if self.mode == PREDICTED:
                self.now += 1
                self.updated = False
            self.mode = SLOW

    # -- what the window says ---------------------------------------------------------------------------

    @property
    def ready(self) -> bool:
        """Whether the rows the window reaches determine the state."""
        if self.solution is None or self.engine is None:
            return False
        if self.ready_at == self.now or isinstance(self.engine, PairRing):
            return True
        return self.engine.select(self.limits) is not None

    def __deepcopy__(self, memo: dict[int, Any]) -> FMSState:
        self.settle()
        return self._forked(TORN)

    def __getstate__(self) -> dict[str, Any]:
        self.settle()
        return super().__getstate__() | dict.fromkeys((*TORN, "_x_handed", "_P_handed"))


def check_weight(R: Array) -> None:
    if not R.any():
        raise CovarianceError(
            "R must not be zero, because its inverse weights the rows of the window, got zeros; "
            "give the variance of the sensor's resolution"
        )
