"""How long the window should be: from the model, or from data."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ._arrays import Array, integer
from .errors import UnobservableWindow
from .gains import horizon_count, observability_index, ufir_gain
from .growing import GOOD_CONDITION, SEARCH_PER_STATE
from .model import Model, require_model
from .window import model_window, whitener

__all__ = ["best_horizon", "check_horizon", "horizon_criterion", "shortest_horizon"]

# Rows beyond the shortest determining window that every chosen horizon has, so that noise is averaged at all.
SPARE_ROWS = 2
# Criteria closer than this fraction are equal: the shorter horizon wins.
TIE = 1e-9
# Beyond thrice the best length so far, the search ends once the criterion is this multiple of the best.
HOPELESS = 10.0


def shortest_horizon(model: Model) -> int:
    """The observability index: fewest consecutive measurements that determine the state.

    Raises
    ------
    UnobservableWindow
        If no horizon does.

    Examples
    --------
    >>> from ufirext import kinematic
    >>> from ufirext.horizon import shortest_horizon
    >>> shortest_horizon(kinematic(2, 1, 1.0))
    3
    """
    nu = observability_index(model)
    if nu is None:
        raise UnobservableWindow(
            f"no horizon determines all {model.dim_x} states of this model: measure another state",
            shortest=None,
        )
    return nu


def check_horizon(horizon: object, model: Model) -> int:
    """`horizon` as an int that determines the state; the error says the shortest one that does.

    Raises
    ------
    HorizonError
        If it is not an integer or below 1.
    UnobservableWindow
        If it is too short, or if no horizon determines the state.
    """
    nu = shortest_horizon(model)
    number = horizon_count(horizon, model)
    if number < nu:
        raise UnobservableWindow(
            f"horizon must be at least {nu} to determine all {model.dim_x} states, got {number}: "
            "lengthen the horizon or measure another state",
            shortest=nu,
        )
    return number


def best_horizon(model: Model, zs: ArrayLike | None = None, *, longest: int = 200) -> int:
    """The horizon with the least error of the estimated measurement.

    From a model, the N that minimises tr(R^-1 H P_N H'), P_N the exact error covariance of the UFIR filter,
    equation :eq:`best-horizon`: short windows average too little noise, long ones lag behind what Q drives.
    For constant velocity it is close to sqrt(12 sigma_v / (tau sigma_w)), sigma_w the standard deviation of a
    step's velocity increment, equation :eq:`constant-velocity-horizon`.

    From data, the N whose one-step predictions H F x^_{o-1} of the measurements z_o have the least mean
    square, weighted by R^-1 (the leave-newest-out residual of horizon N + 1), equation
    :eq:`prediction-score`; needs no Q.

    Parameters
    ----------
    model : Model
    zs : array_like, (steps,) or (steps, dim_z), optional
        Measurements at consecutive steps; a NaN is a missing component.
    longest : int, optional
        Cap. Without process noise (Q = 0) longer is always better and the cap is the answer.

    Returns
    -------
    int
        At least 2 more than the shortest horizon that determines the state: the literal minimum can be a
        deadbeat window, which follows every outlier.

    Raises
    ------
    UnobservableWindow
        If no horizon determines the state.
    HorizonError, ShapeError, NonFiniteError
        For an unusable `longest`, or for data of wrong shape, with infinities, or too few.

    Examples
    --------
    >>> from ufirext import best_horizon, kinematic
    >>> best_horizon(kinematic(1, 1, 1.0, q=0.01, r=100.0))
    35
    """
    require_model(model)
    first = shortest_horizon(model) + SPARE_ROWS
    last = integer(longest, "longest", first, advice=f"the shortest horizon to choose from is {first}")
    if zs is None:
        return _from_model(model, first, last)
    from .adaptive import from_data

    return from_data(model, zs, first, last)


@lru_cache(maxsize=512)
def _from_model(model: Model, first: int, last: int) -> int:
    criterion = horizon_criterion(model, first, last)
    return first + first_minimum(criterion)


def first_minimum(values: Array) -> int:
    """Index of the first value that no other undercuts by more than rounding."""
    return int(np.argmax(values <= np.nanmin(values) * (1.0 + TIE)))


def horizon_criterion(model: Model, first: int, last: int) -> Array:
    """tr(R^-1 H P_N H') for N = first .. last: the error in units of R; ends early where hopeless."""
    H = whitener(model.R) @ model.H
    result: list[float] = []
    best, at = np.inf, first
    for horizon, P in enumerate(_covariances(model, first, last), first):
        result.append(float(np.vdot(H @ P, H)))
        if result[-1] < best:
            best, at = result[-1], horizon
        elif horizon > 3 * at and result[-1] > HOPELESS * best:
            break
    return np.array(result)


def _covariances(model: Model, first: int, last: int) -> Iterator[Array]:
    """Exact error covariances for horizons first .. last.

    One pass: the window that grows by a step is recursive least squares, whose gain and exact covariance obey
    A = (I - K H) F,  G <- A G A' + K R K',  P <- A P A' + (I - K H) Q (I - K H)' + K R K'.
    """
    start = _good_start(model, last)
    for horizon in range(first, min(start, last + 1)):
        yield ufir_gain(model, horizon).P
    if start > last:
        return
    gain = ufir_gain(model, start)
    W = whitener(model.R)
    H, noise = W @ model.H, np.stack([np.eye(model.dim_z), W @ model.R @ W.T])
    whitened = np.linalg.solve(W.T, gain.K.reshape(-1, model.dim_z).T).T.reshape(model.dim_x, -1)
    pair = np.stack([whitened @ whitened.T, gain.P])
    drive = np.stack([np.zeros_like(model.Q), model.Q])
    F, eye, one = model.F, np.eye(model.dim_x), np.eye(model.dim_z)
    for horizon in range(start, last + 1):
        if horizon >= first:
            yield pair[1]
        pair = F @ pair @ F.T + drive
        seen = H @ pair[0]
        K = np.linalg.solve(seen @ H.T + one, seen).T
        A = eye - K @ H
        pair = A @ pair @ A.T + K @ noise @ K.T


def _good_start(model: Model, last: int) -> int:
    """The shortest horizon of good condition, last + 1 if none has one: variances square conditions."""
    nu = shortest_horizon(model)
    near = range(nu, min(nu + SEARCH_PER_STATE * model.dim_x, last) + 1)
    return next((N for N in near if model_window(model, N).condition < GOOD_CONDITION), last + 1)
