"""What a UFIRFilter remembers and how it decides: warm-up, window, coasting, horizon, and the hot path's
laziness.
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from .._arrays import Array, integer
from ..engines.covariance import Covariance
from ..engines.plan import Plan, plan
from ..engines.records import Limits, Records, Solution
from ..engines.ring import GROWING_GAINS, Ring
from ..engines.varying import Varying
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
# The hot path: a constant model, a window without holes, nothing written from outside. Then predict() only
# moves
# `mode` from POSTED to PREDICTED, update() only stores z, and x is worked out when it is read.
SLOW, POSTED, PREDICTED = 0, 1, 2


class UFIRState(FilterState):
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
        self.irregular = 0  # newest step at which something came that a ring cannot hold
        self.solution: Solution | None = None
        self.ready_at: int | None = None  # step of the last update that left the filter ready
        self.dropped = 0
        self.mode = SLOW
        self._limits = Limits(1, 1, True, True)
        self._limits_of: tuple[int | None, int | None] | None = None
        self.lazy = False  # x is worked out when it is read
        self.hot_x: Array | None = None  # x after the last hot update, unless lazy
        self.product: Any = None  # G.dot of the full window
        self.views: list[
            Array | None
        ] = []  # the full window that ends at each slot: looking up beats slicing
        self.seen = 0  # step up to which the published fields are worked out

    # -- horizon ---------------------------------------------------------------------------------------------

    def write_x(self, value: Any) -> None:
        """x assigned from outside; its form becomes the client's form."""
        form = self.form
        super().write_x(value)
        if self.form != form:
            self.product = None  # the views have the old form

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
        model = self._model()
        self.index = observability_index(model)
        if self.policy == "auto":
            horizon = _from_model(model, self.index)
            if horizon != self.horizon:
                self._to_records()
            self.horizon = horizon
        elif self.index is not None and self.horizon is not None and self.horizon < self.index:
            raise UnobservableWindow(
                f"horizon must be at least {self.index} for this model (the shortest window that determines its "
                f"{self.dim_x} states), got {self.horizon}; lengthen the horizon or measure another state",
                shortest=self.index,
            )
        self.refreshed, self.stale = self.now, False

    def _model(self) -> Model:
        return Model(self.F.value, self.H.value, self.Q.value, self.R.value)

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
        elif isinstance(engine, Records) and self.now - self.irregular > engine_reach(self.limits):
            self.irregular = self.now  # look again after another reach, whatever comes of it
            if self._regular(F, Q):
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
        self.product = None
        self.anchor = (self.F.value, self.H.value, self.Q.value, self.R.value)
        return Ring(plan(self._model(), self.limits.horizon), self.limits, now)

    def _to_records(self) -> Records | None:
        if isinstance(self.engine, Ring):
            self.engine = self._over(self.engine.records())
        self.irregular = self.now
        return self.engine

    # -- hooks -----------------------------------------------------------------------------------------------

    def _model_changed(self) -> None:
        self.stale = True

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
        solution = self._add(engine, z, H, R, delay)
        if solution is False:
            return None
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
    ) -> Solution | bool | None:
        """The row into the engine: the solution, None where there is none yet, False for a row that says
        nothing.
        """
        if isinstance(engine, Ring):
            if not delay and H is self.anchor[1] and R is self.anchor[3] and engine.add_plain(z):
                return engine.solve()
            model = engine.plan.model
            row = Row(
                self.now - delay,
                self.now,
                model.H if H is self.anchor[1] else H,
                model.R if R is self.anchor[3] else R,
                z,
            )
            if engine.negligible(row):
                return False
            if engine.add(row):
                return engine.solve()
            engine = self.engine = self._over(engine.records())
        row = Row(self.now - delay, self.now, H, R, z)
        if engine.negligible(row):
            return False
        if (
            delay
            or not (H is self.H.value and R is self.R.value)
            or (engine.rows and engine.rows[-1].arrival == self.now)
        ):
            self.irregular = self.now
        engine.add(row)
        engine.forget(self.limits)
        return engine.solve(self.limits)

    def _kalman(self, z: Array, H: Array, R: Array, cross: Array | None) -> Covariance:
        """The book's update, for as long as the rows do not determine the state."""
        P = self.P.value
        cross = None if cross is None or len(z) != cross.shape[1] else cross
        K, S = innovation_gain(P, H, R, cross)
        posterior = joseph(P, K, H, R) if cross is None else P - K @ S @ K.T
        self._publish(self.x + K @ (z - H @ self.x), Covariance.of(posterior))
        return Covariance.of(K)

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
            solution = self._add(engine, self.H.value @ self.x, self.H.value, self.R.value, 0)
        else:
            solution = engine.solve() if isinstance(engine, Ring) else engine.solve(self.limits)
        self.solution = solution or None
        if solution:
            self.ready_at = self.now
            self._publish(solution.x, solution.covariance)

    # -- the hot path ----------------------------------------------------------------------------------------

    def warm(self) -> None:
        """Go over to the hot path if nothing stands against it."""
        ring = self.engine
        if (
            isinstance(ring, Ring)
            and ring.raw is None
            and self.ready_at == self.now
            and self.missing == "extend"
            and not self.watching
            and self._P_handed is None
            and not self.stale
        ):
            self.mode, self.seen = POSTED, ring.now
            self._choose_product(ring)
            self.hot_x = None if self.lazy else self.shaped(self.x)

    def _choose_product(self, ring: Ring) -> None:
        """Whether x can wait until it is read: a full window without holes is one product."""
        self.lazy = ring.length == ring.limits.horizon and ring.plain
        if self.lazy and self.product is None:
            gain = ring.plan.gain(ring.limits.horizon)
            self.product = None if gain is None else gain.dot
            self.views = [None] * (ring.capacity + 1)
            self.lazy = self.product is not None

    def take(self, z: Any) -> bool:
        """The hot path's update(); False, with nothing done, where the slow path is needed."""
        ring: Ring = self.engine  # type: ignore[assignment]
        if z is None:
            if ring.now - self.seen >= ring.limits.horizon:
                return False
            x = self.F.value.dot(self.posted_x())
            ring.hole()
            self.hot_x, self.lazy = x, False
            return True
        if not ring.store(z):
            return False
        if self.lazy:
            return True
        if ring.plain:
            length = ring.length
            if length == ring.limits.horizon:
                self._choose_product(ring)
                if self.lazy:
                    return True
            if length <= GROWING_GAINS:
                gain = ring.plan.gain(length)
                flat = (
                    None
                    if gain is None
                    else gain.dot(ring.flat[(ring.end - length) * self.dim_z : ring.end * self.dim_z])
                )
            else:
                flat = ring.hot_estimate()
        else:
            flat = ring.hot_estimate()
        return self._posted(ring, flat)

    def take_weighted(self, z: Any, R: Any) -> bool:
        """The hot path's update() with an R that is a multiple of the model's."""
        ring: Ring = self.engine  # type: ignore[assignment]
        weight = ring.quick_weight(R)
        if weight is None or z is None or not ring.store(z):
            return False
        irregular = ring.irregular
        ring.weigh(weight, np.asarray(R, dtype=float))
        if self._posted(ring, ring.hot_estimate()):
            self.lazy = False
            return True
        ring.irregular = irregular
        return False

    def _posted(self, ring: Ring, flat: Array | None) -> bool:
        if flat is None:
            ring.unstore()
            return False
        self.hot_x = flat.reshape(-1, 1) if self.form == 2 else flat
        return True

    def posted_x(self) -> Array:
        """x after the last update on the hot path, in the client's form."""
        if self.lazy:
            ring: Ring = self.engine  # type: ignore[assignment]
            view = self.views[ring.end]
            if view is None:
                view = self.views[ring.end] = ring.view(self.form)
            return self.product(view)  # type: ignore[no-any-return]
        return self.hot_x  # type: ignore[return-value]

    def hand_out_x(self) -> Array:
        """The state, editable; edits count from the next verb on."""
        if self._x_handed is None and self.mode:
            x = self.posted_x()
            if self.mode == PREDICTED:
                x = self.F.value.dot(x)
            elif not self.lazy:
                x = x.copy()
            self._x_handed, self._x_raw = x, x.tobytes()
            return x
        return super().hand_out_x()

    def look(self) -> UFIRState:
        """Work out what the hot path left out; every field is then what the slow path would have made it."""
        if not self.mode:
            return self
        ring: Ring = self.engine  # type: ignore[assignment]
        F, Q, now = self.F.value, self.Q.value, ring.now
        if now != self.seen:
            before, P_before = self._stood(now - 1)
            x, P = self._stood(now)
            came = bool(ring.arrivals[ring.end - 1] == now)
            self.prior = F @ before, P_before.predicted(F, Q, self.fading)
            self.post = (x, P) if came else self.prior
            mask = np.full(self.dim_z, came)
            none = Covariance.of(np.zeros((self.dim_x, 0)))
            gain = self.solution.newest_gain if came and self.solution is not None else none
            row = ring.odd.get(now)
            z = (ring.free[ring.end - 1].copy() if row is None else row.z) if came else None
            R = self.R.value if row is None else row.R
            self._last = (z, self.H.value, R, mask, *self.prior, gain, None)
            self.now = self.seen = now
            self.updated = True
        self.x, self.P = self.post
        if self.mode == PREDICTED:
            self.x, self.P = self.prior = F @ self.x, self.P.predicted(F, Q, self.fading)
        if self._x_handed is not None:
            self.x = np.frombuffer(self._x_raw).copy()  # to the bit what the client was given
        return self

    def _stood(self, step: int) -> tuple[Array, Covariance]:
        """x and P after the update of a step on the hot path."""
        ring: Ring = self.engine  # type: ignore[assignment]
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

    def settle(self) -> None:
        """Leave the hot path, and honour everything that was edited in place since the last verb."""
        if self.mode:
            self.look()
            if self.mode == PREDICTED:
                self.engine.advance(None)  # type: ignore[union-attr, call-arg]
                self.now += 1
                self.updated = False
            self.mode = SLOW
        super().settle()

    # -- what the window says --------------------------------------------------------------------------------

    @property
    def ready(self) -> bool:
        """Whether the rows the window reaches determine the state."""
        if self.mode:
            return True
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
        lag = integer(lag, "lag", 0, limits.horizon - 1, "the window holds horizon states")
        if lag == 0:
            return self.x, self.P
        solution = self._as_records().solve(limits, lag)
        if solution is None:
            raise UnobservableWindow(
                f"the rows of the window must determine the state {lag} steps ago, they do not (yet); "
                "feed more measurements, or lengthen the horizon"
            )
        return solution.x, solution.covariance

    def __deepcopy__(self, memo: dict[int, Any]) -> UFIRState:
        self.settle()
        fork = object.__new__(type(self))
        live = {"F", "H", "Q", "R", "M", "B"}
        fork.__dict__.update({k: copy.deepcopy(v) if k in live else v for k, v in self.__dict__.items()})
        fork._x_handed = fork._P_handed = fork.product = None
        if self.engine is not None:
            fork.engine = self.engine.copy()
            fork.anchor = tuple(
                getattr(fork, name).value if old is getattr(self, name).value else old
                for name, old in zip("FHQR", self.anchor, strict=False)
            )
        return fork

    def __getstate__(self) -> dict[str, Any]:
        self.settle()
        return {**self.__dict__, "_x_handed": None, "_P_handed": None, "product": None, "views": []}


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


__all__ = ["MISSING", "POSTED", "PREDICTED", "WINDOWS", "Plan", "UFIRState", "checked_horizon"]
