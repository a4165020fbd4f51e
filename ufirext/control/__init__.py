"""ufirext for python-control: finite-memory and robust estimators as I/O systems.

Names, labels, shapes and errors are those of ``control.create_estimator_iosystem`` and ``control.dlqe``.
"""

from __future__ import annotations

from .analysis import norm
from .convert import from_statespace, to_statespace
from .dead_time import with_dead_time
from .estimator import FIREstimator
from .fir import create_fms_iosystem, create_ufir_iosystem
from .gains import fms, ufir
from .hinfinity import create_hinfinity_iosystem
from .kalman import create_delay_kalman_iosystem
from .recursive import RecursiveEstimator

__all__ = [
    "FIREstimator",
    "RecursiveEstimator",
    "create_delay_kalman_iosystem",
    "create_fms_iosystem",
    "create_hinfinity_iosystem",
    "create_ufir_iosystem",
    "fms",
    "from_statespace",
    "norm",
    "to_statespace",
    "ufir",
    "with_dead_time",
]
