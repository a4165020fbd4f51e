"""The engine for constant models: measurements in a buffer, one slot a step, gains made beforehand.

A window without holes is one product of a constant gain and a view of the buffer; one with holes, late or weighted
rows is normal equations in an orthonormal basis of the full window. Known inputs and edits of x are a trajectory x_u:
the slots hold z - H x_u. What a ring cannot say (other F or H, several rows of one step, missing components) is for
the records.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .._arrays import Array
from .._lapack import cholesky_solver
from ..window import Row
from .covariance import Covariance
from .plan import Plan
from .records import NEGLIGIBLE, Limits, Records, Solution, Step

FLOAT = np.dtype(float)
# Arrival of a slot that nothing has come for.
NEVER = -(2**62)
# Windows that grow keep a gain of every length up to here; longer ones use a basis.
GROWING_GAINS = 64
# A pivot below this (the full window's are 1) means that the rows present are too few for normal equations.
WEAK_PIVOT = 1e-3
# Weights within this factor of 1 need no thought whether they are negligible.
ORDINARY = 1e3
# x_u starts anew after this many horizons.
REBASE = 3


class Ring:
    """Buffer of the last measurements of a constant model, and the estimate its window gives.

    `free` holds w (z - H x_u), what gains are applied to. `raw` (z itself), `known` and `path` (x_u at the rows of
    each step) exist only once something is known about the state or a row came late.
    """

    def __init__(self, plan: Plan, limits: Limits, now: int) -> None:
        self.plan, self.limits = plan, limits
        self.keep = 2 * limits.reach + 1  # rows within reach that were as late as can be when they came
        self.capacity = self.keep + max(self.keep, 256)
        self.base = now - self.keep + 1  # step of slot 0: the past is empty slots
        self.end = self.keep  # one past the newest slot
        self.free = np.zeros((self.capacity, plan.model.dim_z))
        self._alias()
        m = plan.model.dim_z
        self.single, self.ones, self.flat_shape, self.column_shape = m == 1, np.ones(m), (m,), (m, 1)
        self.variances: list[list[float]] = plan.model.R.tolist()
        self.weights = np.zeros(self.capacity)
        self.arrivals = np.full(self.capacity, NEVER)
        self._default()
        self.begin: int | None = None  # step of the oldest row
        self.irregular = now - 1  # newest step that broke the plain sequence
        self.spread = 0  # longest delay seen
        self.newest_age = 0  # of the row that came last
        self.odd: dict[int, Row] = {}
        self.raw: Array | None = None
        self.known: Array | None = None
        self.path: Array | None = None
        self.x_u: Array | None = None
        self.after: Array | None = None
        self.rebased = now

    def _alias(self) -> None:
        """The buffer as seen by z in its other shapes."""
        self.flat, self.columns = self.free.reshape(-1), self.free[:, :, None]

    @property
    def now(self) -> int:
        """Step of the newest slot."""
        return self.base + self.end - 1

    @property
    def overhang(self) -> int:
        """How much further back than the horizon the origins of a window's rows can lie."""
        return self.spread if self.limits.by_arrival else 0

    def _default(self) -> None:
        """Slots ahead are plain rows that arrive on time, so that the hot path writes nothing but z."""
        self.weights[self.end :] = 1.0
        self.arrivals[self.end :] = np.arange(self.base + self.end, self.base + self.capacity)

    def compact(self) -> None:
        """Move what a window can reach to the front."""
        shift = self.end - self.keep
        for array in (self.free, self.weights, self.arrivals, self.raw, self.known, self.path):
            if array is not None:
                array[: self.keep] = array[shift : self.end].copy()
        self.base, self.end = self.base + shift, self.keep
        self._default()
        self.odd = {step: row for step, row in self.odd.items() if step >= self.base}

    # -- transitions -----------------------------------------------------------------------------------------

    def advance(self, known: Array | None) -> None:
        """One predict(): a new slot that nothing has come for yet."""
        i = self.end
        if self.arrivals[i - 1] == NEVER:
            self.irregular = self.now
        self.end += 1
        self.free[i], self.weights[i], self.arrivals[i] = 0.0, 0.0, NEVER
        if known is not None and self.x_u is None:
            self._begin_known()
        if self.x_u is not None:
            self._advance_known(i, known)
        if self.spread and self.limits.by_arrival:
            self._expire()
        if self.end == self.capacity:
            self.compact()

    def _advance_known(self, i: int, known: Array | None) -> None:
        F = self.plan.model.F
        total = known
        if self.after is not None:
            moved = F @ self.after  # x_u holds the edit already: only the record of the step needs it
            total = moved if known is None else known + moved
            self.after = None
        self.x_u = F @ self.x_u if known is None else F @ self.x_u + known
        self.known[i] = 0.0 if total is None else total  # type: ignore[index]
        self.path[i] = self.x_u  # type: ignore[index]
        if self.now - self.rebased >= REBASE * self.limits.horizon:
            self._rebase()

    def edit(self, delta: Array, after_rows: bool) -> None:
        """x was moved from outside by `delta`, after or before the rows of this step."""
        if self.x_u is None:
            self._begin_known()
        self.x_u = self.x_u + delta
        if after_rows:
            self.after = delta if self.after is None else self.after + delta
        else:
            self.known[self.end - 1] += delta  # type: ignore[index]
            self.path[self.end - 1] = self.x_u  # type: ignore[index]

    def _begin_known(self) -> None:
        self._keep_raw()
        n = self.plan.model.dim_x
        self.known, self.path = np.zeros((self.capacity, n)), np.zeros((self.capacity, n))
        self.x_u = np.zeros(n)
        self.rebased = self.now

    def _keep_raw(self) -> None:
        if self.raw is None:
            self.raw = self.free.copy()
            for step, row in self.odd.items():
                self.raw[step - self.base] = row.z

    def _rebase(self) -> None:
        """Start x_u from zero at the oldest slot of the window: it stays small for any F."""
        F, H, path, raw = self.plan.model.F, self.plan.model.H, self.path, self.raw
        low = self.end - self.limits.horizon - self.overhang
        self.rebased = self.now
        if not self.known[self.end - self.keep : self.end].any():  # type: ignore[index]
            self.free[: self.end] = raw[: self.end] * self.weights[: self.end, None]  # type: ignore[index]
            self.x_u = self.known = self.path = None
            self.raw = raw if self.spread else None
            return
        start = path[low].copy()  # type: ignore[index]
        for i in range(low, self.end):
            path[i] -= start  # type: ignore[index]
            self.free[i] = self.weights[i] * (raw[i] - H @ path[i])  # type: ignore[index]
            start = F @ start
        self.x_u = path[self.end - 1].copy()  # type: ignore[index]

    # -- rows ------------------------------------------------------------------------------------------------

    def add_plain(self, z: Array) -> bool:
        """z of this step, on time and of the model's weight, into its slot; False where the slot is taken."""
        i = self.end - 1
        if self.arrivals[i] != NEVER or self.after is not None:
            return False
        now = self.base + i
        self.arrivals[i], self.weights[i], self.newest_age = now, 1.0, 0
        if self.raw is not None:
            self.raw[i] = z
        self.free[i] = z if self.path is None else z - self.plan.model.H.dot(self.path[i])
        if self.begin is None:
            self.begin = now
        return True

    def add(self, row: Row) -> bool:
        """Put a row that arrived now into the slot of its origin; False where a ring cannot."""
        i = row.origin - self.base
        weight = self.relative_weight(row)
        late = self.now - row.origin
        if weight is None or late + self.limits.horizon >= self.keep:
            return False
        if self.arrivals[i] != NEVER or self.after is not None:
            return False
        if late:
            self._keep_raw()  # rows will leave the weighted copy one by one, in the order they came
        self.arrivals[i], self.weights[i], self.newest_age = row.arrival, weight, late
        if late or weight != 1.0:
            self.odd[row.origin], self.irregular = row, self.now
        if self.raw is not None:
            self.raw[i] = row.z
        self.free[i] = weight * (row.z if self.path is None else row.z - self.plan.model.H @ self.path[i])
        if late > self.spread:
            self.spread = late
            self._expire()
        if self.begin is None or row.origin < self.begin:
            self.begin = row.origin
        return True

    def store(self, z: Any) -> bool:
        """The hot path's update(): z into the next slot, if it is a plain finite measurement; else nothing
        is done.
        """
        i = self.end
        try:
            if self.single:
                value = z if type(z) is float else z.item()
                if value - value != 0.0:
                    return False
                self.flat[i] = value
            else:
                shape = z.shape
                if z.dtype is not FLOAT:
                    return False
                if shape == self.flat_shape:
                    self.free[i] = z
                elif shape == self.column_shape:
                    self.columns[i] = z
                else:
                    return False
                total = self.ones.dot(z)
                if total - total != 0.0:
                    return False
        except (AttributeError, TypeError, ValueError):
            return False
        self.end = i + 1
        if self.end == self.capacity:
            self.compact()
        return True

    def quick_weight(self, R: Any) -> float | None:
        """w where R = R_model / w, for the hot path; None for whatever is not plainly so, or far from 1."""
        base = self.variances
        try:
            if self.single:
                weight = base[0][0] / (R if type(R) is float else R.item())
            else:
                given = R.tolist()
                weight = base[0][0] / given[0][0]
                for ours, theirs in zip(base, given, strict=True):
                    for a, b in zip(ours, theirs, strict=True):
                        if abs(a - weight * b) > 1e-15 * abs(a):
                            return None
        except (AttributeError, TypeError, ValueError, IndexError, ZeroDivisionError):
            return None
        return weight if 1.0 / ORDINARY < weight < ORDINARY else None

    def weigh(self, weight: float, R: Array) -> None:
        """Give the row stored last its weight."""
        i, now = self.end - 1, self.now
        z = self.free[i].copy()
        self.odd[now] = Row(now, now, self.plan.model.H, R.reshape(len(z), -1).copy(), z)
        self.free[i] *= weight
        self.weights[i], self.irregular = weight, now

    def unstore(self) -> None:
        """Take the row stored last back."""
        self.odd.pop(self.now, None)
        self.end -= 1
        self.weights[self.end] = 1.0

    def relative_weight(self, row: Row) -> float | None:
        """w where R_row = R / w; None where R is no multiple of the model's, or H another."""
        model = self.plan.model
        if row.H is not model.H and not np.array_equal(row.H, model.H):
            return None
        if row.R is model.R:
            return 1.0
        top = float(model.R[0, 0])
        ratio = float(row.R[0, 0]) / top if top > 0.0 else 0.0
        if not ratio > 0.0 or np.abs(row.R - ratio * model.R).max() > 1e-15 * np.abs(row.R).max():
            return None
        return 1.0 / ratio

    def negligible(self, row: Row) -> bool:
        """A row whose information is nothing beside the window's counts as missing."""
        if row.R is self.plan.model.R or self.begin is None:
            return False
        weight = self.relative_weight(row)
        present = self.weights[self.end - self.limits.horizon - self.overhang : self.end]
        return weight is not None and weight < NEGLIGIBLE * float(present.max())

    def _expire(self) -> None:
        """Rows that arrived a horizon ago leave the working copy, wherever their origins lie."""
        if self.limits.by_arrival:
            window = slice(self.end - self.limits.horizon - self.spread, self.end)
            gone = self.arrivals[window] <= self.now - self.limits.horizon
            self.weights[window][gone] = 0.0
            self.free[window][gone] = 0.0

    def adopt(self, records: Records) -> bool:
        """Take over a past of plain rows; False where it holds anything a ring of this model does not."""
        model = self.plan.model
        inputs = any(step.known is not None for step in records.steps)
        if inputs or records.after is not None or records.now != self.now:
            return False
        for row in records.rows:
            i = row.origin - self.base
            if row.arrival != row.origin or i < 0 or self.arrivals[i] != NEVER or row.shift is not None:
                return False
            if not (np.array_equal(row.H, model.H) and np.array_equal(row.R, model.R)):
                return False
            self.free[i], self.weights[i], self.arrivals[i] = row.z, 1.0, row.origin
        self.begin = min((row.origin for row in records.rows), default=None)
        if self.begin is not None:
            holes = np.flatnonzero(self.arrivals[self.begin - self.base : self.end] == NEVER)
            self.irregular = self.begin + int(holes[-1]) if len(holes) else self.begin - 1
        return True

    # -- the estimate ----------------------------------------------------------------------------------------

    @property
    def length(self) -> int:
        """Steps of the window that can hold rows: it grows up to the horizon."""
        return 0 if self.begin is None else min(self.limits.horizon, self.now - self.begin + 1)

    @property
    def plain(self) -> bool:
        """Whether every step of the window has its own plain row."""
        return 0 < self.length <= self.now - self.irregular and self.weights[self.end - 1] == 1.0

    def solve(self) -> Solution | None:
        """Least squares over the window, None where its rows do not determine the state."""
        length = self.length
        if not length:
            return None
        if self.plain and (length <= GROWING_GAINS or length == self.limits.horizon):
            return self._plain(length)
        return self._holed(length)

    def _plain(self, length: int) -> Solution | None:
        plan = self.plan
        gain = plan.gain(length)
        if gain is None:
            return None
        x = gain @ self.free[self.end - length : self.end].reshape(-1)
        return Solution(
            x if self.x_u is None else x + self.x_u,
            plan.covariance(length),
            Covariance.of(gain),
            Covariance.of(gain[:, -plan.model.dim_z :]),
            length,
        )

    def view(self, form: int) -> Array:
        """The full window that ends at the newest slot, as a column or flat, in the client's form."""
        m = self.free.shape[1]
        window = self.flat[(self.end - self.limits.horizon) * m : self.end * m]
        return window.reshape(-1, 1) if form == 2 else window

    def hot_estimate(self) -> Array | None:
        """x of a window with holes as flat (dim_x,), None where it takes more than normal equations."""
        length, limits = self.length, self.limits
        span = self._span(length)
        weights = self.weights[self.end - span : self.end]
        if np.count_nonzero(weights) < min(limits.horizon, limits.instants):
            return None
        return self._normal(span, weights)

    def hole(self) -> None:
        """The hot path's update(None): a slot that stays empty."""
        i = self.end
        self.free[i], self.weights[i], self.arrivals[i] = 0.0, 0.0, NEVER
        self.irregular = self.base + i
        self.end = i + 1
        if self.end == self.capacity:
            self.compact()

    def last_row(self) -> int:
        """Step of the newest row."""
        i = self.end - 1
        while self.arrivals[i] == NEVER:
            i -= 1
        return self.base + i

    def solve_at(self, step: int) -> Solution:
        """The estimate as it stood at an earlier step, whose window must have had one."""
        end, self.end = self.end, step - self.base + 1
        try:
            solution = self.solve()
        finally:
            self.end = end
        if solution is None:
            raise RuntimeError(f"the window of step {step} has no estimate")
        return solution

    def _holed(self, length: int) -> Solution | None:
        plan, limits = self.plan, self.limits
        span = self._span(length)
        weights = self.weights[self.end - span : self.end]
        rows = int(np.count_nonzero(weights))
        if limits.extends and rows < min(limits.horizon, limits.instants):
            earlier = self.arrivals[self.end - limits.reach : self.end - limits.horizon]
            if (earlier != NEVER).any():
                return self._extended()
        x = self._normal(span, weights)
        if x is not None:
            return self._solution(x, weights.tobytes(), rows)
        return self._patterned(weights)

    def _span(self, length: int) -> int:
        """Slots the working view covers: a power of two while the window grows, so that few bases are
        needed.
        """
        return min(
            max(8, 1 << (length + self.overhang - 1).bit_length()), self.limits.horizon + self.overhang
        )

    def _normal(self, span: int, weights: Array) -> Array | None:
        """Normal equations in the basis of the full window; None where the rows present are too few for
        them.
        """
        basis = self.plan.basis(span)
        r = basis.rank
        if not basis.sound or not r:
            return None
        eta = basis.project @ self.free[self.end - span : self.end].reshape(-1)
        factor, solution, info = cholesky_solver()((basis.grams @ weights).reshape(r, r), eta)
        if info or min(factor.diagonal().tolist()) < WEAK_PIVOT:
            return None
        x = basis.back @ solution
        return x if self.x_u is None else x + self.x_u

    def _patterned(self, weights: Array) -> Solution | None:
        key = weights.tobytes()
        pattern = self.plan.pattern(key)
        if not pattern.determined:
            return self._extended() if self.limits.extends else None
        x = pattern.weighted_gain @ self.free[self.end - len(weights) : self.end].reshape(-1)
        return self._solution(x if self.x_u is None else x + self.x_u, key, pattern.rows)

    def _extended(self) -> Solution | None:
        """Reach further back, an older row at a time, until the rows suffice."""
        if self.raw is not None:
            return self.records().solve(self.limits)
        reach = slice(self.end - self.limits.reach, self.end)
        reached, present = self.weights[reach], np.flatnonzero(self.arrivals[reach] != NEVER)
        wanted = min(self.limits.horizon, self.limits.instants)
        for count in range(min(wanted, len(present)), len(present) + 1):
            weights = reached[present[len(present) - count] :]
            key = weights.tobytes()
            pattern = self.plan.pattern(key)
            if pattern.determined:
                x = pattern.weighted_gain @ self.free[self.end - len(weights) : self.end].reshape(-1)
                return self._solution(x, key, pattern.rows)
        return None

    def _solution(self, x: Array, key: bytes, rows: int) -> Solution:
        """An estimate whose covariance and gains are worked out from the pattern when asked for."""
        pattern = self.plan.pattern
        return Solution(
            x,
            Covariance(_pattern_covariance, (pattern, key)),
            Covariance(_pattern_gain, (pattern, key)),
            Covariance(_pattern_newest, (pattern, key, self.newest_age)),
            rows,
        )

    # -- change of engine ------------------------------------------------------------------------------------

    def records(self) -> Records:
        """The same past as records: the reference engine takes over."""
        model = self.plan.model
        records = Records(model.F, model.Q, self.now)
        low = self.end - self.keep
        plain = Step(model.F, model.Q)
        records.first = self.base + low
        records.steps.clear()
        values = self.free if self.raw is None else self.raw
        for i in range(low, self.end):
            known = None if self.known is None or not self.known[i].any() else self.known[i].copy()
            records.steps.append(plain if known is None else Step(model.F, model.Q, known))
            if self.arrivals[i] == NEVER:
                continue
            step = self.base + i
            row = self.odd.get(step) or Row(step, step, model.H, model.R, values[i].copy())
            records.rows.append(row)
        records.rows.sort(key=lambda row: row.arrival)
        records.after = self.after
        return records

    def copy(self) -> Ring:
        """An independent copy."""
        fork = object.__new__(Ring)
        fork.__dict__.update(
            {k: v.copy() if isinstance(v, np.ndarray | dict) else v for k, v in self.__dict__.items()}
        )
        fork._alias()
        return fork

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._alias()  # pickle has torn the views off their buffer


def _pattern_covariance(pattern: Any, key: bytes) -> Array:
    return np.asarray(pattern(key).covariance)


def _pattern_gain(pattern: Any, key: bytes) -> Array:
    return np.asarray(pattern(key).gain)


def _pattern_newest(pattern: Any, key: bytes, age: int) -> Array:
    return np.asarray(pattern(key).gain_at(age))
