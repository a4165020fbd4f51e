"""ufirext: finite-memory (FIR) and robust state estimation behind filterpy's verbs."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# Public names and the modules that define them: loaded on first use (PEP 562), so that
# `import ufirext` costs no more than NumPy.
_HOME = {
    "CovarianceError": "errors",
    "Gain": "gains",
    "HorizonError": "errors",
    "Model": "model",
    "NonFiniteError": "errors",
    "ShapeError": "errors",
    "UFIRFilter": "filters.ufir",
    "UfirextError": "errors",
    "UnobservableWindow": "errors",
    "best_horizon": "horizon",
    "discretise": "model",
    "kinematic": "model",
    "ufir_gain": "gains",
}

__all__ = [
    "CovarianceError",
    "Gain",
    "HorizonError",
    "Model",
    "NonFiniteError",
    "ShapeError",
    "UFIRFilter",
    "UfirextError",
    "UnobservableWindow",
    "best_horizon",
    "discretise",
    "kinematic",
    "ufir_gain",
]

if TYPE_CHECKING:
    from .errors import CovarianceError, HorizonError, NonFiniteError, ShapeError, UfirextError, UnobservableWindow
    from .filters.ufir import UFIRFilter
    from .gains import Gain, ufir_gain
    from .horizon import best_horizon
    from .model import Model, discretise, kinematic


def __getattr__(name: str) -> Any:
    if name in _HOME:
        value = getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
