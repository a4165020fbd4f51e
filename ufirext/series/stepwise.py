"""Series through the streaming classes, step by step: the reference, and what no faster engine holds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._arrays import Array
from ..errors import UnobservableWindow
from ..filters.fms import FMSFilterSmoother
from ..filters.ufir import UFIRFilter
from .request import Request

__all__ = ["stepwise", "stepwise_covariances"]


def stepwise(
    request: Request,
    x: Array,
    ready: NDArray[np.bool_],
    *,
    stop: int | None = None,
    P: Array | None = None,
    tick: Callable[[int], None] = lambda samples: None,
) -> None:
    """Estimates of the first `stop` steps (default: all) into x (S, T, dim_x), ready (S, T) and P."""
    steps = request.steps if stop is None else min(stop, request.steps)
    for series in range(request.count):
        f = _filter(request, series)
        for step in range(steps):
            _advance(request, f, series, step)
            at = series, step
            x[at], spread, ready[at] = _state(request, f, step, P is not None)
            if P is not None:
                P[at] = spread
        tick(steps)


def stepwise_covariances(request: Request) -> Array:
    """Error covariances of all steps, (S, T, dim_x, dim_x)."""
    shape, n = (request.count, request.steps), request.model.dim_x
    P = np.empty((*shape, n, n))
    stepwise(request, np.empty((*shape, n)), np.empty(shape, dtype=np.bool_), P=P)
    return P


def _filter(request: Request, series: int) -> Any:
    model = request.model
    f: Any
    sizes = model.dim_x, model.dim_z, model.dim_u
    if request.unbiased:
        window = "arrivals" if request.by_arrival else "origins"
        f = UFIRFilter(*sizes, horizon=request.horizon, missing=request.missing, window=window)
    else:
        f = FMSFilterSmoother(*sizes, horizon=request.horizon, lag=request.lag)
    f.F, f.H, f.Q, f.R = model.F, model.H, model.Q, model.R
    if model.B is not None:
        f.B = model.B
    n = model.dim_x
    f.x, f.P = np.zeros(n), np.eye(n)
    if request.prior is not None:
        f.x, f.P = request.prior.x[series], request.prior.P[series]
    return f


def _advance(request: Request, f: Any, series: int, step: int) -> None:
    changing = request.per_step
    F, Q, H, R = (None if a is None else a[step] for a in (changing.F, changing.Q, changing.H, changing.R))
    f.predict(u=None if request.us is None else request.us[series, step], F=F, Q=Q)
    z = np.asarray(request.z[series, step], dtype=float)
    delay = 0 if request.delays is None else int(request.delays[series, step])
    f.update(None if np.isnan(z).all() else z, R=R, H=H, delay=delay)


def _state(request: Request, f: Any, step: int, spread: bool) -> tuple[Any, Any, bool]:
    """x, P and whether the window determines it; NaN where nothing is known."""
    lag, ready = request.lag, bool(f.ready)
    if lag and ready and step >= lag:
        try:
            return (*(f.smoothed(lag) if request.unbiased else (f.x_lag, f.P_lag)), True)
        except UnobservableWindow:
            return np.nan, np.nan, False
    if lag or not (ready or request.prior is not None):
        return np.nan, np.nan, False
    return f.x, f.P if spread else np.nan, ready
