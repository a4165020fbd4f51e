"""The engine of a constant model for pairs of states: one product gives the newest state and a lagged one.

It holds a full window of plain rows, one a step, free of known inputs; anything else is for the folds.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import cached_property, lru_cache

import numpy as np

from .._arrays import Array, readonly
from ..joint import Joint, joint_gain
from ..model import Model
from ..prefixes import start_length
from ..window import Row, model_window
from .covariance import Covariance
from .lean import intake, reading
from .records import Solution
from .segmented import Lagged, Segmented

__all__ = ["PairPlan", "PairRing", "pair_plan"]

# The path of known inputs starts anew after so many horizons.
REBASE = 3


class PairPlan:
    """The joint gain of a constant model's full window, computed when first needed and shared."""

    def __init__(self, model: Model, horizon: int, lag: int) -> None:
        self.model, self.horizon, self.lag = model, horizon, lag

    def __reduce__(self) -> tuple[object, ...]:
        return (pair_plan, (self.model, self.horizon, self.lag))

    @cached_property
    def determined(self) -> bool:
        """Whether full windows determine both states."""
        window = model_window(self.model, self.horizon, self.lag)
        return start_length(window, self.model.dim_x + 1) is not None

    @cached_property
    def joint(self) -> Joint:
        """Gain and covariance of [x_n; x_{n-lag}], (2 dim_x, horizon dim_z) and (2 dim_x, 2 dim_x)."""
        joint = joint_gain(model_window(self.model, self.horizon, self.lag))
        K = readonly(np.ascontiguousarray(joint.K))
        return Joint(K, joint.L, joint.prior, readonly(joint.P))

    @cached_property
    def halves(self) -> tuple[Array, Array]:
        """The gains of x_n and of x_{n-lag}, in the order of memory in which short products are quickest."""
        first, second = np.split(self.joint.K, 2)
        return readonly(np.asfortranarray(first)), readonly(np.asfortranarray(second))

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
        # What is known of the state at the rows of the window; the buffer holds z - H path.
        self.path: deque[Array] | None = None
        self.ahead: Array | None = None  # the path at the row to come
        self.after: Array | None = None  # edits of x since the newest row
        self.rebased = now

    @classmethod
    def of(cls, plan: PairPlan, engine: Segmented) -> PairRing | None:
        """A ring with the engine's past, if that ends in a full window of plain rows."""
        model, first = plan.model, engine.now - plan.horizon + 1
        rows = engine.rows[-plan.horizon :]
        if [row.origin for row in rows] != list(range(first, engine.now + 1)):
            return None
        for row in rows:
            plain = row.arrival == row.origin and row.shift is None
            if not (plain and np.array_equal(row.H, model.H) and np.array_equal(row.R, model.R)):
                return None
        steps = [engine.step(row.origin) for row in rows[1:]]
        if not all(np.array_equal(step.F, model.F) and np.array_equal(step.Q, model.Q) for step in steps):
            return None
        ring = cls(plan, np.array([row.z for row in rows]), engine.now)
        if engine.after is not None:
            ring.edit(engine.after, True)
        if any(step.known is not None for step in steps):
            path = ring.begin_path()
            for place, step in enumerate(steps, 1):
                ahead = model.F @ path[place - 1]
                path[place] = ahead if step.known is None else ahead + step.known
            ring.free[1 : ring.end] -= np.array(path) @ model.H.T
        return ring

    @property
    def now(self) -> int:
        """Step of the newest row."""
        return self.base + self.end - 1

    def compact(self) -> None:
        """Move the window to the front."""
        self.free[: self.keep] = self.free[self.end - self.keep : self.end].copy()
        self.base, self.end = self.base + self.end - self.keep, self.keep

    # -- known inputs and edits ------------------------------------------------------------------------------

    def begin_path(self) -> deque[Array]:
        """The path of what is known, from now on."""
        if self.path is None:
            n = self.plan.model.dim_x
            self.path, self.rebased = deque([np.zeros(n)] * self.plan.horizon, self.plan.horizon), self.now
        return self.path

    def advance(self, known: Array | None) -> None:
        """One predict()."""
        if known is None and self.path is None:
            return
        before = self.begin_path()[-1]
        ahead = self.plan.model.F @ (before if self.after is None else before + self.after)
        self.ahead, self.after = ahead if known is None else ahead + known, None

    def edit(self, delta: Array, after_rows: bool) -> None:
        """x was moved from outside by `delta`, after or before the row of this step."""
        path = self.begin_path()
        if after_rows:
            self.after = delta if self.after is None else self.after + delta
        else:
            ahead = self.plan.model.F @ path[-1] if self.ahead is None else self.ahead
            self.ahead = ahead + delta

    def put(self, z: Array) -> bool:
        """A measurement of the next step, finite and flat."""
        if self.path is None or self.ahead is None:
            return intake(self)(z)
        if not intake(self)(z - self.plan.model.H @ self.ahead):
            return False
        self.path.append(self.ahead)
        self.ahead = None
        if self.now - self.rebased >= REBASE * self.plan.horizon:
            self._rebase(self.path)
        return True

    def _rebase(self, path: deque[Array]) -> None:
        """Let the path begin at zero, so that it stays small for any F; without inputs it then is nothing."""
        F, H, moved = self.plan.model.F, self.plan.model.H, path[0]
        for place, slot in enumerate(range(self.end - len(path), self.end)):
            path[place] = path[place] - moved
            self.free[slot] += H @ moved
            moved = F @ moved
        self.rebased = self.now
        if not any(x.any() for x in path):
            self.path = None

    # -- estimates -------------------------------------------------------------------------------------------

    def readers(self, column: bool) -> tuple[Callable[[], Array], Callable[[], Array]]:
        """Two functions: x_n and x_{n-lag}, each half of the one gain, in the client's form."""
        first, second = self.plan.halves
        return reading(self, first, column), reading(self, second, column)

    def solve(self, before: int = 0) -> Solution:
        """The newest state as of the newest row, or of the row before it."""
        gain, n = self.plan.newest_gain, self.plan.model.dim_x
        return Solution(self._pair(before)[:n], self.plan.P, gain, gain, self.plan.horizon)

    def lagged(self) -> Lagged:
        """The lagged state as of the newest row."""
        n, P = self.plan.model.dim_x, self.plan.joint.P
        return Lagged(self._pair(0)[n:], P[n:, n:], P[:n, n:])

    def _pair(self, before: int) -> Array:
        rows, n = self.free[self.end - before - self.plan.horizon : self.end - before], self.plan.model.dim_x
        # In halves, as the readers have it: the same to the bit.
        pair = np.concatenate([half.dot(rows.reshape(-1)) for half in self.plan.halves])
        if self.path is not None:
            pair[:n] += self.path[-1]
            pair[n:] += self.path[-1 - self.plan.lag]
        return pair

    def segmented(self) -> Segmented:
        """The rows of the window for the engine of windows of any kind, around a trajectory close to them."""
        model, low, path = self.plan.model, self.end - self.plan.horizon, self.path
        start = self._near(low)
        engine = Segmented(model.F, model.Q, self.base + low, start if path is None else start + path[0])
        gain = self.plan.newest_gain.value
        for place, slot in enumerate(range(low, self.end)):
            if place:
                known = None if path is None else path[place] - model.F @ path[place - 1]
                engine.advance(model.F, model.Q, known)
            z = self.free[slot].copy() if path is None else self.free[slot] + model.H @ path[place]
            engine.add(Row(engine.now, engine.now, model.H, model.R, z))
            engine.center = engine.center + gain @ (z - model.H @ engine.center)
        engine.start = engine.now - self.plan.horizon + 1
        if self.after is not None:
            engine.edit(self.after, True)
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
        fork.free, fork.path = self.free.copy(), None if self.path is None else self.path.copy()
        return fork


@lru_cache(maxsize=128)
def pair_plan(model: Model, horizon: int, lag: int) -> PairPlan:
    """The shared plan of a model, a horizon and a lag."""
    return PairPlan(model, horizon, lag)
