"""filter_series: whole recorded series through the finite-memory filters."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._array_api import is_native
from .._arrays import Array, integer
from ..engines.records import Limits
from ..errors import UfirextError
from ..filters._window_state import MISSING, WINDOWS
from ..gains import observability_index
from ..model import Model
from . import arguments
from .constant import Tick, convolved, head_covariances
from .estimate import SeriesEstimate
from .holes import Holes, hole_plan, present_in
from .plan import SeriesPlan, chosen_horizon, model_with, series_plan
from .progress import Progress, ticking
from .request import PerStep, Request
from .rows import rows_of
from .scan import Scan, Scanner
from .stepwise import stepwise, stepwise_covariances

__all__ = ["filter_series"]

Mask = NDArray[np.bool_]
# Numbers of growing windows that are worked out together, so that they stay in a processor's cache.
GROWING_TOGETHER = 16_384
CONSTANT, HOLES, SCAN, STEPWISE = range(4)
ENGINES = ("auto", "toeplitz", "scan", "stepwise", "numba")


def filter_series(
    model: Model,
    zs: ArrayLike,
    horizon: int | str,
    *,
    lag: int = 0,
    us: ArrayLike | None = None,
    delays: ArrayLike | None = None,
    missing: str = "extend",
    noise: tuple[ArrayLike, ArrayLike] | None = None,
    window: str = "arrivals",
    engine: str = "auto",
    out: Array | None = None,
    progress: Progress = False,
    prior: tuple[ArrayLike, ArrayLike] | None = None,
    Fs: ArrayLike | None = None,
    Qs: ArrayLike | None = None,
    Hs: ArrayLike | None = None,
    Rs: ArrayLike | None = None,
) -> SeriesEstimate:
    """Filter whole series: the numbers of the streaming classes, thousands of times faster where possible.

    Every estimate depends on the measurements of its window alone, so that all of a series can be worked out
    at once. Of a constant model without holes it is one block-Toeplitz matrix product.

    Parameters
    ----------
    model : Model
    zs : array_like, (T, dim_z) or (S, T, dim_z)
        One series, or S of them; (T,) where dim_z is 1. NaN (or None in a list) is a missing component.
        Arrays of torch, JAX or CuPy without NaN are filtered by their library, on their device and in their
        dtype, where the model is constant (needs array-api-compat).
    horizon : int or "auto"
        Length of the window in steps; "auto" is `best_horizon` of the model.
    lag : int, optional
        Row n of the result is the state of step n - lag.
    us : array_like, (T, dim_u) or (S, T, dim_u), optional
        Known inputs: u of step n enters on the way from step n - 1 to n, as in ``predict(u)``.
    delays : array_like of int, (T,) or (S, T), optional
        The measurement that came in step n is of the state of step n - delays[n].
    missing : {"extend", "skip", "predict"}
        What a step without a measurement does, as in `UFIRFilter`.
    noise : (Q, R), optional
        None: UFIR, which needs no Q. A pair: minimum variance under it, as in `FMSFilterSmoother`.
    window : {"arrivals", "origins"}
        As in `UFIRFilter`.
    engine : {"auto", "toeplitz", "scan", "stepwise", "numba"}
        How it is done; all give the same numbers. "toeplitz": matrix products, for constant models without
        holes. "scan": blocks side by side, for UFIR of any kind. "numba": the same as a compiled loop (needs
        numba; the first call compiles). "stepwise": the streaming classes, whatever the series holds.
    out : ndarray of float, (T, dim_x) or (S, T, dim_x), optional
        Where x is written; may be memory-mapped.
    progress : bool or callable
        True shows a bar (needs rich); a callable is called with (samples done, samples in all).
    prior : (x, P), optional
        State before the first step and its covariance, one for all series or one each. With it the rows
        before the window suffices are the Kalman filter's; without it they are NaN.
    Fs, Qs, Hs, Rs : array_like, (T, ..), optional
        Matrices of each step in place of the model's, as in filterpy's ``batch_filter``.

    Returns
    -------
    SeriesEstimate
        ``.x`` (T, dim_x) or (S, T, dim_x), ``.ready``, ``.horizon``, and ``.P`` once somebody reads it.

    Raises
    ------
    UnobservableWindow
        If full windows of a constant model cannot determine the state.
    ValueError
        For wrong shapes, infinite measurements, words that are none of those above.

    Notes
    -----
    Windows of N measurements are a convolution with N matrices g_i. Blocks of B outputs share their samples;
    because g_i is a sum of few exponentials, those that all outputs of a block share enter through a few
    moments. The cost is flat in N, nothing is recursive, and nothing drifts. `series_plan` shows the plan.

    Examples
    --------
    >>> import numpy as np
    >>> from ufirext import filter_series, kinematic
    >>> path = 0.5 * np.arange(1000.0)
    >>> filter_series(kinematic(1, 1, 0.1), path, horizon=50).x[-1].round(6)
    array([499.5,   5. ])
    """
    arguments.one_of(engine, ENGINES, "engine")
    given = {"F": Fs, "Q": Qs, "H": Hs, "R": Rs}
    if not is_native(zs):
        from .elsewhere import filtered_elsewhere

        refused = {
            "us": us,
            "delays": delays,
            "out": out,
            "prior": prior,
            **{f"{k}s": given[k] for k in given},
        }
        return filtered_elsewhere(series_plan(model, horizon, lag, noise), zs, engine, refused)
    series, many = arguments.as_series(zs, model.dim_z)
    changing = PerStep(**arguments.as_per_step(given, model, series.shape[1]))
    horizon, lag = _window(model, horizon, lag)
    shape = series.shape[:2]
    request = Request(
        model=model_with(model, noise),
        z=series,
        horizon=horizon,
        lag=lag,
        unbiased=noise is None,
        missing=missing,
        by_arrival=window == "arrivals",
        us=arguments.as_inputs(us, model, shape),
        delays=arguments.as_delays(delays, shape),
        prior=arguments.as_prior(prior, model, shape[0]),
        per_step=changing,
    )
    _require_possible(request, window)
    x = arguments.as_output(out, (*shape, model.dim_x) if many else (shape[1], model.dim_x))
    ready: Mask = np.zeros(shape, dtype=np.bool_)
    kinds = _kinds(request, engine)
    with ticking(progress, shape[0] * shape[1]) as tick:
        _run(request, kinds, engine, x if many else x[None], ready, tick)
    covariances = partial(_covariances, request, kinds, many)
    return SeriesEstimate(x, ready if many else ready[0], horizon, lag, covariances)


def _window(model: Model, horizon: int | str, lag: int) -> tuple[int, int]:
    """Horizon and lag, checked."""
    chosen = chosen_horizon(model, horizon)
    return chosen, integer(lag, "lag", 0, chosen - 1, "the window holds horizon states, up to the newest one")


def _require_possible(request: Request, window: str) -> None:
    """Refuse combinations that no filter of the library has."""
    arguments.one_of(window, WINDOWS, "window")
    arguments.one_of(request.missing, MISSING, "missing")
    if request.per_step.F is None and request.per_step.H is None:
        _plan(request)  # raises where full windows of the constant model do not determine the state
    if request.prior is not None and request.lag:
        raise UfirextError(
            f"a prior needs lag=0, because the warm-up has no lagged states, got lag={request.lag}"
        )
    if request.unbiased:
        return
    if request.missing != "extend":
        raise UfirextError(
            f'minimum variance needs missing="extend", the only way its filter has, got {request.missing!r}'
        )
    if request.delays is not None and window == "arrivals":
        raise UfirextError(
            'minimum variance with delays needs window="origins": its window holds the states of the last '
            "horizon steps"
        )


def _kinds(request: Request, engine: str) -> NDArray[np.int8]:
    """What each series needs: CONSTANT, HOLES, SCAN or STEPWISE."""
    if engine in ("scan", "numba") and not request.unbiased:
        raise UfirextError(f'engine="{engine}" needs UFIR (noise=None); use engine="auto"')
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
        kinds[:] = SCAN if request.unbiased else STEPWISE
    elif broken.any():
        plan = hole_plan(_plan(request), request.missing != "skip")
        for series in np.flatnonzero(broken).tolist():
            held = request.us is None and plan.holds(present_in(request, series))
            kinds[series] = HOLES if held else SCAN if request.unbiased else STEPWISE
    return kinds


def _run(request: Request, kinds: NDArray[np.int8], engine: str, x: Array, ready: Mask, tick: Tick) -> None:
    scanned = partial(_scanned, scanner=_compiled()) if engine == "numba" else _scanned
    for kind, run in ((CONSTANT, _constant), (HOLES, _holes), (SCAN, scanned), (STEPWISE, _by_steps)):
        chosen = kinds == kind
        if chosen.all() and len(chosen):
            run(request, x, ready, tick)
        elif chosen.any():
            part = np.empty((int(chosen.sum()), *x.shape[1:]))
            seen = np.zeros(part.shape[:2], dtype=np.bool_)
            run(request.only(chosen), part, seen, tick)
            x[chosen], ready[chosen] = part, seen


def _by_steps(request: Request, x: Array, ready: Mask, tick: Tick) -> None:
    stepwise(request, x, ready, tick=tick)


def _constant(request: Request, x: Array, ready: Mask, tick: Tick) -> None:
    """A constant model and series without holes."""
    plan, z, us = _plan(request), request.z, request.us
    if us is None:
        convolved(plan.convolution, z, x, plan.alignment, tick)
    else:
        convolved(plan.with_inputs, np.concatenate([z, us], axis=2), x, plan.alignment, tick)
    begin = min(plan.horizon - 1, request.steps)
    if begin and plan.head is None:
        stepwise(request, x, ready, stop=begin)
        ready[:, begin:] = True
        return
    if begin:
        together = max(1, GROWING_TOGETHER // (begin * request.model.dim_x))
        for first in range(0, request.count, together):
            some = slice(first, first + together)
            pushed = None if us is None else us[some, :begin]
            x[some, :begin] = plan.head_states(np.asarray(z[some, :begin], dtype=float), pushed)
    ready[:, plan.first - 1 :] = True
    if request.prior is not None and plan.first > 1:
        stepwise(request, x, ready, stop=plan.first - 1)


def _holes(request: Request, x: Array, ready: Mask, tick: Tick) -> None:
    """A constant model and series with holes, one after the other."""
    plan = hole_plan(_plan(request), request.missing != "skip")
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
    index = observability_index(request.model) or 1
    limits = Limits(request.horizon, index + 2, request.missing != "skip", request.by_arrival)
    for series in range(request.count):
        one, rows = request.only(slice(series, series + 1)), rows_of(request, series, limits)
        if rows is None:
            stepwise(one, x[series : series + 1], ready[series : series + 1])
        else:
            Scan(rows, limits, request.lag, request.missing == "extend", scanner).fill(
                x[series], ready[series]
            )
            if request.prior is not None and not ready[series].all():
                _warm_up(one, x[series], ready[series])
        tick(request.steps)


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


def _plan(request: Request) -> SeriesPlan:
    return series_plan(request.model, request.horizon, request.lag, unbiased=request.unbiased)


def _covariances(request: Request, kinds: NDArray[np.int8], many: bool) -> Array:
    """P of all series: those of series without holes are the same but for the prior."""
    shape, n = (request.count, request.steps), request.model.dim_x
    regular = kinds == CONSTANT
    if len(kinds) and not regular.any():
        P = stepwise_covariances(request)
        return P if many else P[0]
    common = _common_covariances(request, _plan(request))
    if regular.all() and request.prior is None:
        return np.broadcast_to(common, (*shape, n, n)) if many else common
    P = np.empty((*shape, n, n))
    P[regular] = common
    if not regular.all():
        P[~regular] = stepwise_covariances(request.only(~regular))
    if request.prior is not None:
        stop = _plan(request).first - 1
        head = replace(request.only(regular), z=request.z[regular, :stop])
        P[regular, :stop] = stepwise_covariances(head)
    return P if many else P[0]


def _common_covariances(request: Request, plan: SeriesPlan) -> Array:
    n, begin = request.model.dim_x, min(plan.horizon - 1, request.steps)
    P = np.empty((request.steps, n, n))
    P[begin:] = plan.gain.P
    if begin and plan.head is None:
        P[:begin] = stepwise_covariances(replace(request.only(slice(1)), z=request.z[:1, :begin]))[0]
    elif begin:
        P[:begin] = head_covariances(plan, begin)
    return P
