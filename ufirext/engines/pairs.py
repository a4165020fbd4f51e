"""The engine of a constant model for pairs of states: one product gives the newest state and a lagged one.

It holds a full window of plain rows, one a step; anything else is for the folds.
"""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from .._arrays import Array, readonly
from ..errors import UnobservableWindow
from ..gains import observability_index
from ..joint import Joint, joint_gain
from ..model import Model
from ..window import Row, model_window
from .covariance import Covariance
from .records import Solution
from .segmented import Lagged, Segmented

__all__ = ["PairPlan", "PairRing", "pair_plan", "reach"]

FLOAT = np.dtype(float)


class PairPlan:
    """The joint gain of a constant model's full window, computed when first needed and shared."""

    def __init__(self, model: Model, horizon: int, lag: int) -> None:
        self.model, self.horizon, self.lag = model, horizon, lag

    def __reduce__(self) -> tuple[object, ...]:
        return (pair_plan, (self.model, self.horizon, self.lag))

    @cached_property
    def joint(self) -> Joint:
        """Gain and covariance of [x_n; x_{n-lag}], (2 dim_x, horizon dim_z) and (2 dim_x, 2 dim_x)."""
        joint = joint_gain(model_window(self.model, self.horizon, self.lag))
        K = readonly(np.ascontiguousarray(joint.K))
        return Joint(K, joint.L, joint.prior, readonly(joint.P))

    @cached_property
    def P(self) -> Covariance:
        """Error covariance of x_n."""
        return Covariance.of(self.joint.P[: self.model.dim_x, : self.model.dim_x])

    @cached_property
    def newest_gain(self) -> Covariance:
        """Gain of x_n on the newest row."""
        return Covariance.of(self.joint.K[: self.model.dim_x, -self.model.dim_z :])


