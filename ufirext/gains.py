"""Unbiased gains, their noise power and exact covariance."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from ._arrays import Array, integer, lag_within, readonly, symmetric
from ._constant import PATH_ROUNDING, constant_covariance, constant_gain
from .errors import HorizonError, UfirextError, UnobservableWindow
from .growing import grown_covariance, grown_gain, noise_paths, root, unwhitened
from .model import Model, require_model
from .window import Window, model_window

__all__ = ["Gain", "exact_covariance", "least_squares", "observability_index", "ufir_gain"]

# Above this condition of the scaled rows the start-referenced solution loses digits: recursion takes over.
DIRECT_LIMIT = 1e4
# As PATH_ROUNDING, where there is no second way.
COARSE_ROUNDING = 1e-6
# Longest window that is searched for observability.
SEARCH_LIMIT = 200


@dataclass(frozen=True, repr=False)
class Gain:
    """An unbiased FIR gain: x^ = K Z, with Z the window's measurements, oldest first.

    Attributes
    ----------
    K : ndarray, (dim_x, horizon * dim_z)
        The gain on the raw measurements; K C = T (unbiased), equation :eq:`unbiased`.
    G : ndarray, (dim_x, dim_x)
        Generalised noise power gain K K', equation :eq:`noise-power-gain`.
    P : ndarray, (dim_x, dim_x)
        Exact error covariance under the model's Q and R, in the units of the states, equation
        :eq:`exact-covariance`.
    horizon, lag : int
        Length of the window; the estimate is of the state `lag` steps before its newest row.

    Examples
    --------
    >>> from ufirext import kinematic, ufir_gain
    >>> ufir_gain(kinematic(0, 1, 1.0), horizon=4).K
    array([[0.25, 0.25, 0.25, 0.25]])
    """

    K: Array
    G: Array
    P: Array
    horizon: int
    lag: int = 0

    def __repr__(self) -> str:
        states, rows = self.K.shape
        window = f"dim_x={states}, rows={rows}, horizon={self.horizon}, lag={self.lag}"
        return f"Gain({window}, trace_P={np.trace(self.P):.6g})"


class _ModelGain(Gain):
    """The gain of a model's full window; its covariance costs more than itself and waits until it is read."""

    def __init__(self, model: Model, K: Array, horizon: int, lag: int) -> None:
        self.__dict__.update(K=K, G=readonly(K @ K.T), horizon=horizon, lag=lag, _model=model)

    @cached_property
    def P(self) -> Array:
        model: Model = self.__dict__["_model"]
        P = constant_covariance(model, self.K, self.lag)
        if P is None:
            P = exact_covariance(model_window(model, self.horizon, self.lag), self.K)
        return readonly(P)


def ufir_gain(model: Model, horizon: int, lag: int = 0) -> Gain:
    """Gain of the unbiased FIR estimator: least squares over the window, K = T C+ with rows weighted by R^-1.

    Equation :eq:`ufir`. Needs neither Q nor an initial state. Equations (27)-(41) of Shmaliy's UFIR filter
    (Shmaliy and Zhao 2013; Shmaliy and Simon 2013), in batch form and with forward powers of F only, so that
    F may be singular.

    Parameters
    ----------
    model : Model
    horizon : int
        Number of measurements, N >= 1, enough to determine the state.
    lag : int, optional
        0 filters; lag > 0 estimates the state `lag` steps before the newest measurement (lag < horizon).

    Returns
    -------
    Gain
        ``.K`` (dim_x, horizon * dim_z), ``.G`` noise power gain, ``.P`` exact covariance.

    Raises
    ------
    HorizonError
        If horizon or lag is not an integer or out of range.
    UnobservableWindow
        If the window does not determine the state; names the shortest horizon that does.

    Examples
    --------
    >>> from ufirext import kinematic, ufir_gain
    >>> gain = ufir_gain(kinematic(1, 1, 1.0), horizon=3)
    >>> gain.K.round(4)
    array([[-0.1667,  0.3333,  0.8333],
           [-0.5   ,  0.    ,  0.5   ]])
    """
    require_model(model)
    horizon = horizon_count(horizon, model)
    lag = lag_within(horizon, lag)
    K = constant_gain(model, horizon, lag)
    if K is None:
        window = model_window(model, horizon, lag)
        require_determined(window, model, horizon)
        K = least_squares(window)
    return _ModelGain(model, readonly(K), horizon, lag)


def horizon_count(horizon: object, model: Model) -> int:
    """`horizon` as an int of at least 1; the error says the shortest one that works for the model."""
    try:
        return integer(horizon, "horizon", 1)
    except HorizonError as error:
        shortest = observability_index(model)
        if shortest is None:
            raise
        raise HorizonError(f"{error}; the shortest horizon that works is {shortest}") from None


