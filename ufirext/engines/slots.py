"""Measurements of a constant model in a buffer, one slot a step: what came, when, and with which weight."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .._arrays import Array
from ..window import Row
from .plan import Plan
from .records import NEGLIGIBLE, Limits
from .trajectory import Trajectory

# Arrival of a slot that nothing has come for.
NEVER = -(2**62)
# Weights within this factor of 1 need no thought whether they are negligible.
ORDINARY = 1e3
# x_u starts anew after this many horizons.
REBASE = 3


class Slots:
    """Buffer of the last measurements, with the holes, delays and weights of its rows.

    `free` holds w (z - H x_u), what gains are applied to. `raw` (z itself) is kept only once something is
    known about the state or a row came late.
    """

    def __init__(self, plan: Plan, limits: Limits, now: int) -> None:
        self.plan, self.limits = plan, limits
        self.keep = 2 * limits.reach + 1  # rows within reach that were as late as can be when they came
        self.capacity = self.keep + max(self.keep // 4, 256)  # a short lap stays in the cache
        self.base = now - self.keep + 1  # step of slot 0: the past is empty slots
        self.end = self.keep  # one past the newest slot
        m = plan.model.dim_z
        self.free = np.zeros((self.capacity, m))
        self.weights = np.zeros(self.capacity)
        self.arrivals = np.full(self.capacity, NEVER)
        self._default()
        self.begin: int | None = None  # step of the oldest row
        self.irregular = now - 1  # newest step that broke the plain sequence
        self.opened_empty = now  # newest step whose slot did not come with a row of an ordinary weight
        self.spread = 0  # longest delay seen
        self.newest_age = 0  # of the row that came last
        self.weighted: dict[
            int, tuple[bytes, Sequence[float]]
        ] = {}  # R and z of rows with a weight, by origin
        self.raw: Array | None = None
        self.inputs: Trajectory | None = None

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
        for array in (self.free, self.weights, self.arrivals, self.raw):
            if array is not None:
                array[: self.keep] = array[shift : self.end].copy()
        if self.inputs is not None:
            self.inputs.compact(shift, self.keep)
        self.base, self.end = self.base + shift, self.keep
        self._default()
        self.weighted = {step: row for step, row in self.weighted.items() if step >= self.base}
        self._forget_late()

    def _forget_late(self) -> None:
        """Be a plain buffer again once all rows in reach came on time and with the model's weight."""
        raw, arrivals = self.raw, self.arrivals[: self.end]
        if raw is None or self.weighted:
            return
        came = arrivals != NEVER
        if (arrivals != np.arange(self.base, self.base + self.end))[came].any():
            return
        self.spread = 0
        if self.inputs is None:
            self.weights[: self.end] = came
            self.free[: self.end] = raw[: self.end] * came[:, None]
            self.raw = None

    # -- transitions -----------------------------------------------------------------------------------------

    def advance(self, known: Array | None) -> None:
        """One predict(): a new slot that nothing has come for yet."""
        i = self.end
        now = self.base + i
        if self.arrivals[i - 1] == NEVER:
            self.irregular = now - 1
        self.end = i + 1
        self.free[i], self.weights[i], self.arrivals[i] = 0.0, 0.0, NEVER
        self.opened_empty = now
        if known is not None or self.inputs is not None:
            inputs = self._trajectory()
            inputs.advance(i, self.plan.model.F, known)
            if self.due(inputs, now):
                if inputs.forgotten(self.end - self.keep, self.end):
                    self._forget()
                else:
                    self.rebase(inputs)
        if self.spread and self.limits.by_arrival:
            self._expire_one()
        if self.end == self.capacity:
            self.compact()

    def known_at(self, step: int) -> Array | None:
        """What is known to have changed x at a step that is remembered, or at the one that is open."""
        inputs = self.inputs
        if inputs is None:
            return None
        return inputs.coming if step > self.now else inputs.known[step - self.base]

    def take_coming(self) -> Array | None:
        """What is known of the open step, which is to get its slot."""
        inputs = self.inputs
        if inputs is None:
            return None
        change, inputs.coming = inputs.coming, None
        return change

    def edit(self, delta: Array, after_rows: bool) -> None:
        """x was moved from outside by `delta`, after or before the rows of this step."""
        self._trajectory().edit(self.end - 1, delta, after_rows)

    def _trajectory(self) -> Trajectory:
        if self.inputs is None:
            self.keep_raw()
            self.inputs = Trajectory(self.capacity, self.plan.model.dim_x, self.now)
        return self.inputs

    def keep_raw(self) -> None:
        """From now on z itself is kept too; until now `free` is just that, but for weights."""
        if self.raw is None:
            self.raw = self.free.copy()
            for step, (_, z) in self.weighted.items():
                self.raw[step - self.base] = z

    def widen(self, late: int) -> None:
        """Rows may be so late: they leave the working copy one by one, in the order they came."""
        self.keep_raw()
        self.spread = late
        self._expire()

    def due(self, inputs: Trajectory, now: int) -> bool:
        """Whether x_u starts anew, or is forgotten, at a step."""
        return inputs.over or now - inputs.rebased >= REBASE * self.limits.horizon

    def _forget(self) -> None:
        """Nothing is known about the state in all that is remembered: rows are seen as they are."""
        raw: Array = self.free if self.raw is None else self.raw
        self.free[: self.end] = raw[: self.end] * self.weights[: self.end, None]
        self.inputs, self.raw = None, raw if self.spread else None

    def rebase(self, inputs: Trajectory) -> None:
        """Start x_u anew at the oldest slot of the window, or of the one a step ago."""
        raw: Array = self.free if self.raw is None else self.raw
        low = self.end - self.limits.horizon - self.overhang - 1
        inputs.rebase(low, self.end, self.plan.model.F)
        inputs.rebased, inputs.valid_from = self.now, self.base + low
        seen = inputs.path[low : self.end] @ self.plan.model.H.T
        self.free[low : self.end] = self.weights[low : self.end, None] * (raw[low : self.end] - seen)

    # -- rows ------------------------------------------------------------------------------------------------

    def add_plain(self, z: Array) -> bool:
        """z of this step, on time and of the model's weight, into its slot; False where the slot is taken."""
        i = self.end - 1
        if self._taken(i):
            return False
        now = self.base + i
        self.arrivals[i], self.weights[i], self.newest_age = now, 1.0, 0
        if self.raw is not None:
            self.raw[i] = z
        self.free[i] = self._unmoved(z, i)
        if self.begin is None:
            self.begin = now
        return True

    def _taken(self, i: int) -> bool:
        """Whether a slot has its row, or x was edited since the rows of this step."""
        return bool(self.arrivals[i] != NEVER) or (self.inputs is not None and self.inputs.after is not None)

    def _unmoved(self, z: Array, i: int) -> Array:
        return z if self.inputs is None else z - self.plan.model.H.dot(self.inputs.path[i])

    def add(self, row: Row) -> bool:
        """Put a row that arrived now into the slot of its origin; False where a ring cannot."""
        i = row.origin - self.base
        weight = self.relative_weight(row)
        late = self.now - row.origin
        if weight is None or late + self.limits.horizon >= self.keep or self._outweighs(weight):
            return False
        if self._taken(i) or (self.inputs is not None and row.origin < self.inputs.valid_from):
            return False
        if late > self.spread:
            self.widen(late)
        if late or weight != 1.0:
            self.irregular = self.now
        if weight != 1.0:
            self.weighted[row.origin] = row.R.tobytes(), row.z.tolist()
        self.arrivals[i], self.weights[i], self.newest_age = row.arrival, weight, late
        if self.raw is not None:
            self.raw[i] = row.z
        self.free[i] = weight * self._unmoved(row.z, i)
        if self.begin is None or row.origin < self.begin:
            self.begin = row.origin
        return True

    def _outweighs(self, weight: float) -> bool:
        """Whether a row's weight makes others negligible, or the model's own rows to come."""
        present = self.weights[self.end - self.limits.reach : self.end]
        return weight * NEGLIGIBLE >= float(present.min(where=present > 0.0, initial=1.0))

    def row(self, step: int) -> Row:
        """The row of a slot that has one, as it came."""
        i, model, own = step - self.base, self.plan.model, self.weighted.get(step)
        if own is None:
            z, R = (self.free if self.raw is None else self.raw)[i].copy(), model.R
        else:
            z, R = np.array(own[1]), np.frombuffer(own[0]).reshape(model.R.shape)
        return Row(step, int(self.arrivals[i]), model.H, R, z)

    @property
    def ordinary(self) -> bool:
        """Whether no row in the window outweighs any that is as good as the model's."""
        window = self.weights[self.end - self.limits.horizon - self.overhang : self.end]
        return not self.weighted or float(window.max()) <= ORDINARY

    def relative_weight(self, row: Row) -> float | None:
        """w where R_row = R / w; None where R is no multiple of the model's, or H another."""
        model = self.plan.model
        if row.H is not model.H and not np.array_equal(row.H, model.H):
            return None
        if row.R is model.R:
            return 1.0
        top = float(model.R[0, 0])
        ratio = float(row.R[0, 0]) / top if top > 0.0 else 0.0
        if not ratio > 0.0 or (np.abs(row.R - ratio * model.R) > 1e-15 * np.abs(row.R)).any():
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

    def _expire_one(self) -> None:
        """The same after one step more: only rows that arrived exactly a horizon ago go."""
        last, bound = self.end - self.limits.horizon, self.now - self.limits.horizon
        first = last - self.spread - 1
        for i, arrival in enumerate(self.arrivals[first:last].tolist(), first):
            if arrival == bound:
                self.weights[i] = 0.0
                self.free[i] = 0.0

    def _copy_into(self, fork: Any) -> None:
        copied = {k: v.copy() if hasattr(v, "copy") and k != "plan" else v for k, v in self.__dict__.items()}
        fork.__dict__.update(copied)