class PairRing:
    """The last measurements of a constant model in a buffer whose window moves by one slot a row."""

    def __init__(self, plan: PairPlan, rows: Array, now: int) -> None:
        self.plan, m = plan, plan.model.dim_z
        horizon = plan.horizon
        # One slot more than the window: the estimate before the newest row can still be asked for.
        self.keep = horizon + 1
        self.capacity = self.keep + max(horizon, 256)
        self.free = np.zeros((self.capacity, m))
        self.free[1 : self.keep] = rows
        self.end, self.base = self.keep, now - horizon
        self.single, self.ones = m == 1, np.ones(m)
        self._prepare()

    def _prepare(self) -> None:
        self.flat = self.free.reshape(-1)
        self.product = self.plan.joint.K.dot
        self.size = self.plan.model.dim_x
        self.views: list[Array] = []
        self.form = 0
        self.older = (
            -1,
            self.free,
        )  # where the window ended when the lagged state was worked out, and that state

    @classmethod
    def of(cls, plan: PairPlan, engine: Segmented) -> PairRing | None:
        """A ring with the engine's past, if that ends in a full window of plain rows."""
        model, first = plan.model, engine.now - plan.horizon + 1
        rows = engine.rows[-plan.horizon :]
        if [row.origin for row in rows] != list(range(first, engine.now + 1)) or engine.after is not None:
            return None
        for row in rows:
            plain = row.arrival == row.origin and row.shift is None
            if not (plain and np.array_equal(row.H, model.H) and np.array_equal(row.R, model.R)):
                return None
        for step in (engine.step(row.origin) for row in rows[1:]):
            same = np.array_equal(step.F, model.F) and np.array_equal(step.Q, model.Q)
            if not same or step.known is not None:
                return None
        return cls(plan, np.array([row.z for row in rows]), engine.now)

    @property
    def now(self) -> int:
        """Step of the newest row."""
        return self.base + self.end - 1

    def store(self, z: Any) -> bool:
        """A measurement of the next step, if it is a plain finite one in floats; else nothing is done."""
        i = self.end
        try:
            if self.single:
                value = z if type(z) is float else z.item()
                if value - value != 0.0:
                    return False
                self.flat[i] = value
            else:
                if z.dtype is not FLOAT or z.size != self.free.shape[1] or z.ndim > 2:
                    return False
                self.free[i] = z if z.ndim == 1 else z.reshape(-1)
                total = self.ones.dot(self.free[i])
                if total - total != 0.0:
                    return False
        except (AttributeError, TypeError, ValueError):
            return False
        self.end = i + 1
        if self.end == self.capacity:
            self.free[: self.keep] = self.free[self.end - self.keep :].copy()
            self.base, self.end = self.base + self.end - self.keep, self.keep
        return True

    def newest(self, form: int) -> Array:
        """x_n in the client's form, for the client to keep; the same product leaves x_{n-lag} behind."""
        if form != self.form:
            self._view(form)
        pair: Array = self.product(self.views[self.end])
        self.older = self.end, pair
        return pair[: self.size]

    def _view(self, form: int) -> None:
        horizon, shape = self.plan.horizon, (-1, 1) if form == 2 else (-1,)
        self.views = [
            self.free[max(stop - horizon, 0) : stop].reshape(shape) for stop in range(self.capacity)
        ]
        self.form, self.older = form, (-1, self.free)

    def oldest(self, form: int) -> Array:
        """x_{n-lag} in the client's form, a copy."""
        if self.older[0] != self.end or form != self.form:
            self.newest(form)
        return self.older[1][self.size :].copy()

    def solve(self, before: int = 0) -> Solution:
        """The newest state as of the newest row, or of the row before it."""
        gain = self.plan.newest_gain
        return Solution(self._pair(before)[: self.size], self.plan.P, gain, gain, self.plan.horizon)

    def lagged(self) -> Lagged:
        """The lagged state as of the newest row."""
        n, P = self.size, self.plan.joint.P
        return Lagged(self._pair(0)[n:], P[n:, n:], P[:n, n:])

    def _pair(self, before: int) -> Array:
        rows = self.free[self.end - before - self.plan.horizon : self.end - before]
        pair: Array = self.product(rows.reshape(-1))
        return pair

    def segmented(self) -> Segmented:
        """The rows of the window for the engine of windows of any kind, around a trajectory close to them."""
        model, low = self.plan.model, self.end - self.plan.horizon
        engine = Segmented(model.F, model.Q, self.base + low, self._near(low))
        gain = self.plan.newest_gain.value
        for i in range(low, self.end):
            if i > low:
                engine.advance(model.F, model.Q, None)
            z = self.free[i].copy()
            engine.add(Row(engine.now, engine.now, model.H, model.R, z))
            engine.center = engine.center + gain @ (z - model.H @ engine.center)
        return engine

    def _near(self, low: int) -> Array:
        """A state that explains the first measurements of the window."""
        model = self.plan.model
        head = model_window(model, min(model.dim_x, self.plan.horizon))
        z = self.free[low : low + len(head.H)] @ head.W[0].T
        scaled = np.linalg.lstsq(head.C / head.scale, z.reshape(-1), rcond=1e-8)[0]
        return np.asarray(scaled / head.scale)

    def copy(self) -> PairRing:
        """An independent copy."""
        fork = object.__new__(type(self))
        fork.__dict__.update(self.__dict__)
        fork.free = self.free.copy()
        fork._prepare()
        return fork

    def __getstate__(self) -> dict[str, Any]:
        torn = {"flat", "product", "views", "form", "older"}
        return {name: value for name, value in self.__dict__.items() if name not in torn}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._prepare()


@lru_cache(maxsize=128)
def pair_plan(model: Model, horizon: int, lag: int) -> PairPlan:
    """The shared plan of a model, a horizon and a lag."""
    return PairPlan(model, horizon, lag)


def reach(model: Model, horizon: int, lag: int) -> int | None:
    """The shortest horizon that determines the newest state, None where none does.

    Raises
    ------
    UnobservableWindow
        If the window given can never determine the newest state or the lagged one, though a longer one could.
    """
    shortest = observability_index(model)
    if shortest is None:
        return None
    if horizon < shortest:
        raise UnobservableWindow(
            f"horizon must be at least {shortest} for this model (the shortest window that determines its "
            f"{model.dim_x} states), got {horizon}; lengthen the horizon or measure another state",
            shortest=shortest,
        )
    if lag and not model_window(model, horizon, lag).determined():
        raise UnobservableWindow(
            f"a window of {horizon} steps must determine the state {lag} steps ago, it cannot; "
            f"shorten the lag, lengthen the horizon or measure another state"
        )
    return shortest
