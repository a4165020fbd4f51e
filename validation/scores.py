"""Root-mean-square errors over runs, and their ratios, with standard errors."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["SETTLING", "Score", "ratio", "rmse", "squares"]

Array = NDArray[np.float64]

SETTLING = 50
"""First steps that are not scored: with ten steps of delay the filters need them to find the car."""

DIVERGED = 1e12
"""Errors beyond this, m, are counted as infinite."""


class Score(NamedTuple):
    """A number and what chance does to it.

    Attributes
    ----------
    value : float
    error : float
        Standard error, from the differences between the runs.
    single : float
        The same for one run: what chance does to a paper's only track.
    """

    value: float
    error: float
    single: float

    @property
    def against_one(self) -> float:
        """Standard error of the difference to a number that comes from one run."""
        return math.hypot(self.error, self.single)

    def __str__(self) -> str:
        return f"{self.value:.3g} ± {self.error:.1g}" if math.isfinite(self.value) else "∞"


def squares(estimates: Array, truth: Array, axis: int | None = 1) -> Array:
    """Mean squared position error of every run, (runs,), m^2.

    Parameters
    ----------
    estimates : ndarray, (runs, steps, 4)
        States [x, x', y, y'].
    truth : ndarray, (runs, steps, 2)
    axis : int or None
        1: north, the papers' y-RMSE; 0: east; None: both, the squared distance.
    """
    errors = estimates[:, SETTLING:, ::2] - truth[:, SETTLING:]
    with np.errstate(over="ignore", invalid="ignore"):
        squared = errors**2
        mean: Array = np.mean(squared.sum(axis=2) if axis is None else squared[:, :, axis], axis=1)
    return np.where(mean < DIVERGED**2, mean, np.inf)


def rmse(mean_squares: Array) -> Score:
    """Root of the mean over all runs, with the standard error that their scatter implies."""
    mean = float(mean_squares.mean())
    if not math.isfinite(mean):
        return Score(math.inf, 0.0, 0.0)
    value = math.sqrt(mean)
    single = float(mean_squares.std(ddof=1)) / (2.0 * value) if len(mean_squares) > 1 and value else 0.0
    return Score(value, single / math.sqrt(len(mean_squares)), single)


def ratio(one: Array, other: Array) -> Score:
    """Ratio of two root-mean-square errors over the same runs: what they share cancels in its error."""
    top, bottom = float(one.mean()), float(other.mean())
    if not (math.isfinite(top) and math.isfinite(bottom)):
        return Score(math.inf if math.isfinite(bottom) else 0.0, 0.0, 0.0)
    value = math.sqrt(top / bottom)
    single = value * float(np.std(one / top - other / bottom, ddof=1)) / 2.0 if len(one) > 1 else 0.0
    return Score(value, single / math.sqrt(len(one)), single)
