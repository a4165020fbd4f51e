"""The engine for constant models: measurements in a buffer, one slot a step, gains made beforehand.

A window without holes is one product of a constant gain and a view of the buffer; one with holes, late or
weighted rows is normal equations in an orthonormal basis of the full window. What a ring cannot say (other F
or H, several rows of one step, missing components) is for the records.
"""

from __future__ import annotations

from itertools import islice
from typing import Any

import numpy as np

from .._arrays import Array
from .basis import Memory
from .covariance import Covariance
from .records import Records, Solution, Step
from .slots import NEVER, Slots

# Windows that grow keep a gain of every length up to here; longer ones use a basis.
GROWING_GAINS = 64


class Ring(Slots):
    """The estimate that the window of a buffer gives."""

    @property
    def length(self) -> int:
        """Steps of the window that can hold rows: it grows up to the horizon."""
        return 0 if self.begin is None else min(self.limits.horizon, self.now - self.begin + 1)

    @property
    def plain(self) -> bool:
        """Whether every step of the window has its own plain row."""
        return self._is_plain(self.length)

    def _is_plain(self, length: int) -> bool:
        return 0 < length <= self.base + self.end - 1 - self.irregular and self.weights[self.end - 1] == 1.0

    def _moved(self, x: Array) -> Array:
        return x if self.inputs is None else x + self.inputs.now

    def solve(self) -> Solution | None:
        """Least squares over the window, None where its rows do not determine the state."""
        length = self.length
        if not length:
            return None
        if (length <= GROWING_GAINS or length == self.limits.horizon) and self._is_plain(length):
            gain = self.plan.gain(length)
            if gain is None:
                return None
            x = gain.dot(self.free[self.end - length : self.end].reshape(-1))
            return Solution(self._moved(x), *self.plan.lasting(length), length)
        return self._holed(length)

    @property
    def settled(self) -> bool:
        """Whether the newest slot ends a full window of plain rows, and z is all there is to remember."""
        return self.raw is None and self.full

    @property
    def full(self) -> bool:
        """Whether the newest slot ends a full window of plain rows."""
        horizon = self.limits.horizon
        return self.length == horizon and self._is_plain(horizon)

    @property
    def least(self) -> int:
        """Rows below which a window reaches further back."""
        return min(self.limits.horizon, self.limits.instants)

    def few(self, weights: Array) -> bool:
        """Whether a window reaches further back, if there is anything."""
        return int(np.count_nonzero(weights)) < self.least

    def solve_at(self, step: int) -> Solution:
        """The estimate as it stood at an earlier step, whose window must have had one."""
        inputs, newest, self.end = self.inputs, self.end, step - self.base + 1
        x_u = None if inputs is None else inputs.now
        try:
            if inputs is not None:
                inputs.now = inputs.path[self.end - 1]
            solution = self.solve()
        finally:
            self.end = newest
            if inputs is not None and x_u is not None:
                inputs.now = x_u
        if solution is None:
            raise RuntimeError(f"the window of step {step} has no estimate")
        return solution

    def _holed(self, length: int) -> Solution | None:
        limits = self.limits
        span = self.span(length)
        weights = self.weights[self.end - span : self.end]
        if limits.extends and self.few(weights):
            earlier = self.arrivals[self.end - limits.reach : self.end - limits.horizon]
            if (earlier != NEVER).any():
                return self._extended()
        x = self._normal(span, weights)
        if x is not None:
            return self.solution(x, weights.tobytes(), int(np.count_nonzero(weights)))
        return self._patterned(weights)

    def span(self, length: int) -> int:
        """Slots the working view covers: powers of two while the window grows need few bases."""
        overhang, horizon = self.overhang, self.limits.horizon
        if length == horizon:
            return horizon + overhang
        return min(max(8, 1 << (length + overhang - 1).bit_length()), horizon + overhang)

    def _normal(self, span: int, weights: Array) -> Array | None:
        """x of the last `span` slots by normal equations; None where the rows are too few for them."""
        free = self.free[self.end - span : self.end]
        recall = None if self.weighted else self.memory(span).recall(weights.tobytes())
        x = self._in_basis(span, weights, free) if recall is None else recall(free.reshape(-1))
        return None if x is None else self._moved(x)

    def memory(self, span: int) -> Memory:
        """Gains of windows of `span` slots that recur."""
        return self.plan.memory(span, self.least, self.spread)

    def _in_basis(self, span: int, weights: Array, free: Array) -> Array | None:
        """Normal equations in the basis of the full window of `span` steps."""
        return self.plan.basis(span).solver()(weights, free.reshape(-1))

    def _patterned(self, weights: Array) -> Solution | None:
        key = weights.tobytes()
        pattern = self.plan.pattern(key)
        if not pattern.determined:
            return self._extended() if self.limits.extends else None
        x = pattern.weighted_gain.dot(self.free[self.end - len(weights) : self.end].reshape(-1))
        return self.solution(self._moved(x), key, pattern.rows)

    def _extended(self) -> Solution | None:
        """Reach further back, an older row at a time, until the rows suffice."""
        if self.spread or self.inputs is not None:
            return self.records().solve(self.limits)
        reached = self.reached()
        return None if reached is None else self.solution(*reached)

    def reached(self) -> tuple[Array, bytes, int] | None:
        """x from the fewest newest rows that suffice; the pattern of their weights and their number."""
        low = self.end - self.limits.reach
        present = (self.arrivals[low : self.end] != NEVER).nonzero()[0].tolist()
        for count in range(min(self.least, len(present)), len(present) + 1):
            oldest = low + present[-count] if count else self.end
            weights, free = self.weights[oldest : self.end], self.free[oldest : self.end]
            key, length = weights.tobytes(), self.end - oldest
            span = max(8, 1 << (length - 1).bit_length())
            padded, filled = np.zeros(span), np.zeros((span, free.shape[1]))
            padded[span - length :], filled[span - length :] = weights, free
            x = self._in_basis(span, padded, filled)
            if x is None and self.plan.pattern(key).determined:
                x = self.plan.pattern(key).weighted_gain.dot(free.reshape(-1))
            if x is not None:
                return x, key, count
        return None

    def solution(self, x: Array, key: bytes, rows: int, newest_age: int | None = None) -> Solution:
        """An estimate whose covariance and gains are worked out from the pattern when asked for."""
        pattern, age = self.plan.pattern, self.newest_age if newest_age is None else newest_age
        return Solution(
            x,
            Covariance(_pattern_covariance, (pattern, key)),
            Covariance(_pattern_gain, (pattern, key)),
            Covariance(_pattern_newest, (pattern, key, age)),
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
        for i in range(low, self.end):
            known = None if self.inputs is None else self.inputs.known[i]
            still = known is None or not known.any()
            records.steps.append(plain if still or known is None else Step(model.F, model.Q, known.copy()))
            if self.arrivals[i] == NEVER:
                continue
            records.rows.append(self.row(self.base + i))
        # Of the rows of one step, the one that came last is what K is about.
        records.rows.sort(key=lambda row: (row.arrival, row.arrival - row.origin == self.newest_age))
        records.after = None if self.inputs is None else self.inputs.after
        return records

    def adopt(self, records: Records) -> bool:
        """Take over a past of plain rows; False where it holds anything a ring of this model does not."""
        model = self.plan.model
        last = records.steps[-1]
        if not (np.array_equal(last.F, model.F) and np.array_equal(last.Q, model.Q)):
            return False
        oldest = min((row.origin for row in records.rows), default=records.now)
        steps = islice(records.steps, max(0, oldest + 1 - records.first), None)
        if not all(step.repeats(last) for step in steps):
            return False
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

    def copy(self) -> Ring:
        """An independent copy."""
        fork = object.__new__(Ring)
        self._copy_into(fork)
        return fork


def _pattern_covariance(pattern: Any, key: bytes) -> Array:
    return np.asarray(pattern(key).covariance)


def _pattern_gain(pattern: Any, key: bytes) -> Array:
    return np.asarray(pattern(key).gain)


def _pattern_newest(pattern: Any, key: bytes, age: int) -> Array:
    return np.asarray(pattern(key).gain_at(age))
