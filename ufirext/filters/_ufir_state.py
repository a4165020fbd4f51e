"""What a UFIRFilter remembers and how it decides: warm-up, window, coasting, horizon."""

from __future__ import annotations

from typing import Any

import numpy as np

from .._arrays import Array, integer
from ..engines.covariance import Covariance
from ..engines.records import Limits, Records, Solution, negligible
from ..errors import HorizonError, UnobservableWindow
from ..gains import observability_index
from ..model import Model
from ..window import Row
from ._state import FilterState
from ._update import innovation_gain, joseph

# Horizon where the model determines none (it is unobservable at every horizon: the filter coasts).
FALLBACK_HORIZON = 10
MISSING = ("extend", "skip", "predict")
WINDOWS = ("arrivals", "origins")


class UFIRState(FilterState):
    """Records of what came, and least squares over the window of them; a Kalman filter until they suffice."""

    def __init__(self, dim_x: int, dim_z: int, horizon: int | str, missing: str, window: str) -> None:
        super().__init__(dim_x, dim_z)
        self.policy = horizon
        self.missing, self.by_arrival = missing, window == "arrivals"
        self.horizon: int | None = horizon if isinstance(horizon, int) else None
        self.index: int | None = None
        self.refreshed: int | None = None  # step at which the model was last looked at
        self.stale = True
        self.records: Records | None = None
        self.solution: Solution | None = None
        self.ready_at: int | None = None  # step of the last update that left the filter ready
        self.dropped = 0

    # -- horizon ----------------------------------------------------------------------------------------------

    def set_policy(self, horizon: int | str) -> None:
        """Another horizon, from the next verb on."""
        self.policy = horizon
        self.horizon = horizon if isinstance(horizon, int) else None
        self.refreshed, self.stale = None, True

    def refresh(self) -> None:
        """Look at the model: observability index, and the horizon where it is chosen from the model."""
        due = self.refreshed is None or (self.policy == "auto" and self.now - self.refreshed >= (self.horizon or 0))
        if not (self.stale and due):
            return
        model = Model(self.F.value, self.H.value, self.Q.value, self.R.value)
        self.index = observability_index(model)
        if self.policy == "auto":
            self.horizon = self._from_model(model)
        elif self.index is not None and self.horizon is not None and self.horizon < self.index:
            raise UnobservableWindow(
                f"horizon must be at least {self.index} for this model (the shortest window that determines its "
                f"{self.dim_x} states), got {self.horizon}; lengthen the horizon or measure another state",
                shortest=self.index,
            )
        self.refreshed, self.stale = self.now, False

    def _from_model(self, model: Model) -> int:
        from ..horizon import best_horizon

        return FALLBACK_HORIZON if self.index is None else best_horizon(model)

    @property
    def limits(self) -> Limits:
        """The window's rules now."""
        horizon = self.horizon or FALLBACK_HORIZON
        return Limits(horizon, (self.index or 1) + 2, self.missing != "skip", self.by_arrival)

    # -- hooks ------------------------------------------------------------------------------------------------

    def _model_changed(self) -> None:
        self.stale = True

    def _start(self, F: Array, Q: Array) -> Records:
        self.refresh()
        if self.records is None:
            self.records = Records(F, Q, self.now)
        return self.records

    def _advance(self, F: Array, Q: Array, known: Array | None) -> None:
        records = self._start(F, Q)
        records.advance(F, Q, known)

    def _moved(self, delta: Array) -> None:
        if self.records is not None:
            self.records.edit(delta, self.updated)

    def _absorb(self, z: Array, H: Array, R: Array, delay: int, cross: Array | None) -> Covariance | None:
        records = self._start(self.F.value, self.Q.value)
        row = Row(self.now - delay, self.now, H, R, z)
        if self._too_old(row):
            self.dropped += 1
            return None
        if negligible(row, records.rows):
            return None
        records.add(row)
        records.forget(self.limits)
        solution = self.solution = records.solve(self.limits)
        if solution is not None:
            self.ready_at = self.now
            self._publish(solution.x, solution.covariance)
            return Covariance(_newest_gain, (solution,))
        if delay:
            return Covariance.of(np.zeros((self.dim_x, len(z))))
        return self._kalman(z, H, R, cross)

    def _kalman(self, z: Array, H: Array, R: Array, cross: Array | None) -> Covariance:
        """The book's update, for as long as the rows do not determine the state."""
        P = self.P.value
        cross = None if cross is None or len(z) != cross.shape[1] else cross
        K, S = innovation_gain(P, H, R, cross)
        posterior = joseph(P, K, H, R) if cross is None else P - K @ S @ K.T
        self._publish(self.x + K @ (z - H @ self.x), Covariance.of(posterior))
        return Covariance.of(K)

    def _too_old(self, row: Row) -> bool:
        limits = self.limits
        oldest = self.now - (limits.reach if limits.by_arrival else limits.horizon)
        return row.origin <= oldest

    def _skip(self) -> None:
        records = self.records
        if self.missing == "extend" or records is None:
            return
        if self.missing == "predict" and self.ready:
            z = self.H.value @ self.x
            records.add(Row(self.now, self.now, self.H.value, self.R.value, z))
            self.ready_at = self.now
            return
        records.forget(self.limits)
        solution = self.solution = records.solve(self.limits)
        if solution is not None:
            self.ready_at = self.now
            self._publish(solution.x, solution.covariance)

    # -- what the window says ---------------------------------------------------------------------------------

    @property
    def ready(self) -> bool:
        """Whether the rows the window reaches determine the state."""
        if self.solution is None or self.records is None:
            return False
        return self.ready_at == self.now or self.records.select(self.limits) is not None

    def lagged(self, lag: int) -> tuple[Array, Covariance]:
        """The state `lag` steps ago from the window."""
        limits = self.limits
        lag = integer(lag, "lag", 0, limits.horizon - 1, "the window holds horizon states")
        if lag == 0:
            return self.x, self.P
        solution = None if self.records is None else self.records.solve(limits, lag)
        if solution is None:
            raise UnobservableWindow(
                f"the rows of the window must determine the state {lag} steps ago, they do not (yet); "
                "feed more measurements, or lengthen the horizon"
            )
        return solution.x, solution.covariance

    def __deepcopy__(self, memo: dict[int, Any]) -> UFIRState:
        self.settle()
        return _copied(self)


def _newest_gain(solution: Solution) -> Array:
    return solution.newest_gain


def _copied(state: UFIRState) -> UFIRState:
    import copy

    fork = object.__new__(type(state))
    shared = {"records", "solution", "last", "prior", "post", "P", "x"}
    fork.__dict__.update({k: v if k in shared else copy.deepcopy(v) for k, v in state.__dict__.items()})
    fork._x_handed = fork._P_handed = None
    if state.records is not None:
        fork.records = state.records.copy()
    return fork


def checked_horizon(horizon: Any) -> int | str:
    """An int of at least 1, "auto" or "adaptive"."""
    if isinstance(horizon, str):
        if horizon not in ("auto", "adaptive"):
            raise HorizonError(f'horizon must be an integer, "auto" or "adaptive", got {horizon!r}')
        return horizon
    return integer(horizon, "horizon", 1, advice='give a count of steps, "auto" or "adaptive"')
