"""Optimal FIR gains: a window with a prior on its oldest state, from the Kalman filter to unbiasedness."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ._arrays import Array, column, covariance, finite, integer, lag_within, matrix, number, readonly
from .errors import UfirextError
from .joint import joint_gain, require_definite
from .minimum_variance import minimum_variance_gain
from .model import Model, require_model
from .window import model_window

__all__ = ["OFIRGain", "ofir"]


@dataclass(frozen=True, repr=False)
class OFIRGain:
    """x^_{n-lag|n} = K Z + L U + prior x_old, with x_old the prior mean of the window's oldest state.

    Attributes
    ----------
    K : ndarray, (dim_x, horizon * dim_z)
        On the measurements, oldest first.
    L : ndarray, (dim_x, (horizon - 1) * dim_u)
        On the known inputs within the window, oldest first.
    prior : ndarray, (dim_x, dim_x)
        On the prior mean; K C + prior = T, so that the estimate is unbiased if the mean is.
    P : ndarray, (dim_x, dim_x)
        Error covariance, if the prior's is rho P.
    horizon, lag : int
    rho : float

    Examples
    --------
    >>> from ufirext import kinematic, ofir
    >>> ofir(kinematic(0, 1, 1.0, q=0.0), horizon=3, P=1.0)
    OFIRGain(dim_x=1, rows=3, horizon=3, lag=0, rho=1, trace_P=0.25)
    """

    K: Array
    L: Array
    prior: Array
    P: Array
    horizon: int
    lag: int
    rho: float

    def estimate(self, zs: ArrayLike, x: ArrayLike, us: ArrayLike | None = None) -> Array:
        """The estimate, (dim_x,).

        Parameters
        ----------
        zs : array_like, (horizon, dim_z)
        x : array_like, (dim_x,)
            Prior mean of the oldest state of the window.
        us : array_like, (horizon - 1, dim_u), optional
            Inputs that lead from each state of the window to the next; default none.

        Examples
        --------
        >>> from ufirext import kinematic, ofir
        >>> ofir(kinematic(0, 1, 1.0, q=0.0), horizon=3, P=1.0).estimate([[4], [4], [4]], x=0.0)
        array([3.])
        """
        n, measured = self.K.shape
        rows = matrix(zs, (self.horizon, measured // self.horizon), "zs", "(horizon, dim_z)")
        result = self.K @ rows.ravel() + self.prior @ finite(column(x, n, "x"), "x")
        if us is None:
            return np.asarray(result)
        width = self.L.shape[1] // max(self.horizon - 1, 1)
        inputs = matrix(us, (self.horizon - 1, width), "us", "(horizon - 1, dim_u)")
        return np.asarray(result + self.L @ inputs.ravel())

    def __repr__(self) -> str:
        n, rows = self.K.shape
        return (
            f"OFIRGain(dim_x={n}, rows={rows}, horizon={self.horizon}, lag={self.lag}, rho={self.rho:g}, "
            f"trace_P={np.trace(self.P):.6g})"
        )


def ofir(model: Model, horizon: int, P: ArrayLike, *, rho: float = 1.0, lag: int = 0) -> OFIRGain:
    """Optimal FIR gain with the prior covariance rho P on the oldest state of the window.

    Equation :eq:`ofir`. With the Kalman filter's x_prior and P_prior at the window's oldest step, rho = 1 is
    the Kalman filter (its fixed-lag smoother for lag > 0); rho = inf forgets them and is the minimum-variance
    unbiased gain. Between the two, rho says how little the past before the window is trusted.

    Parameters
    ----------
    model : Model
        R must be positive definite.
    horizon : int
        Number of measurements.
    P : array_like, (dim_x, dim_x), or scalar
        Prior covariance of the oldest state before its own measurement, positive semidefinite.
    rho : float, optional
        Factor on P, not negative; `math.inf` for no prior.
    lag : int, optional
        0 filters; 0 < lag < horizon smooths.

    Returns
    -------
    OFIRGain

    Raises
    ------
    HorizonError
        If horizon or lag is not an integer or out of range.
    CovarianceError
        If R is singular or P is not a covariance.
    UnobservableWindow
        For rho = inf, if the window does not determine the state.
    UfirextError
        If rho is negative or NaN.

    References
    ----------
    Zhao, Shmaliy, Huang and Liu (2015), Minimum variance unbiased FIR filter for discrete time-variant
    systems, Automatica 53.

    Examples
    --------
    >>> import math
    >>> from ufirext import kinematic, ofir
    >>> ofir(kinematic(0, 1, 1.0, q=0.0), horizon=4, P=1.0, rho=math.inf).K
    array([[0.25, 0.25, 0.25, 0.25]])
    """
    require_model(model)
    horizon = integer(horizon, "horizon", 1)
    lag = lag_within(horizon, lag)
    trust = covariance(P, model.dim_x, "P", "(dim_x, dim_x)")
    if not number(rho, "rho") >= 0.0:
        raise UfirextError(f"rho must be a factor on P, 0 or more (math.inf: no prior), got {rho!r}")
    if math.isinf(rho):
        gain = minimum_variance_gain(model, horizon, lag)
        nothing = readonly(np.zeros((model.dim_x, model.dim_x)))
        return OFIRGain(gain.K, gain.L, nothing, gain.P, horizon, lag, rho)
    require_definite(model.R)
    inputs = None if model.B is None else [model.B] * (horizon - 1)
    joint = joint_gain(model_window(model, horizon, lag), inputs, prior=rho * trust)
    n = model.dim_x
    return OFIRGain(
        K=readonly(joint.K[n:]),
        L=readonly(joint.L[n:]),
        prior=readonly(joint.prior[n:]),
        P=readonly(joint.P[n:, n:]),
        horizon=horizon,
        lag=lag,
        rho=float(rho),
    )
