"""Gains of the FIR estimators of a plant, in the manner of ``control.dlqe``."""

from __future__ import annotations

import control as ct
from numpy.typing import ArrayLike

from .._arrays import Array
from .design import checked_form, fms_design, ufir_design, ufir_horizon
from .plant import Indices, read_plant

__all__ = ["fms", "ufir"]


def ufir(
    sys: ct.StateSpace,
    horizon: int | str,
    RN: ArrayLike | None = None,
    *,
    QN: ArrayLike | None = None,
    form: str = "predictor",
    lag: int = 0,
    G: ArrayLike | None = None,
    C: ArrayLike | None = None,
    control_indices: Indices = None,
    disturbance_indices: Indices = None,
) -> tuple[Array, Array]:
    """Gain of the unbiased FIR estimator of a discrete-time system, in the manner of ``control.dlqe``.

    x[k+1] = A x[k] + B u[k] + G w[k],  y[k] = C x[k] + D u[k] + v[k];  without known inputs
    xhat[k] = K [y[k-N]; ..; y[k-1]]. Neither noise covariances nor an initial state are needed.

    Parameters
    ----------
    sys : control.StateSpace
        Discrete-time. A may be singular or unstable.
    horizon : int or "auto"
        Length N of the window; "auto" takes the best one under QN and RN, see `ufirext.best_horizon`.
    RN : array_like, (dim_z, dim_z), optional
        Covariance of the measurement noise, by whose inverse measurements are weighted.
    QN : array_like, (dim_w, dim_w), optional
        For horizon="auto" only.
    form : {"predictor", "filter"}, optional
        xhat[k] from y[k-N] .. y[k-1], as the estimators of python-control, or from y[k-N+1] .. y[k].
    lag : int, optional
        Estimate x[k - lag] instead: a fixed-lag smoother.
    G, C, control_indices, disturbance_indices : optional
        As for `create_ufir_iosystem`.

    Returns
    -------
    K : ndarray, (dim_x, horizon * dim_z)
        Oldest measurement first.
    npg : ndarray, (dim_x, dim_x)
        Noise power gain K K': the error covariance under unit white measurement noise alone.

    Raises
    ------
    control.ControlArgument, control.ControlDimension
        For a system or a matrix that does not fit.
    UnobservableWindow, HorizonError
        Subclasses of ValueError, for a window that does not determine the state.

    Examples
    --------
    >>> import control as ct
    >>> from ufirext.control import ufir
    >>> K, npg = ufir(ct.ss(1, 1, 1, 0, dt=True), horizon=4)
    >>> K, npg
    (array([[0.25, 0.25, 0.25, 0.25]]), array([[0.25]]))
    """
    plant = read_plant(
        sys, "ufir", G=G, C=C, control_indices=control_indices, disturbance_indices=disturbance_indices
    )
    length = ufir_horizon(plant, horizon, QN, RN)
    K = ufir_design(plant, RN, length, lag, checked_form(form)).gain
    return K, K @ K.T


def fms(
    sys: ct.StateSpace,
    QN: ArrayLike,
    RN: ArrayLike,
    horizon: int,
    lag: int = 0,
    *,
    form: str = "predictor",
    G: ArrayLike | None = None,
    C: ArrayLike | None = None,
    control_indices: Indices = None,
    disturbance_indices: Indices = None,
) -> tuple[Array, Array]:
    """Gain of the minimum-variance FIR estimator of a system, in the manner of ``control.dlqe``.

    As the horizon grows, P goes to that of ``dlqe``: the covariance of the error of xhat[k], predicted.

    Parameters
    ----------
    sys : control.StateSpace
        Discrete-time. A may be singular or unstable.
    QN, RN : array_like, (dim_w, dim_w) and (dim_z, dim_z)
        Covariances of the disturbances and of the measurement noise; RN positive definite.
    horizon : int
        Length N of the window.
    lag : int, optional
        Estimate x[k - lag] instead: a fixed-lag smoother.
    form : {"predictor", "filter"}, optional
        xhat[k] from y[k-N] .. y[k-1], as the estimators of python-control, or from y[k-N+1] .. y[k].
    G, C, control_indices, disturbance_indices : optional
        As for `create_fms_iosystem`.

    Returns
    -------
    K : ndarray, (dim_x, horizon * dim_z)
        Oldest measurement first.
    P : ndarray, (dim_x, dim_x)
        Error covariance.

    Raises
    ------
    control.ControlArgument, control.ControlDimension
        For a system or a matrix that does not fit.
    UnobservableWindow, HorizonError, CovarianceError
        Subclasses of ValueError.

    References
    ----------
    Kim (2019), A Unified Finite Memory Structure Filter and Smoother: its M is `horizon`, its d is `lag`.

    Examples
    --------
    >>> import control as ct
    >>> from ufirext.control import fms
    >>> plant = ct.ss(1, 1, 1, 0, dt=True)
    >>> K, P = fms(plant, [[1]], [[1]], horizon=20)
    >>> L, P_kalman, _ = ct.dlqe(plant, [[1]], [[1]])
    >>> bool(abs(P - P_kalman).max() < 1e-6)
    True
    """
    plant = read_plant(
        sys, "fms", G=G, C=C, control_indices=control_indices, disturbance_indices=disturbance_indices
    )
    design = fms_design(plant, QN, RN, horizon, lag, checked_form(form))
    model = plant.model(QN, RN)
    return design.gain, design.covariance(model.Q, model.R)
