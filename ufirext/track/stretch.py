"""One stretch of a track through one filter: as a whole on a grid, else row by row."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .._arrays import Array
from .filters import new_filter
from .grid import on_grid, reach
from .series import Integers, Progress, Track
from .timing import Timing, age_in_steps

if TYPE_CHECKING:
    from .run import Estimates, Motion

__all__ = ["CHUNK", "Stretch", "filter_grid", "filter_rows", "flag", "judge"]

CHUNK = 16_384  # rows filtered at once: bounds memory, and lets progress show
_REMEMBERED = 512  # steps whose estimate is kept to judge late rows by
_NEAR = 1e-6  # of a step; measurements this close to a step are of it


@dataclass(frozen=True)
class Stretch:
    """Rows of a track without a long gap between them.

    Attributes
    ----------
    rows : slice
        Where they stand in the track.
    steps : ndarray, (n,)
        Steps since the row before.
    measured : ndarray, (n, 2)
        Positions relative to the first one, m: large coordinates (UTM) would cost digits.
    ages : ndarray, (n,), or None
        How old they were on arrival, in steps.
    regular : bool
        Whether the rows lie on a grid.
    """

    rows: slice
    steps: Array
    measured: Array
    ages: Array | None
    regular: bool

    @classmethod
    def of(cls, track: Track, axis: Timing, rows: slice) -> Stretch:
        """The rows of a track."""
        ages = None if track.age is None else age_in_steps(track, axis)[rows]
        measured = track.position[rows] - track.position[rows.start]
        return cls(rows, axis.steps[rows], measured, ages, axis.regular)

    @property
    def point(self) -> Array:
        """Steps from the first row to each, (n,)."""
        passed = np.cumsum(self.steps)
        return np.asarray(passed - passed[0])

    def origins(self) -> tuple[Integers, Array]:
        """The last prediction at or before each measurement was taken, as a delay, and the steps after it."""
        counts = np.rint(self.steps) if self.regular else self.steps > 0
        counts[0] = 1
        last = np.cumsum(counts).astype(np.int64)  # predictions so far, at each row
        now = 1.0 + self.point
        times = np.arange(1.0, last[-1] + 1.0) if self.regular else now[np.flatnonzero(counts)]
        taken = now - (0.0 if self.ages is None else self.ages)
        place = np.minimum(np.searchsorted(times, taken + _NEAR, side="right"), last)
        # before the first row: the grid is thought to go on backward, a step apart
        before = np.maximum(np.ceil(-taken - _NEAR), 0.0)
        since = np.where(place > 0, times[np.maximum(place - 1, 0)], -before)
        delay = last - place + np.where(place > 0, 0.0, before)
        return delay.astype(np.int64), np.maximum(taken - since, 0.0)


def filter_grid(stretch: Stretch, motion: Motion, out: Estimates, progress: Progress) -> None:
    """Rows on a grid, one measurement a step at most, some points of it empty."""
    point = stretch.point.astype(int)
    end = int(point[-1]) + 1
    size = max(CHUNK, 4 * reach(motion))
    for first in range(0, end, size):
        begin, stop = max(0, first - reach(motion)), min(end, first + size)
        ahead = min(end, stop + motion.lag)
        known = slice(*np.searchsorted(point, [begin, ahead]))
        zs = np.full((ahead - begin, stretch.measured.shape[1]), np.nan)
        zs[point[known] - begin] = stretch.measured[known]
        here = slice(*np.searchsorted(point, [first, stop]))
        target = slice(stretch.rows.start + here.start, stretch.rows.start + here.stop)
        _fill(out, target, zs, point[here] - begin, motion)
        progress("filtering", target.stop, len(out.nis))
    flag(out, stretch, motion)


def _fill(out: Estimates, target: slice, zs: Array, place: Integers, motion: Motion) -> None:
    """The estimates at some places of a piece of a grid, with the innovations there."""
    model = motion.model()
    means, covs = on_grid(zs, motion)
    before = np.maximum(place - 1, 0)  # the first row of all has nothing before it; it is blanked
    y = zs[place] - means[before] @ (model.H @ model.F).T
    S = model.H @ (model.F @ covs[before] @ model.F.T + model.Q) @ model.H.T + model.R
    judge(out, target, y, S)
    if motion.lag:
        means, covs = on_grid(zs, motion, motion.lag)
    out.mean[target] = means[place]
    out.std[target] = np.sqrt(np.maximum(np.diagonal(covs[place], axis1=1, axis2=2), 0.0))


def judge(out: Estimates, target: slice, y: Array, S: Array) -> None:
    """Innovations (n, 2) and what the filter expected of them, (n, 2, 2)."""
    out.innovation[target] = y
    out.innovation_std[target] = np.sqrt(np.diagonal(S, axis1=1, axis2=2))
    with np.errstate(over="ignore"):  # told a sigma that is nothing, anything is impossible
        out.nis[target] = np.einsum("ni,ni->n", y, np.linalg.solve(S, y[:, :, None])[:, :, 0])


def flag(out: Estimates, stretch: Stretch, motion: Motion) -> None:
    """Mark the rows with a determined state and a whole window; blank what the data do not tell yet."""
    rows, index = stretch.rows, np.arange(len(stretch.steps))
    out.ready[rows] = index >= motion.order
    for state in range(out.mean.shape[1]):
        if state % (motion.order + 1):  # a derivative
            out.mean[rows, state][index < motion.order] = np.nan
            out.std[rows, state][index < motion.order] = np.nan
    out.settled[rows] = (stretch.point >= motion.horizon) & (index > motion.order + 2)
    for judged in (out.innovation, out.innovation_std, out.nis):
        judged[rows][index <= motion.order] = np.nan


def filter_rows(
    stretch: Stretch, motion: Motion, out: Estimates, progress: Progress, *, spread: bool = True
) -> Any:
    """Rows off the grid and late rows, step by step; marks those that came too late, returns the filter."""
    late = stretch.ages is not None
    delays, ahead = stretch.origins()
    kf = new_filter(motion, int(delays.max()))
    usable = delays <= (len(out.nis) if motion.windowed else kf.max_delay)
    walk = _Walk(kf, stretch.regular, motion, out, spread)
    for offset, (steps, z) in enumerate(zip(stretch.steps.tolist(), stretch.measured, strict=True)):
        row = stretch.rows.start + offset
        walk.advance(steps if offset else 1.0, remember=late)
        before = kf.dropped
        if not usable[offset]:
            walk.pass_over(row)
        elif late:
            walk.take_late(row, z, int(delays[offset]), float(ahead[offset]))
        else:
            walk.take(row, z)
        out.late[row] = not usable[offset] or kf.dropped > before
        if offset % 1024 == 0 or row + 1 == stretch.rows.stop:
            progress("filtering", row + 1, len(out.nis))
    walk.finish()
    flag(out, stretch, motion)
    return kf


class _Walk:
    """The steps of one filter through a stretch, and the rows whose estimate is still to come."""

    def __init__(self, kf: Any, regular: bool, motion: Motion, out: Estimates, spread: bool) -> None:
        self.kf, self.regular, self.motion, self.out, self.spread = kf, regular, motion, out, spread
        self.H, self.R = kf.H.copy(), kf.R.copy()
        self.now = 0  # predictions so far
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
                self.kf.update(None)
                self._deliver()
            steps = 1.0
        self._predict(steps, remember)

    def _predict(self, steps: float, remember: bool) -> None:
        if remember and self.now:
            self.past.append((np.ravel(self.kf.x).copy(), self.kf.P.copy()))
        if steps == 1.0:
            self.kf.predict()
        else:
            if steps not in self.models:
                self.models[steps] = self.motion.model(steps)
            self.kf.predict(F=self.models[steps].F, Q=self.models[steps].Q)
        self.now += 1

    def take(self, row: int, z: Array) -> None:
        """Update with a row measured now."""
        self.kf.update(z)
        self._judge(row, np.ravel(self.kf.y), self.kf.S if self.spread else None)
        self.waiting.append((row, self.now))
        self._deliver()

    def take_late(self, row: int, z: Array, delay: int, ahead: float) -> None:
        """Update with a row measured `ahead` steps after a past prediction, judged by what was known then."""
        H = self.H if ahead < _NEAR or not self.motion.order else self.H @ self.motion.model(ahead).F
        known = (np.ravel(self.kf.x), self.kf.P) if delay == 0 else None
        if 0 < delay <= len(self.past):
            known = self.past[-delay]
        if known is not None and self.now - delay > self.motion.order + 1:
            x, P = known
            self._judge(row, z - H @ x, H @ P @ H.T + self.R)
        self.kf.update(z, H=H, delay=delay)
        self.waiting.append((row, self.now))
        self._deliver()

    def pass_over(self, row: int) -> None:
        """A row too old for the filter: the estimate goes on without it."""
        self.kf.update(None)
        self.waiting.append((row, self.now))
        self._deliver()

    def _judge(self, row: int, y: Array, S: Array | None) -> None:
        self.out.innovation[row] = y
        if S is None:
            return
        self.out.innovation_std[row] = np.sqrt(np.diag(S))
        with np.errstate(over="ignore"):  # told a sigma that is nothing, anything is impossible
            self.out.nis[row] = float(y @ np.linalg.solve(S, y))

    def _deliver(self) -> None:
        """Write the estimates of all waiting rows that have seen `lag` further steps."""
        while self.waiting and self.now - self.waiting[0][1] >= self.motion.lag:
            self._write(*self.waiting.popleft())

    def finish(self) -> None:
        """Write the last rows, which have fewer steps after them."""
        while self.waiting:
            self._write(*self.waiting.popleft())

    def _write(self, row: int, step: int) -> None:
        lag = self.now - step
        smoothed = lag > 0 and self.kf.ready
        x, P = self.kf.smoothed(lag) if smoothed else (self.kf.x, None)
        self.out.mean[row] = np.ravel(x)
        if not self.spread:
            return
        P = self.kf.P if P is None else P
        self.out.std[row] = np.sqrt(np.maximum(np.diag(P), 0.0))
