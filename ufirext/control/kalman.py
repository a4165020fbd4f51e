"""The Kalman filter for late measurements as an I/O system."""

from __future__ import annotations

from typing import Any

import control as ct
from numpy.typing import ArrayLike

from .._arrays import Array
from ..recursions.augmented import Lifted
from ..recursions.kalman import update
from .design import checked_form, require_no_loop
from .labels import Names, labels
from .plant import Indices, read_plant
from .recursive import Corrected, RecursiveEstimator, checked_recursion, with_age

__all__ = ["create_delay_kalman_iosystem"]


def create_delay_kalman_iosystem(
    sys: ct.StateSpace,
    QN: ArrayLike,
    RN: ArrayLike,
    P0: ArrayLike | None = None,
    *,
    delay: int = 0,
    stamped: bool = False,
    form: str = "predictor",
    feedthrough: bool = False,
    G: ArrayLike | None = None,
    C: ArrayLike | None = None,
    control_indices: Indices = None,
    disturbance_indices: Indices = None,
    estimate_labels: Names = "xhat[{i}]",
    covariance_labels: Names = "P[{i},{j}]",
    measurement_labels: Names = None,
    control_labels: Names = None,
    delay_label: str = "delay",
    inputs: Any = None,
    outputs: Any = None,
    states: Any = None,
    name: str | None = None,
) -> RecursiveEstimator:
    """The Kalman filter for measurements that come late, as an I/O system with covariance states.

    What reaches the estimator at step k was measured at k - delay. Without delay it is the discrete-time
    system of ``control.create_estimator_iosystem``, state by state.

    Parameters
    ----------
    sys : control.StateSpace
        Discrete-time; A may be singular or unstable.
    QN, RN : array_like, (dim_w, dim_w) and (dim_z, dim_z)
        Covariances of the disturbances and of the measurement noise.
    P0 : array_like, (dim_x, dim_x), optional
        What `initial_state` starts from. Default: the steady state of the Kalman filter.
    delay : int, optional
        Age of the measurements in steps; stamped, the largest one.
    stamped : bool, optional
        Add an input, the age of the measurement that comes at this step. An age outside 0..delay says that
        nothing came.
    form : {"predictor", "filter"}, optional
        Output the estimate of x[k] before the measurement of this step, as python-control does, or after it.
    feedthrough, G, C, control_indices, disturbance_indices : optional
        As for `create_ufir_iosystem`.
    estimate_labels, measurement_labels, control_labels, inputs, outputs, states, name : optional
        As for `create_ufir_iosystem`.
    covariance_labels : str or list of str, optional
        Names of the covariance states; a string is a format in ``i`` and ``j``.
    delay_label : str, optional
        Name of the input of ages.

    Returns
    -------
    RecursiveEstimator
        Its ``initial_state(x0, P0)`` is the X0 of a simulation.

    Raises
    ------
    control.ControlArgument, control.ControlDimension
        For a system or a matrix that does not fit.
    NotImplementedError
        For D != 0 with a delay, or from the disturbances, or in filter form without feedthrough=True.
    HorizonError
        If `delay` is no count.

    Notes
    -----
    The Kalman filter of [x[k]; x[k-1]; ..; x[k-delay]], the optimum for any delays:
    `ufirext.DelayKalmanFilter` with method="augmented".

    Examples
    --------
    >>> import control as ct
    >>> from ufirext.control import create_delay_kalman_iosystem
    >>> plant = ct.ss([[1, 1], [0, 1]], [[0.5], [1]], [[1, 0]], 0, dt=1)
    >>> est = create_delay_kalman_iosystem(plant, [[0.01]], [[4]], delay=2, stamped=True)
    >>> est.input_labels
    ['y[0]', 'u[0]', 'delay']
    """
    plant = read_plant(
        sys,
        "create_delay_kalman_iosystem",
        G=G,
        C=C,
        control_indices=control_indices,
        disturbance_indices=disturbance_indices,
    )
    shape = checked_form(form)
    require_no_loop(plant, shape, feedthrough)
    named = labels(plant, estimate_labels, measurement_labels, control_labels, inputs, outputs)
    return RecursiveEstimator(
        checked_recursion(plant, QN, RN, P0, _corrected, delay=delay, stamped=stamped),
        shape,
        with_age(named, inputs, delay_label, stamped),
        covariance_labels,
        states,
        name,
    )


def _corrected(prior: Lifted, z: Array, H: Array, R: Array, step: int) -> Corrected:
    """The Kalman update."""
    if not len(z):
        return Corrected(*prior)
    posterior = update(prior.x, prior.P, z, H, R)
    return Corrected(posterior.x, posterior.P)
