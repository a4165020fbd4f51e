"""FIR estimators of a plant as linear I/O systems."""

from __future__ import annotations

from typing import Any

import control as ct
from numpy.typing import ArrayLike

from .design import checked_form, fms_design, require_no_loop, ufir_design, ufir_horizon
from .estimator import FIREstimator
from .labels import Names, labels
from .plant import Indices, read_plant

__all__ = ["create_fms_iosystem", "create_ufir_iosystem"]


def create_ufir_iosystem(
    sys: ct.StateSpace,
    horizon: int | str,
    RN: ArrayLike | None = None,
    *,
    QN: ArrayLike | None = None,
    form: str = "predictor",
    lag: int = 0,
    feedthrough: bool = False,
    G: ArrayLike | None = None,
    C: ArrayLike | None = None,
    control_indices: Indices = None,
    disturbance_indices: Indices = None,
    estimate_labels: Names = "xhat[{i}]",
    measurement_labels: Names = None,
    control_labels: Names = None,
    inputs: Any = None,
    outputs: Any = None,
    states: Any = None,
    name: str | None = None,
) -> FIREstimator:
    """The unbiased FIR estimator of a discrete-time system as a linear I/O system.

    A shift register of the last measurements and inputs with a constant gain: a ``StateSpace`` whose poles
    all lie at 0, so that plant, state feedback and estimator together stay linear. The counterpart of
    ``control.create_estimator_iosystem``.

    Parameters
    ----------
    sys : control.StateSpace
        Discrete-time. A may be singular (dead time) or unstable.
    horizon : int or "auto"
        Length N of the window; "auto" takes the best one under QN and RN, see `ufirext.best_horizon`.
    RN : array_like, (dim_z, dim_z), optional
        Covariance of the measurement noise, by whose inverse measurements are weighted.
    QN : array_like, (dim_w, dim_w), optional
        For horizon="auto" only.
    form : {"predictor", "filter"}, optional
        "predictor": xhat[k] from y[k-N] .. y[k-1] and u[k-N] .. u[k-1], as python-control's estimators.
        "filter": from y[k-N+1] .. y[k], one sample fresher, with direct feedthrough from y.
    lag : int, optional
        Estimate x[k - lag] instead: a fixed-lag smoother.
    feedthrough : bool, optional
        Accept form="filter" for a plant with D != 0; see Notes.
    G : array_like, (dim_x, dim_w), optional
        How the disturbances enter the state. Default: the columns of B of the disturbances.
    C : array_like, (dim_z, dim_x), optional
        What is measured, where the outputs of `sys` are its full state.
    control_indices, disturbance_indices : int, slice, or list of int or str, optional
        Which inputs of `sys` are known, and which are unknown noise: a count from the start or the end, a
        slice, or indices or names. One of them makes the other the rest; without both, noise is added to the
        known inputs.
    estimate_labels, measurement_labels, control_labels : str or list of str, optional
        Names of xhat, y and u; a string is a format in ``i``. Default xhat[i] and the names in `sys`.
    inputs, outputs, states, name : optional
        As in ``control.StateSpace``; override the labels.

    Returns
    -------
    FIREstimator
        Inputs y then u, outputs xhat.

    Raises
    ------
    control.ControlArgument, control.ControlDimension
        For a system or a matrix that does not fit.
    NotImplementedError
        For form="filter", D != 0 and no feedthrough=True.
    UnobservableWindow, HorizonError
        Subclasses of ValueError, for a window that does not determine the state.

    Notes
    -----
    D != 0 is fine in predictor form, where y less D u is past. In filter form xhat[k] then needs u[k], and
    u[k] = -K xhat[k] needs xhat[k]: an algebraic loop, which python-control does not simulate. Therefore it
    is refused, unless `feedthrough` says that u does not come from xhat.

    Examples
    --------
    >>> import control as ct
    >>> from ufirext.control import create_ufir_iosystem
    >>> plant = ct.ss([[1, 0.1], [0, 1]], [[0], [0.1]], [[1, 0]], 0, dt=0.1)
    >>> K, _, _ = ct.dlqr(plant, [[1, 0], [0, 1]], [[1]])
    >>> est = create_ufir_iosystem(plant, horizon=12)
    >>> ctrl, loop = ct.create_statefbk_iosystem(plant, K, estimator=est)
    >>> isinstance(loop, ct.StateSpace)
    True
    """
    plant = read_plant(
        sys,
        "create_ufir_iosystem",
        G=G,
        C=C,
        control_indices=control_indices,
        disturbance_indices=disturbance_indices,
    )
    shape = checked_form(form)
    require_no_loop(plant, shape, feedthrough)
    design = ufir_design(plant, RN, ufir_horizon(plant, horizon, QN, RN), lag, shape)
    named = labels(plant, estimate_labels, measurement_labels, control_labels, inputs, outputs)
    return FIREstimator(plant, design, named, states, name)


