"""Models and measurement streams of the benchmark."""

from __future__ import annotations

import numpy as np

from ufirext import Model, kinematic

__all__ = ["MODELS", "columns", "drive", "model_of"]

SEED = 20260101

MODELS = {2: (1, 1), 4: (1, 2), 9: (2, 3)}
"""States -> (order, axes) of the kinematic model."""


def model_of(states: int) -> Model:
    """Constant velocity in one axis (K=2) or two (K=4), constant acceleration in three (K=9)."""
    order, axes = MODELS[states]
    return kinematic(order, axes, 0.1, q=0.5, r=1.0)


def drive(axes: int, steps: int, noise: float = 1.0) -> np.ndarray:
    """(steps, axes): a straight path, m, measured with white noise of this standard deviation.

    Straight, so that a filter of any horizon follows it: both sides of a row must end at the same place.
    """
    rng = np.random.default_rng(SEED)
    path = 0.1 * np.arange(steps)[:, None] * np.arange(1, axes + 1)
    measured: np.ndarray = path + noise * rng.standard_normal((steps, axes))
    return measured


def columns(z: np.ndarray) -> list[np.ndarray]:
    """The rows of z as separate (dim_z, 1) arrays, filterpy's form, each with memory of its own."""
    return [row.reshape(-1, 1).copy() for row in z]
