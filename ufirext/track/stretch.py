"""One stretch of a track through one filter: as a whole on a grid, else row by row."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np

from .._arrays import Array
from .series import Integers, Progress, Track
from .timing import Timing

if TYPE_CHECKING:
    from .run import Estimates, Motion

__all__ = ["filter_grid", "filter_rows", "new_filter"]

_CHUNK = 8192  # grid points filtered at once: bounds memory, and lets progress show
_VAGUE = 1e4  # standard deviations of a measurement: what is known before the first row


def new_filter(motion: Motion, step: float) -> Any:
    """A filter that knows nothing yet: at rest at the origin, give or take a vague prior."""
    from ..filters.ufir import UFIRFilter

    model = motion.model(step)
    kf = UFIRFilter(model.dim_x, model.dim_z, horizon="adaptive" if motion.adaptive else motion.horizon)
    kf.F, kf.H, kf.Q, kf.R = (np.array(each) for each in (model.F, model.H, model.Q, model.R))
    kf.x = np.zeros(model.dim_x)
    scale = [motion.r * (_VAGUE / step**power) ** 2 for power in range(motion.order + 1)]
    kf.P = np.diag(np.tile(scale, model.dim_z))
    return kf


def filter_grid(
    track: Track,
    axis: Timing,
    motion: Motion,
    rows: slice,
    origin: Array,
    out: Estimates,
    progress: Progress,
) -> None:
    """Rows on a grid, one measurement a step at most, by the filter's batch path; empty points are NaN."""
    kf = new_filter(motion, axis.step)
    R = kf.R.copy()
    H = kf.H.copy()
    point = np.cumsum(axis.steps[rows]).astype(int)
    point -= point[0]
    measured = track.position[rows] - origin
    for first in range(0, point[-1] + 1, _CHUNK):
        here = slice(*np.searchsorted(point, [first, first + _CHUNK]))
        length = min(_CHUNK, int(point[-1]) + 1 - first)
        zs = np.full((length, H.shape[0]), np.nan)
        place = point[here] - first
        zs[place] = measured[here]
        means, covs, means_prior, covs_prior = (each[place] for each in kf.batch_filter(zs))
        target = slice(rows.start + here.start, rows.start + here.stop)
        out.mean[target] = means.reshape(len(place), -1)
        out.std[target] = np.sqrt(np.maximum(np.diagonal(covs, axis1=1, axis2=2), 0.0))
        y = measured[here] - means_prior.reshape(len(place), -1) @ H.T
        S = H @ covs_prior @ H.T + R
        out.innovation[target] = y
        out.innovation_std[target] = np.sqrt(np.diagonal(S, axis1=1, axis2=2))
        out.nis[target] = np.einsum("ni,ni->n", y, np.linalg.solve(S, y[:, :, None])[:, :, 0])
        progress("filtering", target.stop, len(track))
    _flag(out, rows, np.arange(len(point)), point.astype(float), motion)


def _flag(out: Estimates, rows: slice, index: Integers, point: Array, motion: Motion) -> None:
    """Mark the rows with a determined state and a whole window; blank what could not be predicted."""
    out.ready[rows] = index >= motion.order
    out.settled[rows] = (point >= motion.horizon) & (index > motion.order + 2)
    unpredicted = np.arange(rows.start, rows.stop)[index <= motion.order]
    out.innovation[unpredicted] = np.nan
    out.innovation_std[unpredicted] = np.nan
    out.nis[unpredicted] = np.nan


def filter_rows(
    track: Track,
    axis: Timing,
    motion: Motion,
    rows: slice,
    origin: Array,
    out: Estimates,
    progress: Progress,
) -> int:
    """Rows off the grid, late rows, and smoothing, step by step; returns how many came too late."""
    kf = new_filter(motion, axis.step)
    walk = _Walk(kf, axis, motion, out)
    ages = None if track.age is None else track.age[rows] / (1.0 if track.age_unit == "steps" else axis.step)
    measured = track.position[rows] - origin
    index = np.arange(rows.stop - rows.start)
    for offset in index.tolist():
        row = rows.start + offset
        walk.advance(float(axis.steps[row]) if offset else 1.0)
        walk.take(row, measured[offset], None if ages is None else float(ages[offset]))
        if offset % 1024 == 0:
            progress("filtering", row, len(track))
    walk.finish()
    _flag(out, rows, index, np.cumsum(axis.steps[rows]) - axis.steps[rows.start], motion)
    return int(kf.dropped)


