"""filter_series: whole recorded series through the finite-memory filters."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from .._array_api import is_native
from .._arrays import Array, lag_within, one_of
from ..errors import UfirextError
from ..filters._window_state import MISSING, WINDOWS
from ..gains import observability_index
from ..model import Model, require_model
from . import arguments
from .covariances import covariances
from .engines import CONSTANT, ENGINES, kinds_of, plan_of, run
from .estimate import SeriesEstimate
from .plan import chosen_horizon, model_with, series_plan
from .progress import Progress, ticking
from .request import PerStep, Request
from .windows import Mask

__all__ = ["filter_series"]

# A horizon that costs so little that shorter ones need not take its place.
ORDINARY = 1000


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
        holes. "scan": blocks side by side, for UFIR of any kind, and minimum variance without lag and delays.
        "numba": UFIR's scan as a compiled loop (needs numba; the first call compiles). "stepwise": the
        streaming classes, whatever the series holds.
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
    require_model(model)
    one_of(engine, ENGINES, "engine")
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
    late = arguments.as_delays(delays, shape)
    request = Request(
        model=model_with(model, noise),
        z=series,
        horizon=_enough(model, horizon, lag, shape[1] + (0 if late is None else int(late.max()))),
        lag=lag,
        unbiased=noise is None,
        missing=missing,
        by_arrival=window == "arrivals",
        us=arguments.as_inputs(us, model, shape),
        delays=late,
        prior=arguments.as_prior(prior, model, shape[0]),
        per_step=changing,
    )
    _require_possible(request, window)
    read = {"zs": series, **{f"{name}s": getattr(changing, name) for name in given}}
    x = arguments.as_output(out, (*shape, model.dim_x) if many else (shape[1], model.dim_x), read)
    ready: Mask = np.zeros(shape, dtype=np.bool_)
    kinds = kinds_of(request, engine)
    with ticking(progress, shape[0] * shape[1]) as tick:
        run(request, kinds, engine, x if many else x[None], ready, tick)
    kept = request.kept(bool((kinds != CONSTANT).any()))
    spread = partial(covariances, kept, kinds, ready.copy(), many)
    return SeriesEstimate(x, ready if many else ready[0], horizon, lag, spread)


def _window(model: Model, horizon: int | str, lag: int) -> tuple[int, int]:
    """Horizon and lag, checked."""
    chosen = chosen_horizon(model, horizon)
    return chosen, lag_within(chosen, lag)


def _enough(model: Model, horizon: int, lag: int, steps: int) -> int:
    """A horizon that gives the same over so few steps: a window that is never full is not worked out."""
    return min(horizon, max(steps + 1, lag + 1, observability_index(model) or 1, ORDINARY))


def _require_possible(request: Request, window: str) -> None:
    """Refuse combinations that no filter of the library has."""
    one_of(window, WINDOWS, "window")
    one_of(request.missing, MISSING, "missing")
    if request.per_step.F is None and request.per_step.H is None:
        plan_of(request)  # raises where full windows of the constant model do not determine the state
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
            'minimum variance with delays needs window="origins": its window goes by when a state was, not '
            "by when its measurement came"
        )
