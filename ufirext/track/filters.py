"""The filters that can go over a track, and what each of them needs beside the motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from .._arrays import Array
from ..errors import HorizonError
from ..model import Model

if TYPE_CHECKING:
    from .run import Motion

__all__ = ["FilterName", "new_filter", "vague", "whole_window"]

FilterName = Literal["ufir", "fms", "kalman", "hinf"]

_VAGUE = 1e4  # standard deviations of a measurement: what is known before the first row
_DEEPEST = 200  # steps whose states, or noises, a filter without a window remembers


def new_filter(motion: Motion, oldest: int = 0) -> Any:
    """A filter that knows nothing yet: at rest at the origin, give or take a vague prior.

    Parameters
    ----------
    motion : Motion
    oldest : int, optional
        How many steps late the latest row is; filters without a window take rows up to 200 steps late.

    Raises
    ------
    HorizonError
        If a filter without a window would have to remember too many steps for the lag.
    """
    model = motion.model()
    kf = _made(model, motion, oldest)
    kf.F, kf.H, kf.Q, kf.R = (np.array(each) for each in (model.F, model.H, model.Q, model.R))
    kf.x, kf.P = vague(motion)
    return kf


def vague(motion: Motion) -> tuple[Array, Array]:
    """What is known before the first row: x and P."""
    states = motion.model().dim_x
    return np.zeros(states), motion.r * _VAGUE**2 * np.eye(states)


def _made(model: Model, motion: Motion, oldest: int) -> Any:
    dims = model.dim_x, model.dim_z
    if motion.filter == "ufir":
        from ..filters.ufir import UFIRFilter

        return UFIRFilter(*dims, horizon="adaptive" if motion.adaptive else motion.horizon)
    if motion.filter == "fms":
        from ..filters.fms import FMSFilterSmoother

        return FMSFilterSmoother(*dims, horizon=motion.horizon, lag=motion.lag)
    if motion.lag > _DEEPEST:
        raise HorizonError(
            f"lag must be at most {_DEEPEST} steps for {motion.filter}, got {motion.lag}; "
            "the filters ufir and fms take longer ones"
        )
    remembered = max(min(oldest, _DEEPEST), motion.lag)
    if motion.filter == "kalman":
        from ..filters.kalman import DelayKalmanFilter

        method = "augmented" if motion.lag else "exact"
        return DelayKalmanFilter(*dims, max_delay=remembered, method=method)
    from ..filters.hinfinity import DelayHInfinityFilter

    theta = "auto" if motion.theta is None else motion.theta
    # The errors of the position count; a bound on those of its derivatives would depend on the unit of time.
    return DelayHInfinityFilter(*dims, max_delay=remembered, theta=theta, S=model.H.T @ model.H)


def whole_window(motion: Motion, lag: int) -> tuple[Array, Array]:
    """Gain on a window without holes, oldest row first, and the covariance of its estimate."""
    if motion.filter == "ufir":
        from ..gains import ufir_gain

        gain = ufir_gain(motion.model(), motion.horizon, lag)
        return gain.K, gain.P
    from ..minimum_variance import minimum_variance_gain

    best = minimum_variance_gain(motion.model(), motion.horizon, lag)
    return best.K, best.P
