"""Which engine filters which series, and the engines as functions of a request."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from .._arrays import Array
from ..engines.records import Limits
from ..errors import UfirextError
from ..gains import observability_index
from . import arguments
from .constant import Tick, convolved
from .growth import GROUP
from .holes import Holes, hole_plan, present_in
from .plan import SeriesPlan, series_plan
from .request import Request
from .rows import Rows, rows_of
from .scan import Scan, Scanner
from .stepwise import stepwise
from .variance import VarianceScan
from .windows import Mask, Windows

__all__ = ["CONSTANT", "ENGINES", "SCAN", "kinds_of", "limits_of", "plan_of", "run"]

ENGINES = ("auto", "toeplitz", "scan", "stepwise", "numba")
# What a series needs.
CONSTANT, HOLES, SCAN, STEPWISE = range(4)
# Numbers of growing windows that are worked out together, so that they stay in a processor's cache.
GROWING_TOGETHER = 16_384


def plan_of(request: Request) -> SeriesPlan:
    """The plan of a request's constant model."""
    return series_plan(request.model, request.horizon, request.lag, unbiased=request.unbiased)


def limits_of(request: Request) -> Limits:
    """How far windows go."""
    index = observability_index(request.model) or 1
    return Limits(request.horizon, index + 2, request.missing != "skip", request.by_arrival)


def kinds_of(request: Request, engine: str) -> NDArray[np.int8]:
    """What each series needs: CONSTANT, HOLES, SCAN or STEPWISE."""
    scannable = request.unbiased or (request.lag == 0 and request.delays is None)
    if (engine == "numba" and not request.unbiased) or (engine == "scan" and not scannable):
        other = " or minimum variance without lag and delays" if engine == "scan" else ""
        raise UfirextError(f'engine="{engine}" needs UFIR (noise=None){other}; use engine="auto"')
    kinds: NDArray[np.int8] = np.full(request.count, CONSTANT, dtype=np.int8)
    broken = arguments.holes(request.z)
    simple = request.per_step.empty and request.delays is None
    if engine == "toeplitz" and (broken.any() or not simple):
        raise UfirextError(
            'engine="toeplitz" needs a constant model and series without holes and delays; use engine="auto"'
        )
    if engine == "stepwise" or (request.missing == "predict" and broken.any()):
        kinds[:] = STEPWISE
    elif engine in ("scan", "numba") or not simple:
        kinds[:] = SCAN if scannable else STEPWISE
    elif broken.any():
        plan = hole_plan(plan_of(request), request.missing != "skip")
        for series in np.flatnonzero(broken).tolist():
            held = request.us is None and plan.holds(present_in(request, series))
            kinds[series] = HOLES if held else SCAN if scannable else STEPWISE
    return kinds


def run(request: Request, kinds: NDArray[np.int8], engine: str, x: Array, ready: Mask, tick: Tick) -> None:
    """Filter every series by what it needs, into x (S, T, dim_x) and ready (S, T)."""
    scanned = partial(_scanned, scanner=_compiled()) if engine == "numba" else _scanned
    for kind, filtered in ((CONSTANT, _constant), (HOLES, _holes), (SCAN, scanned), (STEPWISE, _by_steps)):
        chosen = kinds == kind
        if chosen.all() and len(chosen) and (kind == CONSTANT or x.dtype == np.float64):
            filtered(request, x, ready, tick)
        elif chosen.any():
            part = np.empty((int(chosen.sum()), *x.shape[1:]))
            seen = np.zeros(part.shape[:2], dtype=np.bool_)
            filtered(request.only(chosen), part, seen, tick)
            x[chosen], ready[chosen] = part, seen


def _by_steps(request: Request, x: Array, ready: Mask, tick: Tick) -> None:
    stepwise(request, x, ready, tick=tick)


def _constant(request: Request, x: Array, ready: Mask, tick: Tick) -> None:
    """A constant model and series without holes."""
    plan, z, us = plan_of(request), request.z, request.us
    if us is None:
        convolved(plan.summed, z, x, plan.alignment, tick)
    else:
        convolved(plan.with_inputs, np.concatenate([z, us], axis=2), x, plan.alignment, tick)
    begin = min(plan.horizon - 1, request.steps)
    if begin and plan.head is None:
        stepwise(request, x, ready, stop=begin)
        ready[:, begin:] = True
        return
    if begin:
        _growing(plan, z[:, :begin], None if us is None else us[:, :begin], x[:, :begin])
    ready[:, plan.first - 1 :] = True
    if request.prior is not None and plan.first > 1:
        stepwise(request, x, ready, stop=plan.first - 1)


def _growing(plan: SeriesPlan, z: Array, us: Array | None, x: Array) -> None:
    """Windows that are not full yet, some groups of series at a time."""
    together = GROUP * max(1, GROWING_TOGETHER // (GROUP * x[0].size))
    for first in range(0, len(x), together):
        some = slice(first, first + together)
        x[some] = plan.head_states(z[some], None if us is None else us[some])


def _holes(request: Request, x: Array, ready: Mask, tick: Tick) -> None:
    """A constant model and series with holes, one after the other."""
    plan = hole_plan(plan_of(request), request.missing != "skip")
    for series in range(request.count):
        one = request.only(slice(series, series + 1))
        z, present = np.asarray(one.z[0], dtype=float), present_in(request, series)
        filled = replace(one, z=np.where(present, z, 0.0)[None], prior=None)
        _constant(filled, x[series : series + 1], ready[series : series + 1], lambda samples: None)
        windows = Holes(plan, z, present, request.missing)
        windows.fill(x[series], ready[series], windows.broken)
        if request.prior is not None and not ready[series].all():
            _warm_up(one, x[series], ready[series])
        tick(request.steps)


def _scanned(request: Request, x: Array, ready: Mask, tick: Tick, scanner: Scanner | None = None) -> None:
    """Whatever changes from step to step, one series after the other."""
    limits = limits_of(request)
    for series in range(request.count):
        one, rows = request.only(slice(series, series + 1)), rows_of(request, series, limits)
        if rows is None:
            stepwise(one, x[series : series + 1], ready[series : series + 1])
        else:
            _windows(request, rows, limits, scanner).fill(x[series], ready[series])
            if request.prior is not None and not ready[series].all():
                _warm_up(one, x[series], ready[series])
        tick(request.steps)


def _windows(request: Request, rows: Rows, limits: Limits, scanner: Scanner | None) -> Windows:
    if request.unbiased:
        return Scan(rows, limits, request.lag, request.missing == "extend", scanner)
    Q = request.model.Q if request.per_step.Q is None else request.per_step.Q
    return VarianceScan(rows, np.broadcast_to(Q, (request.steps, *Q.shape[-2:])), limits)


def _compiled() -> Scanner:
    try:
        from .compiled import scan_series
    except ImportError as error:
        raise ImportError(
            'engine="numba" needs numba: pip install \'ufirext[numba]\', or use engine="auto"'
        ) from error
    scanner: Scanner = scan_series
    return scanner


def _warm_up(request: Request, x: Array, ready: Mask) -> None:
    """What the Kalman filter of the prior says wherever the window does not suffice."""
    missing = np.flatnonzero(~ready)
    states, seen = np.empty((1, *x.shape)), np.empty((1, len(x)), dtype=np.bool_)
    stepwise(request, states, seen, stop=int(missing[-1]) + 1)
    x[missing] = states[0, missing]