def require_determined(window: Window, model: Model, horizon: int) -> None:
    """Raise UnobservableWindow, with the shortest horizon that works, unless the rows determine the state."""
    shortest = observability_index(model)
    if shortest is not None and window.determined():
        return
    if shortest is None:
        advice = "no horizon determines it: measure another state"
    elif horizon < shortest:
        advice = (
            f"the shortest horizon that works is {shortest}: lengthen the horizon or measure another state"
        )
    else:
        advice = "they determine the newest state but not the one aimed at: choose a smaller lag"
    raise UnobservableWindow(
        f"a window of {horizon} step{'s' if horizon != 1 else ''} must determine all {model.dim_x} states, "
        f"its rows have rank {window.rank}; {advice}",
        rank=window.rank,
        shortest=shortest,
    )


@lru_cache(maxsize=256)
def observability_index(model: Model) -> int | None:
    """The shortest horizon whose window determines the state, None where none up to 200 does.

    The index nu is the first N with F^{N-1} null(C_N) = 0; for invertible F that is full column rank.
    """
    certain = model.dim_x + 1
    for horizon in range(1, certain + 1):
        if model_window(model, horizon).determined():
            return horizon
    # By Cayley-Hamilton no longer window sees more: an unseen mode that decays or is outgrown stays unknown.
    # A nearly unobservable one may pass the rank test later.
    if not _full_rank(model, SEARCH_LIMIT):
        return None
    return bisect_left(range(SEARCH_LIMIT), True, lo=certain, key=lambda horizon: _full_rank(model, horizon))


def _full_rank(model: Model, horizon: int) -> bool:
    return model_window(model, horizon).rank == model.dim_x


def least_squares(window: Window) -> Array:
    """K = T C+ on the raw rows: (dim_x, total components), minimum norm where C is rank deficient.

    The window must be determined. Ill-conditioned ones (long, unstable F) are solved by growing a short one.
    """
    if window.condition > DIRECT_LIMIT or window.rank < window.dim_x:
        grown = grown_gain(window)
        if grown is not None:
            return grown
    U, s, Vt = window.spectrum
    r = window.rank
    K = (window.T / window.scale) @ (Vt[:r].T / s[:r]) @ U[:, :r].T
    return unwhitened(window, K)


def exact_covariance(window: Window, K: Array) -> Array:
    """Exact error covariance (dim_x, dim_x) of a window's least-squares estimate K Z, with delays and holes.

    P = sum_j D_j Q_j D_j' + sum_r g_r R_r g_r',  D_j = Phi(aim, j) - sum_{r: o_r >= j} g_r H_r Phi(o_r, j),
    by the backward recursion of `noise_paths`, which ends in D_0 = 0. Where rounding has grown too much on
    the way (unstable F amplify it with every step), by the forward recursion, which is stable. Rows may be
    correlated with the process noise of their origin (`Row.correlation`).

    Raises
    ------
    UfirextError
        If there are such rows and rounding has grown too much.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        rounding, *paths = noise_paths(window, K, [window.aim])
        noise = np.zeros_like(rounding)
        for g, R in zip(np.split(K, window.starts[1:-1], axis=1), window.R, strict=True):
            noise += g @ R @ g.T
        if window.correlations:
            noise -= _through_both(window, K, paths)
        if not paths:
            return symmetric(noise)
        D, Q = np.array(paths), np.array(window.Q[: len(paths)])
        noise += (D @ Q @ D.transpose(0, 2, 1)).sum(axis=0)
        rounding = rounding @ Q.sum(axis=0) @ rounding.T
    allowed = COARSE_ROUNDING if window.correlations else PATH_ROUNDING
    if not (np.diag(rounding) <= allowed**2 * np.diag(noise)).all():
        if window.correlations:
            raise UfirextError(
                f"P of {len(window.H)} rows whose noise is correlated with the process noise has lost its "
                "digits to the growth of F; shorten the horizon"
            )
        grown = grown_covariance(window)
        if grown is not None:
            return grown
    return symmetric(noise)


def _through_both(window: Window, K: Array, paths: Sequence[Array]) -> Array:
    """What process noises that enter rows as well, one or several, take from the covariance of K Z."""
    result = np.zeros((window.dim_x, window.dim_x))
    shares: dict[int, Array] = {}
    gains = np.split(K, window.starts[1:-1], axis=1)
    for g, origin, N in zip(gains, window.origins, window.correlations, strict=True):
        if N is not None:
            share = N @ g.T
            result += share.T @ share
            shares[origin] = shares[origin] + share if origin in shares else share
    for origin, share in shares.items():
        result -= share.T @ share
        if origin:  # what entered at the oldest origin is part of the unknown start
            part = paths[origin - 1] @ root(window.Q[origin - 1]) @ share
            result += part + part.T
    return result
