"""The packages we are compared with, and the filters of both sides configured alike."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.harness import MissingPeerError
from ufirext import Model

__all__ = ["configured", "kalman", "peer", "ufir"]


def peer(module: str, *packages: str, options: str = "") -> Any:
    """Import a module, or say the command that installs it."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        names = " ".join(packages or (module,))
        raise MissingPeerError(f"pip install {options + ' ' if options else ''}{names}") from error


def configured(f: Any, model: Model, x0: np.ndarray | None = None) -> Any:
    """A filterpy-shaped filter with the model's matrices, owned by the filter."""
    f.F, f.H, f.Q, f.R = (a.copy() for a in (model.F, model.H, model.Q, model.R))
    f.P = 100.0 * np.eye(model.dim_x)
    if model.B is not None:
        f.B = model.B.copy()
    if x0 is not None:
        f.x = x0.copy()
    return f


def kalman(model: Model) -> Any:
    """filterpy's KalmanFilter."""
    cls = peer("filterpy.kalman", "filterpy").KalmanFilter
    return configured(cls(model.dim_x, model.dim_z, model.dim_u), model)


def ufir(horizon: int | str) -> Callable[[Model], Any]:
    """A maker of UFIRFilters with this horizon."""

    def make(model: Model) -> Any:
        from ufirext import UFIRFilter

        return configured(UFIRFilter(model.dim_x, model.dim_z, model.dim_u, horizon=horizon), model)

    return make
