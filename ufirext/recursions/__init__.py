"""Recursive filters as pure functions: Kalman with and without delays, and H-infinity.

Every function takes arrays and returns arrays; a state x may be flat (dim_x,) or a column (dim_x, 1), and
comes back in the same form. The classes in `ufirext.filters` hold, validate and publish; the maths is here.
"""

from __future__ import annotations

from .augmented import Lifted, augmented_model, lift, predict_lifted
from .delayed import Delayed, predict_delayed, update_delayed
from .hinfinity import ThetaTooLarge, largest_theta, tilt
from .kalman import Posterior, innovation_gain, predict, update

__all__ = [
    "Delayed",
    "Lifted",
    "Posterior",
    "ThetaTooLarge",
    "augmented_model",
    "innovation_gain",
    "largest_theta",
    "lift",
    "predict",
    "predict_delayed",
    "predict_lifted",
    "tilt",
    "update",
    "update_delayed",
]
