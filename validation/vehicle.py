"""The vehicle of the GPS papers S0, S1 and S2: constant velocity in the plane, one step a second."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ufirext import Model, kinematic

__all__ = ["HORIZON", "SIGMA_V", "misjudged", "vehicle"]

SIGMA_V = 3.75
"""Standard deviation of a measured coordinate, m: 15 m / 4, all three papers."""

HORIZON = 5
"""N_opt of S0 and S2; S1 prints none."""


def vehicle(sigma_w: float = 2.0, corner: float = 0.5) -> Model:
    """x = [x, x', y, y'], tau = 1 s, Q = sigma_w^2 [[corner, 1/2], [1/2, 1]] for each axis.

    Parameters
    ----------
    sigma_w : float
        Standard deviation of a step's velocity increment, m/s: 2 in S0, 0.2 in S1.
    corner : float
        Q[0, 0] / sigma_w^2: 1/2 in S0; 1/4, which makes Q singular, in S1.
    """
    plane = kinematic(order=1, dim=2, dt=1.0, r=SIGMA_V**2)
    axis = np.array([[corner, 0.5], [0.5, 1.0]])
    return replace(plane, Q=np.asarray(sigma_w**2 * np.kron(np.eye(2), axis), dtype=float))


def misjudged(model: Model, beta: float) -> Model:
    """What a filter believes when Q / beta^2 and beta^2 R take the place of Q and R (S1 and S2)."""
    return replace(model, Q=model.Q / beta**2, R=model.R * beta**2)
