"""A filter over a track: one estimate for every row."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .._arrays import Array
from ..errors import HorizonError
from ..model import Model, kinematic
from .filters import FilterName
from .series import Integers, Mask, Progress, Track, silent
from .stretch import Stretch, filter_grid, filter_rows
from .timing import Timing, pieces
from .uneven import filter_uneven, is_series

__all__ = ["Estimates", "Motion", "run"]

AXES = 2
LONGEST = 10_000  # steps in a window: longer ones would take gigabytes and mean nothing


@dataclass(frozen=True)
class Motion:
    """The motion model and the knobs of the filter.

    Attributes
    ----------
    order : {0, 1, 2}
        Constant position, velocity or acceleration.
    horizon : int
        Steps in the window; with `adaptive`, the one that sets which gaps cut the track.
    q : float
        Spectral density of the process noise, m^2 per step to the power 2 order + 1.
    r : float
        Variance of one measured coordinate, m^2.
    lag : int
        Estimates are given as of `lag` steps later.
    adaptive : bool
        Let the filter choose the horizon as it goes.
    filter : {"ufir", "fms", "kalman", "hinf"}
        The last two have no window; their horizon only sets which gaps cut the track.
    theta : float or None
        Of the H-infinity filter, for position errors, 1/m^2; None: a part of its limit at each row.
    """

    order: int
    horizon: int
    q: float = 0.0
    r: float = 1.0
    lag: int = 0
    adaptive: bool = False
    filter: FilterName = "ufir"
    theta: float | None = None

    @property
    def windowed(self) -> bool:
        """Whether the filter forgets what is older than its window."""
        return self.filter in ("ufir", "fms")

    def model(self, steps: float = 1.0) -> Model:
        """The discrete model over `steps` steps: time counts steps inside the filter, whatever they last."""
        return kinematic(self.order, AXES, steps, q=self.q, r=self.r)


@dataclass(frozen=True)
class Estimates:
    """What a filter makes of a track, row by row.

    Attributes
    ----------
    mean, std : ndarray, (n, dim_x)
        States x, x', .., y, y', .. in m, m/s, .. and their standard deviations.
    innovation : ndarray, (n, 2)
        Measurement minus its prediction, m; NaN where nothing could be predicted yet.
    innovation_std : ndarray, (n, 2)
        What the filter expected of it, m.
    nis : ndarray, (n,)
        Normalised innovation squared, 2 on average when the covariances are right.
    ready : ndarray of bool, (n,)
        Whether the window determines the state; before that the estimate leans on a vague prior.
    settled : ndarray of bool, (n,)
        Whether a whole window lies behind the row.
    starts : ndarray of int
        Rows at which the filter started afresh.
    late : ndarray of bool, (n,)
        Rows that came too late for the window, or were measured before the first one: not used; their
        estimate is that of the others at the time of their arrival.
    theta : tuple of float or None
        Smallest and largest theta of an H-infinity filter, and its smallest limit, 1/m^2.
    """

    mean: Array
    std: Array
    innovation: Array
    innovation_std: Array
    nis: Array
    ready: Mask
    settled: Mask
    starts: Integers
    late: Mask
    theta: tuple[float, float, float] | None = None

    @property
    def position(self) -> Array:
        """(n, 2), m."""
        return self._axes(self.mean, 0)

    @property
    def velocity(self) -> Array:
        """(n, 2), m/s; NaN for a model without velocity."""
        return self._axes(self.mean, 1)

    @property
    def position_std(self) -> Array:
        """(n, 2), m."""
        return self._axes(self.std, 0)

    @property
    def velocity_std(self) -> Array:
        """(n, 2), m/s; NaN for a model without velocity."""
        return self._axes(self.std, 1)

    @property
    def predicted(self) -> Mask:
        """Rows that have an innovation, (n,)."""
        return np.asarray(np.isfinite(self.innovation).all(axis=1))

    def _axes(self, states: Array, derivative: int) -> Array:
        size = states.shape[1] // AXES
        if derivative >= size:
            return np.full((len(states), AXES), np.nan)
        return states[:, derivative::size]


def run(
    track: Track, axis: Timing, motion: Motion, progress: Progress = silent, *, spread: bool = True
) -> Estimates:
    """Filter a track, or smooth it with `motion.lag`; afresh after every gap longer than the window.

    Without `spread` standard deviations and NIS may be left NaN, which is faster.
    """
    if motion.horizon > LONGEST:
        raise HorizonError(f"horizon must be at most {LONGEST} steps, got {motion.horizon}")
    if motion.windowed and motion.lag >= motion.horizon:
        raise HorizonError(f"lag must be below the horizon, {motion.horizon} steps, got {motion.lag}")
    stretches = pieces(axis, motion.horizon)
    out = _blank(len(track), AXES * (motion.order + 1), [each.start for each in stretches])
    on_grid = axis.regular and track.age is None and motion.windowed
    theta = None
    for rows in stretches:
        stretch = Stretch.of(track, axis, rows)
        if on_grid:
            filter_grid(stretch, motion, out, progress)
        elif track.age is None and is_series(motion):
            filter_uneven(stretch, motion, out, progress, spread=spread)
        else:
            kf = filter_rows(stretch, motion, out, progress, spread=spread)
            theta = _wider(theta, kf) if motion.filter == "hinf" else None
        out.mean[rows, :: motion.order + 1] += track.position[rows.start]
    for state in range(out.mean.shape[1]):
        scale = axis.step ** (state % (motion.order + 1))
        out.mean[:, state] /= scale
        out.std[:, state] /= scale
    return replace(out, theta=theta)


def _wider(theta: tuple[float, float, float] | None, kf: Any) -> tuple[float, float, float]:
    """The extremes of theta, and the smallest limit, with those of another filter."""
    (low, high), limit = kf.guarantee.theta, kf.guarantee.theta_max
    return (
        (low, high, limit)
        if theta is None
        else (min(theta[0], low), max(theta[1], high), min(theta[2], limit))
    )


def _blank(rows: int, states: int, starts: list[int]) -> Estimates:
    def unknown(*shape: int) -> Array:
        return np.full(shape, np.nan)

    return Estimates(
        mean=unknown(rows, states),
        std=unknown(rows, states),
        innovation=unknown(rows, AXES),
        innovation_std=unknown(rows, AXES),
        nis=unknown(rows),
        ready=np.zeros(rows, dtype=bool),
        settled=np.zeros(rows, dtype=bool),
        starts=np.array(starts, dtype=np.int64),
        late=np.zeros(rows, dtype=bool),
    )
