"""A stretch off the grid as a series: a model for each step, all windows side by side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .._arrays import Array
from ..series.estimate import SeriesEstimate
from ..series.series import filter_series
from .filters import vague
from .series import Integers, Progress
from .stretch import CHUNK, Stretch, flag, judge

if TYPE_CHECKING:
    from .run import Estimates, Motion

__all__ = ["filter_uneven", "is_series"]


def is_series(motion: Motion) -> bool:
    """Whether a series of rows that are not late can be filtered as a whole."""
    return motion.windowed and not motion.adaptive and (motion.filter == "ufir" or not motion.lag)


def filter_uneven(
    stretch: Stretch, motion: Motion, out: Estimates, progress: Progress, *, spread: bool = True
) -> None:
    """Rows off the grid, none of them late, as `filter_rows` filters them."""
    series, count = _Series.of(stretch, motion), len(stretch.steps)
    size = max(CHUNK, 4 * motion.horizon)
    for first in range(0, count, size):
        rows = slice(first, min(count, first + size))
        target = slice(stretch.rows.start + rows.start, stretch.rows.start + rows.stop)
        _fill(out, target, series, rows, spread=spread)
        if motion.lag:
            _smooth(out, target, series, rows, spread=spread)
        progress("filtering", target.stop, len(out.nis))
    flag(out, stretch, motion)


@dataclass(frozen=True)
class _Series:
    """Positions, the models for all lengths of a step, and which of these leads to each row."""

    motion: Motion
    z: Array
    F: Array
    Q: Array
    which: Integers

    @classmethod
    def of(cls, stretch: Stretch, motion: Motion) -> _Series:
        lengths, which = np.unique(np.concatenate([[1.0], stretch.steps[1:]]), return_inverse=True)
        models = [motion.model(length) for length in lengths.tolist()]
        F, Q = np.array([model.F for model in models]), np.array([model.Q for model in models])
        return cls(motion, stretch.measured, F, Q, which)

    def leading(self, rows: slice) -> tuple[Array, Array]:
        """F and Q of the steps to some rows."""
        return self.F[self.which[rows]], self.Q[self.which[rows]]

    def estimate(self, begin: int, stop: int, lag: int = 0) -> SeriesEstimate:
        """From the rows begin .. stop - 1; the first ones of a stretch start from a vague prior."""
        model, (F, Q) = self.motion.model(), self.leading(slice(begin, stop))
        return filter_series(
            model,
            self.z[begin:stop],
            self.motion.horizon,
            lag=lag,
            noise=None if self.motion.filter == "ufir" else (model.Q, model.R),
            prior=None if begin or lag else vague(self.motion),
            Fs=F,
            Qs=Q,
        )


def _fill(out: Estimates, target: slice, series: _Series, rows: slice, *, spread: bool) -> None:
    """The estimates of some rows, with their innovations."""
    begin = max(0, rows.start - series.motion.horizon)  # the row before them has its whole window, too
    now, here = series.estimate(begin, rows.stop), slice(rows.start - begin, None)
    before = np.maximum(np.arange(rows.start, rows.stop) - begin - 1, 0)  # that of the first row is blanked
    model, (F, Q) = series.motion.model(), series.leading(rows)
    y = series.z[rows] - (F @ now.x[before, :, None])[:, :, 0] @ model.H.T
    out.mean[target], out.innovation[target] = now.x[here], y
    if spread:
        P = F @ now.P[before] @ F.transpose(0, 2, 1) + Q
        judge(out, target, y, model.H @ P @ model.H.T + model.R)
        out.std[target] = _deviations(now.P[here])


def _smooth(out: Estimates, target: slice, series: _Series, rows: slice, *, spread: bool) -> None:
    """The same rows `lag` steps later, the last ones of all as many as there are."""
    count, lag, horizon = len(series.z), series.motion.lag, series.motion.horizon
    whole = max(rows.start, min(rows.stop, count - lag))
    begin = max(0, rows.start + lag - horizon + 1)
    pieces = [(rows.start, whole, begin, lag)] if whole > rows.start else []
    pieces += [(row, row + 1, max(0, count - horizon), count - 1 - row) for row in range(whole, rows.stop)]
    for first, stop, begin, behind in pieces:
        later = series.estimate(begin, stop + behind, behind)
        here = slice(first + behind - begin, None)
        ready = later.ready[here]
        place = target.start + np.arange(first, stop)[ready] - rows.start
        out.mean[place] = later.x[here][ready]
        if spread:
            out.std[place] = _deviations(later.P[here][ready])


def _deviations(P: Array) -> Array:
    return np.asarray(np.sqrt(np.maximum(np.diagonal(P, axis1=1, axis2=2), 0.0)))
