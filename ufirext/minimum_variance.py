"""Minimum-variance unbiased FIR gains of a model, for the newest state and a lagged one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ._arrays import Array, integer, lag_within, readonly
from .errors import UnobservableWindow
from .gains import Gain, observability_index, require_determined
from .joint import joint_gain, require_definite
from .model import Model, require_model
from .prefixes import start_length
from .window import model_window

__all__ = ["MinimumVarianceGain", "minimum_variance_gain", "shortest_window"]


@dataclass(frozen=True, repr=False, kw_only=True)
class MinimumVarianceGain(Gain):
    """The best linear unbiased FIR gain, for the state `lag` steps back and for the newest one.

    Attributes
    ----------
    K : ndarray, (dim_x, horizon * dim_z)
        Gain of x_{n-lag|n}, as in `Gain`.
    G, P : ndarray, (dim_x, dim_x)
        Its noise power gain and error covariance, equation :eq:`minimum-variance-covariance`.
    K_now : ndarray, (dim_x, horizon * dim_z)
        Gain of the filtered state x_{n|n} from the same window; K when lag is 0.
    P_now : ndarray, (dim_x, dim_x)
        Its error covariance; P when lag is 0.
    P_cross : ndarray, (dim_x, dim_x)
        E[(error of x_{n|n}) (error of x_{n-lag|n})'].
    L, L_now : ndarray, (dim_x, (horizon - 1) * dim_u)
        Gains on the known inputs that lead from each state of the window to the next, oldest first.

    Examples
    --------
    >>> from ufirext import kinematic, minimum_variance_gain
    >>> gain = minimum_variance_gain(kinematic(0, 1, 1.0), horizon=2, lag=1)
    >>> gain.K.round(4), gain.K_now.round(4)
    (array([[0.6667, 0.3333]]), array([[0.3333, 0.6667]]))
    >>> gain
    MinimumVarianceGain(dim_x=1, rows=2, horizon=2, lag=1): x_now with trace P = 0.666667 and x_lag with
    trace P = 0.666667
    """

    K_now: Array
    P_now: Array
    P_cross: Array
    L: Array
    L_now: Array

    def __repr__(self) -> str:
        states, rows = self.K.shape
        window = f"dim_x={states}, rows={rows}, horizon={self.horizon}, lag={self.lag}"
        lagged = f" and x_lag with trace P = {np.trace(self.P):.6g}" if self.lag else ""
        return f"MinimumVarianceGain({window}): x_now with trace P = {np.trace(self.P_now):.6g}{lagged}"


def minimum_variance_gain(model: Model, horizon: int, lag: int = 0) -> MinimumVarianceGain:
    """Gain of the minimum-variance unbiased FIR filter and fixed-lag smoother (MVU-FIR, OFIR-EU, FMS).

    Minimises every error variance of x_{n-lag|n} = K Z subject to K C = T (Gauss-Markov), equation
    :eq:`minimum-variance`. Equals the Kalman filter and smoother run over the window alone, without prior
    knowledge of its oldest state. In the terms
    of Kim's FMS filter-smoother (`fms_gain`) lag is d - 1 and horizon is M: the newest measurement counts.

    Parameters
    ----------
    model : Model
        R must be positive definite; Q may be singular or zero, F singular or unstable.
    horizon : int
        Number of measurements, enough to determine the state.
    lag : int, optional
        0 filters; 0 < lag < horizon smooths.

    Returns
    -------
    MinimumVarianceGain

    Raises
    ------
    HorizonError
        If horizon or lag is not an integer or out of range.
    CovarianceError
        If R is singular.
    UnobservableWindow
        If the window does not determine the state; names the shortest horizon that does.

    Warns
    -----
    InaccurateGainWarning
        If the model is so nearly unobservable that double precision does not suffice.

    Examples
    --------
    >>> from ufirext import kinematic, minimum_variance_gain
    >>> gain = minimum_variance_gain(kinematic(1, 1, 1.0), horizon=4)
    >>> bool(abs(gain.K.sum(axis=1) - [1, 0]).max() < 1e-14)  # a constant is reproduced
    True
    """
    require_model(model)
    horizon = integer(horizon, "horizon", 1)
    lag = lag_within(horizon, lag)
    require_definite(model.R)
    window = model_window(model, horizon, lag)
    if start_length(window, model.dim_x + 1) is None:
        require_determined(window, model, horizon)
    joint = joint_gain(window, None if model.B is None else [model.B] * (horizon - 1))
    n, K, L, P = model.dim_x, readonly(joint.K), readonly(joint.L), readonly(joint.P)
    return MinimumVarianceGain(
        K=K[n:],
        G=readonly(K[n:] @ K[n:].T),
        P=P[n:, n:],
        horizon=horizon,
        lag=lag,
        K_now=K[:n],
        P_now=P[:n, :n],
        P_cross=P[:n, n:],
        L=L[n:],
        L_now=L[:n],
    )


def shortest_window(model: Model, horizon: int, lag: int) -> int | None:
    """The shortest horizon that determines the newest state, None where none does.

    Raises
    ------
    UnobservableWindow
        If the window given can never determine the newest state or the lagged one, though a longer one could.
    """
    shortest = observability_index(model)
    if shortest is None:
        return None
    if horizon < shortest:
        raise UnobservableWindow(
            f"horizon must be at least {shortest} for this model (the shortest window that determines its "
            f"{model.dim_x} states), got {horizon}; lengthen the horizon or measure another state",
            shortest=shortest,
        )
    if lag and not model_window(model, horizon, lag).determined():
        raise UnobservableWindow(
            f"a window of {horizon} steps must determine the state {lag} steps ago, it cannot; "
            f"shorten the lag, lengthen the horizon or measure another state"
        )
    return shortest
