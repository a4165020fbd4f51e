"""What a UFIRFilter remembers and how it decides: warm-up, window, coasting, horizon."""

from __future__ import annotations

from typing import Any

import numpy as np

from .._arrays import Array, integer, lag_within
from ..engines.covariance import Covariance
from ..engines.plan import plan
from ..engines.records import Limits, Records, Solution
from ..engines.ring import Ring
from ..engines.varying import Varying
from ..errors import HorizonError, UnobservableWindow
from ..gains import observability_index
from ..model import Model
from ..window import Row
from ._engine_state import EngineState

# Horizon where the model determines none (it is unobservable at every horizon: the filter coasts).
FALLBACK_HORIZON = 10
# Variance of a measurement with R = 0, beside the largest of the others: its information is not so much more
# that theirs is negligible.
EXACT = 1e-7
MISSING = ("extend", "skip", "predict")
WINDOWS = ("arrivals", "origins")


class WindowState(EngineState):
    """Least squares over the window of what came; a Kalman filter until the rows suffice."""

    def __init__(self, dim_x: int, dim_z: int, horizon: int | str, missing: str, window: str) -> None:
        super().__init__(dim_x, dim_z)
        self.policy = horizon
        self.missing, self.by_arrival = missing, window == "arrivals"
        self.horizon: int | None = horizon if isinstance(horizon, int) else None
        self.index: int | None = None
        self.refreshed: int | None = None  # step at which the model was last looked at
        self.stale = True
        self.engine: Ring | Records | None = None
        self.anchor: tuple[Array, ...] = ()  # F, H, Q, R the ring was made for
        self.looked_at: tuple[Array, Array] | None = None  # F and H whose observability `index` tells
        self.irregular = -1  # newest step at which something came that a ring cannot hold
        self.solution: Solution | None = None
        self.ready_at: int | None = None  # step of the last update that left the filter ready
        self.dropped = 0
        self._limits = Limits(1, 1, True, True)
        self._limits_of: tuple[int | None, int | None] | None = None

    # -- horizon -------------------------------------------------------------------------------------------

    def set_policy(self, horizon: int | str) -> None:
        """Another horizon, from the next verb on."""
        self.policy = horizon
        self.horizon = horizon if isinstance(horizon, int) else None
        self.refreshed, self.stale = None, True
        self._to_records()

    def refresh(self) -> None:
        """Look at the model: observability index, and the horizon where it is chosen from the model."""
        due = self.refreshed is None or (
            self.policy == "auto" and self.now - self.refreshed >= (self.horizon or 0)
        )
        if not (self.stale and due):
            return
        model = self.model()
        self.index, self.looked_at = observability_index(model), (self.F.value, self.H.value)
        if self.policy == "auto":
            horizon = _from_model(model, self.index)
            if horizon != self.horizon:
                self._to_records()
            self.horizon = horizon
        elif self.index is not None and self.horizon is not None and self.horizon < self.index:
            raise UnobservableWindow(
                f"horizon must be at least {self.index} for this model (the shortest window that "
                f"determines its {self.dim_x} states), got {self.horizon}; "
                "lengthen the horizon or measure another state",
                shortest=self.index,
            )
        self.refreshed, self.stale = self.now, False

    @property
    def limits(self) -> Limits:
        """The window's rules now."""
        key = (self.horizon, self.index)
        if self._limits_of != key:
            horizon = self.horizon or FALLBACK_HORIZON
            self._limits = Limits(horizon, (self.index or 1) + 2, self.missing != "skip", self.by_arrival)
            self._limits_of = key
        return self._limits

    # -- engines ---------------------------------------------------------------------------------------------

    def _start(self, F: Array, Q: Array) -> Ring | Records:
        """The engine in charge, chosen when the first verb needs one, or when the past has become regular."""
        if self.stale:
            self.refresh()
        engine = self.engine
        if engine is None:
            engine = self.engine = self._ring(self.now) if self._regular(F, Q) else self._general(F, Q)
        elif isinstance(engine, Varying) and engine.limits != self.limits:
            engine = self.engine = self._over(engine)
        elif (
            isinstance(engine, Records)
            and self.index is not None
            and self.now - self.irregular > engine_reach(self.limits)
        ):
            self.irregular = self.now  # look again after another reach, whatever comes of it
            if self._regular(F, Q) and observability_index(self.model()) is not None:
                ring = self._ring(self.now)
                if ring.adopt(engine):
                    engine = self.engine = ring
        return engine

    def _general(self, F: Array, Q: Array) -> Records:
        return Varying(F, Q, self.now, self.limits)

    def _over(self, records: Records) -> Records:
        return Varying.over(records, self.limits)

    def _regular(self, F: Array, Q: Array) -> bool:
        return F is self.F.value and Q is self.Q.value and self.index is not None

    def _ring(self, now: int) -> Ring:
        self.anchor = (self.F.value, self.H.value, self.Q.value, self.R.value)
        return Ring(plan(self.model(), self.limits.horizon), self.limits, now)

    def _to_records(self) -> Records | None:
        if isinstance(self.engine, Ring):
            self.engine = self._over(self.engine.records())
        self.irregular = self.now
        return self.engine

    # -- hooks -----------------------------------------------------------------------------------------------

    def _model_changed(self) -> None:
        self.stale, self.irregular = True, self.now

    def _advance(self, F: Array, Q: Array, known: Array | None) -> None:
        engine = self._start(F, Q)
        if isinstance(engine, Ring):
            if F is self.anchor[0] and Q is self.anchor[2]:
                engine.advance(known)
                return
            engine = self.engine = self._over(engine.records())
        if not (F is self.F.value and Q is self.Q.value and known is None):
            self.irregular = self.now
        engine.advance(F, Q, known)

    def _moved(self, delta: Array) -> None:
        if self.engine is not None:
            self.irregular = self.now
            self.engine.edit(delta, self.updated)

    def _absorb(self, z: Array, H: Array, R: Array, delay: int, cross: Array | None) -> Covariance | None:
        engine = self._start(self.F.value, self.Q.value) if self.engine is None or self.stale else self.engine
        if delay and self._too_old(delay):
            self.dropped += 1
            return None
        if isinstance(engine, Varying) and self.ready_at is not None and self.ready_at < self.now - 1:
            # The window these lean on may be forgotten when the row comes in.
            self.P.value, self.post[1].value
        counted, solution = self._add(engine, z, H, self._weighable(engine, R), delay)
        return self._concluded(solution, z, H, R, delay, cross) if counted else None

    def _weighable(self, engine: Ring | Records, R: Array) -> Array:
        """R, or what an exact measurement is taken for among others that are not: all the same if all are."""
        if R[0, 0] != 0.0 or R.any() or (isinstance(engine, Ring) and R is self.anchor[3]):
            return R
        others = (self.R.value, *(row.R for row in self._as_records().rows))
        return np.eye(len(R)) * (EXACT * max(float(other.diagonal().max()) for other in others))

    def _concluded(
        self, solution: Solution | None, z: Array, H: Array, R: Array, delay: int, cross: Array | None = None
    ) -> Covariance:
        """Publish what the window says with its new row; the gain on that."""
        self.solution = solution
        if solution is not None:
            self.ready_at = self.now
            self._publish(solution.x, solution.covariance)
            return solution.newest_gain
        if delay:
            return Covariance.of(np.zeros((self.dim_x, len(z))))
        return self._kalman(z, H, R, cross)

    def _add(
        self, engine: Ring | Records, z: Array, H: Array, R: Array, delay: int
    ) -> tuple[bool, Solution | None]:
        """The row into the engine: whether it says anything beside the others, and the solution if any."""
        if isinstance(engine, Ring):
            if not delay and H is self.anchor[1] and R is self.anchor[3] and engine.add_plain(z):
                return True, engine.solve()
            model = engine.plan.model
            ours = model.H if H is self.anchor[1] else H, model.R if R is self.anchor[3] else R
            row = Row(self.now - delay, self.now, *ours, z)
            if engine.negligible(row):
                return False, None
            if engine.add(row):
                return True, engine.solve()
            engine = self.engine = self._over(engine.records())
        row = Row(self.now - delay, self.now, H, R, z)
        if engine.negligible(row, self.limits):
            return False, None
        again = bool(engine.rows) and engine.rows[-1].arrival == self.now
        if delay or again or H is not self.H.value or R is not self.R.value:
            self.irregular = self.now
        engine.add(row)
        engine.forget(self.limits)
        return True, None if self._hopeless(engine) else engine.solve(self.limits)

    def _hopeless(self, engine: Records) -> bool:
        """Whether all rows in reach are of a model that no horizon determines."""
        if self.index is not None or self.looked_at is None:
            return False
        F, H = self.looked_at
        return F is self.F.value and H is self.H.value and engine.rows[0].arrival > self.irregular

    def _too_old(self, delay: int) -> bool:
        limits = self.limits
        return delay >= (limits.reach if limits.by_arrival else limits.horizon)

    def _skip(self) -> None:
        engine = self.engine
        if self.missing == "extend" or engine is None:
            return
        if self.missing == "predict":
            if not self.ready:
                return
            _, solution = self._add(engine, self.H.value @ self.x, self.H.value, self.R.value, 0)
        else:
            solution = engine.solve() if isinstance(engine, Ring) else engine.solve(self.limits)
        self.solution = solution
        if solution is not None:
            self.ready_at = self.now
            self._publish(solution.x, solution.covariance)

    @property
    def plain(self) -> bool:
        """Whether this is one window that nothing has entered yet, and steps do nothing of their own."""
        fresh = self.engine is None and self.now == 0
        return fresh and self.policy != "adaptive" and self.missing == "extend" and self.fading == 1.0

    # -- what the window says --------------------------------------------------------------------------------

    @property
    def ready(self) -> bool:
        """Whether the rows the window reaches determine the state."""
        if self.solution is None or self.engine is None:
            return False
        return self.ready_at == self.now or self._as_records().select(self.limits) is not None

    def _as_records(self) -> Records:
        engine = self.engine
        if engine is None:
            return Records(self.F.value, self.Q.value, self.now)
        return engine.records() if isinstance(engine, Ring) else engine

    def lagged(self, lag: int) -> tuple[Array, Covariance]:
        """The state `lag` steps ago from the window."""
        limits = self.limits
        lag = lag_within(limits.horizon, lag)
        if lag == 0:
            return self.x, self.P
        solution = self._as_records().solve(limits, lag)
        if solution is None:
            raise UnobservableWindow(
                f"the rows of the window must determine the state {lag} steps ago, they do not (yet); "
                "feed more measurements, or lengthen the horizon"
            )
        return solution.x, solution.covariance


def engine_reach(limits: Limits) -> int:
    """Steps after which nothing irregular is within any window's reach, late rows included."""
    return 2 * limits.reach + 1


def _from_model(model: Model, index: int | None) -> int:
    from ..horizon import best_horizon

    return FALLBACK_HORIZON if index is None else best_horizon(model)


def checked_horizon(horizon: Any) -> int | str:
    """An int of at least 1, "auto" or "adaptive"."""
    if isinstance(horizon, str):
        if horizon not in ("auto", "adaptive"):
            raise HorizonError(f'horizon must be an integer, "auto" or "adaptive", got {horizon!r}')
        return horizon
    return integer(horizon, "horizon", 1, advice='give a count of steps, "auto" or "adaptive"')
