"""Known inputs: their gain over a window, and the trajectory that they lead along."""

from __future__ import annotations

import numpy as np

from .._arrays import Array
from ..gains import Gain
from ..growing import noise_paths
from ..joint import joint_gain
from ..minimum_variance import MinimumVarianceGain
from ..model import Model
from ..window import model_window

__all__ = ["input_gain", "trajectory"]

# The backward recursion ends in zero but for rounding; more than this fraction of its size is too much.
ROUNDING = 1e-14


def input_gain(model: Model, gain: Gain, unbiased: bool) -> Array:
    """L of x^ = K Z + L U over the window's transitions, oldest first: (dim_x, (horizon - 1) * dim_u).

    An input enters as process noise does, but known: L_j = D_j B.
    """
    if model.B is None or gain.horizon == 1:
        return np.zeros((model.dim_x, (gain.horizon - 1) * model.dim_u))
    if not unbiased and isinstance(gain, MinimumVarianceGain):
        return gain.L
    window = model_window(model, gain.horizon, gain.lag)
    with np.errstate(over="ignore", invalid="ignore"):
        rounding, *paths = noise_paths(window, gain.K, [window.aim])
        size = np.sqrt((np.array(paths) ** 2).sum(axis=(0, 2)))
        trusted = bool((np.sqrt((rounding**2).sum(axis=1)) <= ROUNDING * size).all())
    if trusted:
        return np.concatenate([D @ model.B for D in paths], axis=1)
    # Unstable F: the same gain by forward recursion, as minimum variance without process noise.
    quiet = model_window(model.replace(Q=0.0), gain.horizon, gain.lag)
    return joint_gain(quiet, [model.B] * (gain.horizon - 1)).L[model.dim_x :]


def trajectory(model: Model, us: Array) -> Array:
    """States (.., T, dim_x) that inputs (.., T, dim_u) lead to from zero."""
    if model.B is None:
        raise ValueError("inputs need a B")
    path = us @ model.B.T
    for step in range(1, path.shape[-2]):
        path[..., step, :] += path[..., step - 1, :] @ model.F.T
    return path
