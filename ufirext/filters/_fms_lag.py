"""What an FMSFilterSmoother knows of older states: from its window, or since its Kalman filter began."""

from __future__ import annotations

from .._arrays import Array, lag_within
from ..engines.covariance import Covariance
from ..engines.pairs import PairRing
from ..engines.segmented import Lagged, Prior, Segmented
from ..errors import UnobservableWindow
from ._engine_state import EngineState


class LaggedState(EngineState):
    """A window's state object with the states of older steps, as of the last update()."""

    def __init__(self, dim_x: int, dim_z: int, horizon: int, lag: int) -> None:
        super().__init__(dim_x, dim_z)
        self.horizon, self.lag = horizon, lag
        self.engine: Segmented | PairRing | None = None
        self.known: Prior | None = None  # what the Kalman filter of the warm-up started from
        self.own_P: Covariance | None = self.P  # unless it was written from outside
        self.coasted: tuple[tuple[int, Array, Covariance], ...] = ()  # predictions since the last row
        self.lag_at = 0  # step of the last update
        self.lagged_then: Lagged | None = None  # of the last update, once somebody asked

    # -- verbs ------------------------------------------------------------------------------------------

    def predict(self, F: Array, Q: Array, known: Array | None) -> None:
        """Time update by F, Q and a known change of the state."""
        written = self.P is not self.own_P
        super().predict(F, Q, known)
        if written:
            self.own_P = None  # until update() sees it: the lagged state is that of the last one
        if self.known is None:
            self.coasted = (*self.coasted, (self.now, self.x, self.P))[-self.horizon :]

    def update(
        self, z: Array | None, H: Array, R: Array, delay: int, cross: Array | None = None, whole: bool = False
    ) -> None:
        """Measurement update; z flat with NaN for missing components, or None."""
        if self.P is not self.own_P:
            self._told()
        self.lag_at, self.lagged_then = self.now, None
        super().update(z, H, R, delay, cross, whole)

    def _told(self) -> None:
        """P was written: what was predicted before says nothing any more."""
        self.coasted = ()
        if not self.updated:
            self.own_P = self.P
            if self.known is not None:
                self.known = Prior(self.now, self.x, self.P.value)

    def _moved(self, delta: Array) -> None:
        if self.coasted and not self.updated:
            self.coasted = (*self.coasted[:-1], (self.now, self.x, self.P))

    def _lost(self) -> None:
        """The window does not determine the state any more: the Kalman filter takes over, if it has not yet.

        It begins as long ago as it may, so that it knows the lagged states too.
        """
        if self.known is None:
            time, x, P = self.coasted[0] if self.coasted else (self.now, self.x, self.P)
            self.known = Prior(time, x, P.value)

    def _publish(self, x: Array, P: Covariance) -> None:
        super()._publish(x, P)
        self.own_P = P

    # -- older states -----------------------------------------------------------------------------------

    def _folds(self) -> Segmented:
        """The engine for everything that a ring cannot hold."""
        raise NotImplementedError

    def pair(self) -> Lagged:
        """The lagged state as of the last update()."""
        ring = self.engine
        if self.mode and isinstance(ring, PairRing):
            return ring.lagged()
        if self.lagged_then is None:
            aim = self.lag_at - self.lag
            self.lagged_then = self._lagged(aim if aim > 0 else max(aim, self._oldest()))
        return self.lagged_then

    def lagged(self, lag: int) -> Lagged:
        """The state `lag` steps before the last update(), from everything that had come by then."""
        lag = lag_within(self.horizon, lag)
        return self.pair() if lag == self.lag < self.lag_at else self._lagged(self.lag_at - lag)

    def _oldest(self) -> int:
        """The oldest step of which the filter knows something in the first steps."""
        engine = self.engine
        if self.known is not None:
            return min(self.known.time, self.lag_at)
        if isinstance(engine, Segmented) and engine.start is not None:
            return engine.start
        return self.lag_at if engine is None else self.lag_at - self.horizon + 1

    def _lagged(self, aim: int) -> Lagged:
        """The state at the step `aim` as of the last update()."""
        engine = self.engine
        if aim == self.lag_at:
            x, P = (self.x, self.P) if self._last is None else self.post
            return Lagged(x, P.value, P.value)
        if isinstance(engine, PairRing):
            if aim == self.lag_at - self.lag and engine.now == self.lag_at:
                return engine.lagged()
            engine = self._folds()
        found = None if engine is None else engine.lagged(aim, self.lag_at, self.known)
        if found is None:
            raise UnobservableWindow(
                f"the window must determine the state {self.lag_at - aim} steps before the last update, it "
                f"does not (yet); feed more measurements, shorten the lag or lengthen the horizon"
            )
        return found
