"""Unbiased gains, their noise power and exact covariance."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from ._arrays import Array, integer, readonly, symmetric
from ._constant import constant_covariance, constant_gain
from .errors import UnobservableWindow
from .model import Model
from .window import Window, model_window

__all__ = ["Gain", "exact_covariance", "least_squares", "observability_index", "ufir_gain"]

# Above this condition of the scaled rows the start-referenced solution loses digits: recursion takes over.
DIRECT_LIMIT = 1e5
# Longest window that is searched for observability.
SEARCH_LIMIT = 200


@dataclass(frozen=True, repr=False)
class Gain:
    """An unbiased FIR gain: x^ = K Z, with Z the window's measurements, oldest first.

    Attributes
    ----------
    K : ndarray, (dim_x, horizon * dim_z)
        The gain on the raw measurements; K C = T (unbiased).
    G : ndarray, (dim_x, dim_x)
        Generalised noise power gain K K'.
    P : ndarray, (dim_x, dim_x)
        Exact error covariance under the model's Q and R, in the units of the states.
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

    Needs neither Q nor an initial state. Equations (27)-(41) of Shmaliy's UFIR filter (Shmaliy and Zhao 2013;
    Shmaliy and Simon 2013), in batch form and with forward powers of F only, so that F may be singular.

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
    horizon = integer(horizon, "horizon", 1)
    lag = integer(
        lag, "lag", 0, horizon - 1, "the window ends at the newest measurement and holds horizon states"
    )
    K = constant_gain(model, horizon, lag)
    if K is None:
        window = model_window(model, horizon, lag)
        require_determined(window, model, horizon)
        K = least_squares(window)
    return _ModelGain(model, readonly(K), horizon, lag)


def require_determined(window: Window, model: Model, horizon: int) -> None:
    """Raise UnobservableWindow, with the shortest horizon that works, unless the rows determine the state."""
    if window.determined():
        return
    shortest = observability_index(model)
    advice = (
        f"the shortest horizon that works is {shortest}: lengthen the horizon or measure another state"
        if shortest is not None
        else "no horizon determines it: measure another state"
    )
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
    for horizon in range(1, SEARCH_LIMIT + 1):
        if model_window(model, horizon).determined():
            return horizon
        if horizon > 2 * model.dim_x and horizon % 10:
            continue
    return None


def least_squares(window: Window) -> Array:
    """K = T C+ on the raw rows: (dim_x, total components), minimum norm where C is rank deficient.

    The window must be determined. Ill-conditioned windows (long, unstable F) go through the square-root
    recursion, which is right to 5e-12 where the batch form is not.
    """
    if window.condition > DIRECT_LIMIT or window.rank < window.dim_x:
        K = _recursive(window)
        if K is not None:
            return K
    U, s, Vt = window.spectrum
    r = window.rank
    weights = (window.T / window.scale) @ (Vt[:r].T / s[:r]) @ U[:, :r].T
    return _unwhiten(window, weights)


def _unwhiten(window: Window, weights: Array) -> Array:
    """A gain on whitened rows as a gain on the raw ones."""
    for W, start, stop in zip(window.W, window.starts, window.starts[1:], strict=False):
        weights[:, start:stop] = weights[:, start:stop] @ W
    return weights


def _recursive(window: Window) -> Array | None:
    """The gain by a square-root Kalman recursion without process noise from the shortest determining prefix.

    None where no prefix determines the state at its own end (for singular F only), or for a lagged aim.
    """
    newest = window.origins[-1]
    if window.aim < newest:
        return None
    start = _start(window)
    if start is None:
        return None
    count, head = start
    U, s, Vt = head.spectrum
    reduced = (head.T / head.scale) @ (Vt[: head.rank].T / s[: head.rank])
    S, K = reduced, np.zeros((window.dim_x, window.starts[-1]))
    K[:, : head.starts[-1]] = reduced @ U[:, : head.rank].T
    time = head.aim
    for index in range(count, len(window.H)):
        for F in window.F[time : window.origins[index]]:
            S, K = F @ S, F @ K
        time = window.origins[index]
        W, span = window.W[index], slice(window.starts[index], window.starts[index + 1])
        K, S = _absorb(W @ window.H[index], K, S, span)
    for F in window.F[time : window.aim]:
        K = F @ K
    return _unwhiten(window, K)


def _absorb(H: Array, K: Array, S: Array, span: slice) -> tuple[Array, Array]:
    """One whitened row into the gain and the square-root noise power: LQ of [[I, H S], [0, S]]."""
    m, (n, r) = len(H), S.shape
    array = np.block([[np.eye(m), H @ S], [np.zeros((n, m)), S]])
    lower = np.asarray(np.linalg.qr(array.T, mode="r")).T
    step = np.linalg.solve(lower[:m, :m].T, lower[m:, :m].T).T
    K = K - step @ (H @ K)
    K[:, span] += step
    return K, lower[m:, m : m + r]


def _start(window: Window) -> tuple[int, Window] | None:
    """The shortest prefix of rows that determines the state at its own end well, with that end as its aim."""
    for count in range(1, len(window.H) + 1):
        if count < len(window.H) and window.origins[count] == window.origins[count - 1]:
            continue
        head = window.prefix(count)
        head = Window(head.F, head.Q, head.H, head.R, head.origins, head.origins[-1], head.W)
        if head.starts[-1] >= 1 and head.rank and head.determined():
            return count, head
    return None


def exact_covariance(window: Window, K: Array) -> Array:
    """Exact error covariance of the estimate K Z, for any gain, delays and holes (dim_x, dim_x).

    P = sum_j D_j Q_j D_j' + sum_r g_r R_r g_r',  D_j = Phi(aim, j) - sum_{r: o_r >= j} g_r H_r Phi(o_r, j),
    by backward recursion: no inverse of F.
    """
    n = window.dim_x
    end = max(window.aim, window.origins[-1])
    carried, noise = np.zeros((n, n)), np.zeros((n, n))
    index = len(window.H) - 1
    directions = []
    for time in range(end, 0, -1):
        if time == window.aim:
            carried = carried + np.eye(n)
        while index >= 0 and window.origins[index] == time:
            carried = carried - K[:, window.starts[index] : window.starts[index + 1]] @ window.H[index]
            index -= 1
        directions.append(carried)
        carried = carried @ window.F[time - 1]
    if directions:
        D = np.array(directions[::-1])
        noise = (D @ np.array(window.Q[:end]) @ D.transpose(0, 2, 1)).sum(axis=0)
    for R, start, stop in zip(window.R, window.starts, window.starts[1:], strict=False):
        g = K[:, start:stop]
        noise += g @ R @ g.T
    return symmetric(noise)
