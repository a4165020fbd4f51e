"""One stretch of a track through one filter: as a whole on a grid, else row by row."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from math import ceil
from typing import TYPE_CHECKING, Any

import numpy as np

from .._arrays import Array
from .series import Integers, Progress, Track
from .timing import Timing, age_in_steps

if TYPE_CHECKING:
    from .run import Estimates, Motion

__all__ = ["filter_grid", "filter_rows", "new_filter"]

_CHUNK = 8192  # grid points filtered at once: bounds memory, and lets progress show
_REMEMBERED = 512  # steps whose estimate is kept to judge late rows by
_NEAR = 1e-6  # of a step; measurements this close to a step are of it
_VAGUE = 1e4  # standard deviations of a measurement: what is known before the first row


def new_filter(motion: Motion) -> Any:
    """A filter that knows nothing yet: at rest at the origin, give or take a vague prior."""
    from ..filters.ufir import UFIRFilter

    model = motion.model()
    kf = UFIRFilter(model.dim_x, model.dim_z, horizon="adaptive" if motion.adaptive else motion.horizon)
    kf.F, kf.H, kf.Q, kf.R = (np.array(each) for each in (model.F, model.H, model.Q, model.R))
    kf.x = np.zeros(model.dim_x)
    kf.P = motion.r * _VAGUE**2 * np.eye(model.dim_x)
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
    kf = new_filter(motion)
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
    """Mark the rows with a determined state and a whole window; blank what the data do not tell yet."""
    out.ready[rows] = index >= motion.order
    for state in range(out.mean.shape[1]):
        if state % (motion.order + 1):  # a derivative
            out.mean[rows, state][index < motion.order] = np.nan
            out.std[rows, state][index < motion.order] = np.nan
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
    spread: bool,
) -> int:
    """Rows off the grid, late rows, and smoothing, step by step; returns how many came too late."""
    kf = new_filter(motion)
    walk = _Walk(kf, axis.regular, motion, out, spread)
    ages = None if track.age is None else age_in_steps(track, axis)[rows]
    measured = track.position[rows] - origin
    index = np.arange(rows.stop - rows.start)
    for offset in index.tolist():
        row = rows.start + offset
        walk.advance(float(axis.steps[row]) if offset else 1.0, remember=ages is not None)
        if ages is None:
            walk.take(row, measured[offset])
        else:
            walk.take_late(row, measured[offset], float(ages[offset]))
        if offset % 1024 == 0:
            progress("filtering", row, len(track))
    walk.finish()
    _flag(out, rows, index, np.cumsum(axis.steps[rows]) - axis.steps[rows.start], motion)
    return int(kf.dropped)


class _Walk:
    """The steps of one filter through a stretch, and the rows whose estimate is still to come."""

    def __init__(self, kf: Any, regular: bool, motion: Motion, out: Estimates, spread: bool) -> None:
        self.kf, self.regular, self.motion, self.out, self.spread = kf, regular, motion, out, spread
        self.H, self.R = kf.H.copy(), kf.R.copy()
        self.elapsed: list[float] = []  # steps since the start, at every prediction
        self.models: dict[float, Any] = {}
        self.waiting: deque[tuple[int, int]] = deque()  # (row, its step), oldest first
        self.past: deque[tuple[Array, Array]] = deque(maxlen=_REMEMBERED)  # x and P as each step left them

    def advance(self, steps: float, remember: bool) -> None:
        """Predict over `steps` steps: one by one on a grid, in one go off it, not at all within a step."""
        if steps <= 0:
            return
        if self.regular:
            for _ in range(round(steps) - 1):
                self._predict(1.0, remember)
                self._deliver()
            steps = 1.0
        self._predict(steps, remember)

    def _predict(self, steps: float, remember: bool) -> None:
        if remember and self.elapsed:
            self.past.append((np.ravel(self.kf.x).copy(), self.kf.P.copy()))
        if steps == 1.0:
            self.kf.predict()
        else:
            if steps not in self.models:
                self.models[steps] = self.motion.model(steps)
            self.kf.predict(F=self.models[steps].F, Q=self.models[steps].Q)
        self.elapsed.append((self.elapsed[-1] if self.elapsed else 0.0) + steps)

    def take(self, row: int, z: Array) -> None:
        """Update with a row measured now."""
        self.kf.update(z)
        self._judge(row, np.ravel(self.kf.y), self.kf.S if self.spread else None)
        self.waiting.append((row, len(self.elapsed)))
        self._deliver()

    def take_late(self, row: int, z: Array, age: float) -> None:
        """Update with a row measured `age` steps ago; it is judged by what was known then."""
        delay, ahead = self._origin(age)
        H = self.H if ahead < _NEAR or not self.motion.order else self.H @ self.motion.model(ahead).F
        known = (np.ravel(self.kf.x), self.kf.P) if delay == 0 else None
        if 0 < delay <= len(self.past):
            known = self.past[-delay]
        if known is not None and len(self.elapsed) - delay > self.motion.order + 1:
            x, P = known
            self._judge(row, z - H @ x, H @ P @ H.T + self.R)
        self.kf.update(z, H=H, delay=delay)
        self.waiting.append((row, len(self.elapsed)))
        self._deliver()

    def _judge(self, row: int, y: Array, S: Array | None) -> None:
        self.out.innovation[row] = y
        if S is None:
            return
        self.out.innovation_std[row] = np.sqrt(np.diag(S))
        self.out.nis[row] = float(y @ np.linalg.solve(S, y))

    def _origin(self, age: float) -> tuple[int, float]:
        """The last step at or before the measurement was taken, as a delay, and how many steps after it."""
        taken = self.elapsed[-1] - age
        back = len(self.elapsed) - bisect_right(self.elapsed, taken + _NEAR)
        if back < len(self.elapsed):
            return back, max(0.0, taken - self.elapsed[-1 - back])
        # before the first row: the grid is thought to go on backward, a step apart
        before = max(0, ceil(self.elapsed[0] - 1.0 - taken - _NEAR))
        return back + before, max(0.0, taken - (self.elapsed[0] - 1.0 - before))

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
        smoothed = lag > 0 and self.kf.ready
        x, P = self.kf.smoothed(lag) if smoothed else (self.kf.x, None)
        self.out.mean[row] = np.ravel(x)
        if not self.spread:
            return
        P = self.kf.P if P is None else P
        self.out.std[row] = np.sqrt(np.maximum(np.diag(P), 0.0))