class _Walk:
    """The steps of one filter through a stretch, and the rows whose estimate is still to come."""

    def __init__(self, kf: Any, axis: Timing, motion: Motion, out: Estimates) -> None:
        self.kf, self.axis, self.motion, self.out = kf, axis, motion, out
        self.H = kf.H.copy()
        self.elapsed: list[float] = []  # steps since the start, at every prediction
        self.models: dict[float, Any] = {1.0: motion.model(axis.step)}
        self.waiting: deque[tuple[int, int]] = deque()  # (row, its step), oldest first

    def advance(self, steps: float) -> None:
        """Predict over `steps` steps: one by one on a grid, in one go off it, not at all within a step."""
        if steps <= 0:
            return
        if self.axis.regular:
            for _ in range(round(steps) - 1):
                self._predict(1.0)
                self._deliver()
            steps = 1.0
        self._predict(steps)

    def _predict(self, steps: float) -> None:
        model = self.models.get(steps)
        if model is None:
            model = self.models[steps] = self.motion.model(steps * self.axis.step)
        self.kf.predict(F=model.F, Q=model.Q) if steps != 1.0 else self.kf.predict()
        self.elapsed.append((self.elapsed[-1] if self.elapsed else 0.0) + steps)

    def take(self, row: int, z: Array, age: float | None) -> None:
        """Update with a row and note what the filter thought of it."""
        if age is None:
            self.kf.update(z)
        else:
            delay, ahead = self._origin(age)
            self.kf.update(z, H=self._measured_ahead(ahead), delay=delay)
        y = np.asarray(self.kf.y).ravel()
        self.out.innovation[row] = y
        self.out.innovation_std[row] = np.sqrt(np.diag(self.kf.S))
        self.out.nis[row] = float(y @ self.kf.SI @ y)
        self.waiting.append((row, len(self.elapsed)))
        self._deliver()

    def _origin(self, age: float) -> tuple[int, float]:
        """The last step at or before the measurement was taken, as a delay, and how many steps after it."""
        taken = self.elapsed[-1] - age
        back = 0
        while back < len(self.elapsed) and self.elapsed[-1 - back] > taken + 0.01:
            back += 1
        if back == len(self.elapsed):  # before the first row: the grid is thought to go on backward
            back += max(0, int(np.ceil(self.elapsed[0] - 1.0 - taken - 0.01)))
            return back, max(0.0, taken - (self.elapsed[0] - (back - len(self.elapsed) + 1)))
        return back, max(0.0, taken - self.elapsed[-1 - back])

    def _measured_ahead(self, steps: float) -> Array | None:
        """H of a position `steps` steps after the state's time; None where they coincide."""
        if steps < 0.01 or self.motion.order == 0:
            return None
        ahead = self.H @ self.motion.model(steps * self.axis.step).F
        return np.asarray(ahead)

    def _deliver(self) -> None:
        """Write the estimates of all waiting rows that have seen `lag` further steps."""
        now = len(self.elapsed)
        while self.waiting and now - self.waiting[0][1] >= self.motion.lag:
            self._write(*self.waiting.popleft())

    def finish(self) -> None:
        """Write the last rows, which have fewer steps after them."""
        while self.waiting:
            self._write(*self.waiting.popleft())

    def _write(self, row: int, step: int) -> None:
        lag = len(self.elapsed) - step
        if lag and self.kf.ready:
            x, P = self.kf.smoothed(lag)
        else:
            x, P = self.kf.x, self.kf.P
        self.out.mean[row] = np.ravel(x)
        self.out.std[row] = np.sqrt(np.maximum(np.diag(P), 0.0))
