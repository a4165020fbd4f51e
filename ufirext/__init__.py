"""ufirext: finite-memory (FIR) and robust state estimation behind filterpy's verbs."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# Public names and the modules that define them: loaded on first use (PEP 562), so that
# `import ufirext` costs no more than NumPy.
_HOME = {
    "BernoulliDelay": "channels",
    "Certificate": "certificates",
    "Channel": "channels",
    "CompensatedBernoulli": "channels",
    "CovarianceError": "errors",
    "DelayHInfinityFilter": "filters.hinfinity",
    "DelayKalmanFilter": "filters.kalman",
    "FMSFilterSmoother": "filters.fms",
    "FMSGain": "fms",
    "Fleet": "fleet",
    "Gain": "gains",
    "Guarantee": "diagnostics",
    "HorizonError": "errors",
    "InaccurateGainWarning": "joint",
    "MinimumVarianceGain": "minimum_variance",
    "Model": "model",
    "NonFiniteError": "errors",
    "OFIRGain": "optimal_fir",
    "SeriesEstimate": "series",
    "SeriesPlan": "series",
    "ShapeError": "errors",
    "StampedLoss": "channels",
    "ThetaTooLarge": "recursions",
    "TimeStamped": "channels",
    "UFIRFilter": "filters.ufir",
    "UfirextError": "errors",
    "UnconfirmedWarning": "certificates",
    "UnobservableWindow": "errors",
    "augmented_model": "recursions",
    "best_horizon": "horizon",
    "certify": "certificates",
    "discretise": "model",
    "filter_series": "series",
    "fms_gain": "fms",
    "kinematic": "model",
    "minimum_variance_gain": "minimum_variance",
    "ofir": "optimal_fir",
    "series_plan": "series",
    "ufir_gain": "gains",
    "worst_case_gain": "diagnostics",
}

__all__ = [
    "BernoulliDelay",
    "Certificate",
    "Channel",
    "CompensatedBernoulli",
    "CovarianceError",
    "DelayHInfinityFilter",
    "DelayKalmanFilter",
    "FMSFilterSmoother",
    "FMSGain",
    "Fleet",
    "Gain",
    "Guarantee",
    "HorizonError",
    "InaccurateGainWarning",
    "MinimumVarianceGain",
    "Model",
    "NonFiniteError",
    "OFIRGain",
    "SeriesEstimate",
    "SeriesPlan",
    "ShapeError",
    "StampedLoss",
    "ThetaTooLarge",
    "TimeStamped",
    "UFIRFilter",
    "UfirextError",
    "UnconfirmedWarning",
    "UnobservableWindow",
    "augmented_model",
    "best_horizon",
    "certify",
    "discretise",
    "filter_series",
    "fms_gain",
    "kinematic",
    "minimum_variance_gain",
    "ofir",
    "series_plan",
    "ufir_gain",
    "worst_case_gain",
]

if TYPE_CHECKING:
    from .certificates import Certificate, UnconfirmedWarning, certify
    from .channels import BernoulliDelay, Channel, CompensatedBernoulli, StampedLoss, TimeStamped
    from .diagnostics import Guarantee, worst_case_gain
    from .errors import (
        CovarianceError,
        HorizonError,
        NonFiniteError,
        ShapeError,
        UfirextError,
        UnobservableWindow,
    )
    from .filters.fms import FMSFilterSmoother
    from .filters.hinfinity import DelayHInfinityFilter
    from .filters.kalman import DelayKalmanFilter
    from .filters.ufir import UFIRFilter
    from .fleet import Fleet
    from .fms import FMSGain, fms_gain
    from .gains import Gain, ufir_gain
    from .horizon import best_horizon
    from .joint import InaccurateGainWarning
    from .minimum_variance import MinimumVarianceGain, minimum_variance_gain
    from .model import Model, discretise, kinematic
    from .optimal_fir import OFIRGain, ofir
    from .recursions import ThetaTooLarge, augmented_model
    from .series import SeriesEstimate, SeriesPlan, filter_series, series_plan


def __getattr__(name: str) -> Any:
    if name in _HOME:
        value = getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