def create_fms_iosystem(
    sys: ct.StateSpace,
    QN: ArrayLike,
    RN: ArrayLike,
    horizon: int,
    lag: int = 0,
    *,
    form: str = "predictor",
    feedthrough: bool = False,
    G: ArrayLike | None = None,
    C: ArrayLike | None = None,
    control_indices: Indices = None,
    disturbance_indices: Indices = None,
    estimate_labels: Names = "xhat[{i}]",
    measurement_labels: Names = None,
    control_labels: Names = None,
    inputs: Any = None,
    outputs: Any = None,
    states: Any = None,
    name: str | None = None,
) -> FIREstimator:
    """The minimum-variance FIR estimator or fixed-lag smoother of a system as a linear I/O system.

    Like `create_ufir_iosystem`, with the gain that is best under QN and RN.

    Parameters
    ----------
    sys : control.StateSpace
        Discrete-time. A may be singular (dead time) or unstable.
    QN, RN : array_like, (dim_w, dim_w) and (dim_z, dim_z)
        Covariances of the disturbances and of the measurement noise; RN positive definite.
    horizon : int
        Length N of the window.
    lag : int, optional
        Estimate x[k - lag] instead: a fixed-lag smoother.
    form, feedthrough, G, C, control_indices, disturbance_indices : optional
        As for `create_ufir_iosystem`.
    estimate_labels, measurement_labels, control_labels, inputs, outputs, states, name : optional
        As for `create_ufir_iosystem`.

    Returns
    -------
    FIREstimator
        Inputs y then u, outputs xhat.

    Raises
    ------
    control.ControlArgument, control.ControlDimension
        For a system or a matrix that does not fit.
    NotImplementedError
        For form="filter", D != 0 and no feedthrough=True; for D != 0 from the disturbances.
    UnobservableWindow, HorizonError, CovarianceError
        Subclasses of ValueError.

    References
    ----------
    Kim (2019), A Unified Finite Memory Structure Filter and Smoother: its M is `horizon`, its d is `lag`.

    Examples
    --------
    >>> import control as ct
    >>> from ufirext.control import create_fms_iosystem
    >>> plant = ct.ss([[1, 0.1], [0, 1]], [[0], [0.1]], [[1, 0]], 0, dt=0.1)
    >>> create_fms_iosystem(plant, [[1]], [[0.01]], horizon=12, lag=3).nstates
    24
    """
    plant = read_plant(
        sys,
        "create_fms_iosystem",
        G=G,
        C=C,
        control_indices=control_indices,
        disturbance_indices=disturbance_indices,
    )
    shape = checked_form(form)
    require_no_loop(plant, shape, feedthrough)
    design = fms_design(plant, QN, RN, horizon, lag, shape)
    named = labels(plant, estimate_labels, measurement_labels, control_labels, inputs, outputs)
    return FIREstimator(plant, design, named, states, name)
