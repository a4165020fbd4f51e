"""The H-infinity filter as an I/O system."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import control as ct
import numpy as np
from numpy.typing import ArrayLike

from .._arrays import Array
from ..recursions.augmented import Lifted
from ..recursions.hinfinity import Form as Bounded
from ..recursions.hinfinity import ThetaTooLarge, largest_theta, robust_gain, weight_root
from .design import checked_form, require_no_loop
from .labels import Names, labels
from .plant import Indices, covariance_matrix, read_plant
from .recursive import Corrected, RecursiveEstimator, checked_recursion, with_age

__all__ = ["create_hinfinity_iosystem"]


def create_hinfinity_iosystem(
    sys: ct.StateSpace,
    QN: ArrayLike,
    RN: ArrayLike,
    P0: ArrayLike | None = None,
    *,
    theta: float | str = "auto",
    S: ArrayLike | None = None,
    fraction: float = 0.3,
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
    """The H-infinity filter as an I/O system with covariance states.

    It bounds the error of its own output for every disturbance, random or not:
    ``sum theta |x - xhat|^2_S <= |x_0 - xhat_0|^2_{P0^-1} + sum |w|^2_{QN^-1} + sum |v|^2_{RN^-1}``.

    Parameters
    ----------
    sys : control.StateSpace
        Discrete-time; A may be singular or unstable.
    QN, RN : array_like, (dim_w, dim_w) and (dim_z, dim_z)
        Weights of the disturbances and of the measurement noise, in the place of their covariances.
    P0 : array_like, (dim_x, dim_x), optional
        What `initial_state` starts from. Default: the steady state of the Kalman filter.
    theta : "auto" or float, optional
        How much is guaranteed: 0 is the Kalman filter; "auto" keeps `fraction` of the largest possible theta
        at each step that brings a measurement.
    S : array_like, (dim_x, dim_x), optional
        Weight of the errors, positive semidefinite. Default identity.
    fraction : float, optional
        Between 0 and 1, for theta="auto".
    delay, stamped, delay_label, covariance_labels : optional
        As for `create_delay_kalman_iosystem`.
    form : {"predictor", "filter"}, optional
        Output, and bound the error of, the estimate of x[k] before the measurement of this step or after it.
    feedthrough, G, C, control_indices, disturbance_indices : optional
        As for `create_ufir_iosystem`.
    estimate_labels, measurement_labels, control_labels, inputs, outputs, states, name : optional
        As for `create_ufir_iosystem`.

    Returns
    -------
    RecursiveEstimator
        Its ``initial_state(x0, P0)`` is the X0 of a simulation.

    Raises
    ------
    control.ControlArgument, control.ControlDimension
        For a system, a matrix, a theta or a fraction that does not fit.
    NotImplementedError
        For D != 0 with a delay, or from the disturbances, or in filter form without feedthrough=True.
    ThetaTooLarge
        From the simulation, with the step, where theta is beyond its limit.

    Notes
    -----
    `ufirext.DelayHInfinityFilter`, with form="prior" for a predictor and "posterior" for a filter.

    References
    ----------
    Simon, Optimal State Estimation (2006), chapter 11.

    Examples
    --------
    >>> import control as ct
    >>> import numpy as np
    >>> from ufirext.control import create_hinfinity_iosystem
    >>> plant = ct.ss([[1, 1], [0, 1]], [[0.5], [1]], [[1, 0]], 0, dt=1)
    >>> est = create_hinfinity_iosystem(plant, [[0.01]], [[4]], theta=0.02)
    >>> signals = np.array([[5, 5, 5], [0, 0, 0]])
    >>> t, xhat = ct.input_output_response(est, np.arange(3), signals, est.initial_state([5, 0]))
    >>> xhat[0].round(6)
    array([5., 5., 5.])
    """
    plant = read_plant(
        sys,
        "create_hinfinity_iosystem",
        G=G,
        C=C,
        control_indices=control_indices,
        disturbance_indices=disturbance_indices,
    )
    shape = checked_form(form)
    require_no_loop(plant, shape, feedthrough)
    weight = weight_root(np.eye(plant.dim_x) if S is None else covariance_matrix(S, plant.dim_x, "S"))
    bounded: Bounded = "prior" if shape == "predictor" else "posterior"
    tilting = _Tilting(weight, _checked_theta(theta), _checked_fraction(fraction), bounded)
    named = labels(plant, estimate_labels, measurement_labels, control_labels, inputs, outputs)
    return RecursiveEstimator(
        checked_recursion(plant, QN, RN, P0, tilting, delay=delay, stamped=stamped),
        shape,
        with_age(named, inputs, delay_label, stamped),
        covariance_labels,
        states,
        name,
    )


@dataclass(frozen=True)
class _Tilting:
    """The H-infinity update: L with L'L = S, theta (None: a share of its limit), and what is bounded."""

    weight: Array
    theta: float | None
    fraction: float
    bounded: Bounded

    def __call__(self, prior: Lifted, z: Array, H: Array, R: Array, step: int) -> Corrected:
        L = np.zeros((len(self.weight), len(prior.x)))
        L[:, : self.weight.shape[1]] = self.weight
        theta = self.theta
        if theta is None:
            theta = self._largest(prior.P, H, R, L)
        try:
            robust = robust_gain(prior.P, H, R, L, theta, self.bounded)
        except ThetaTooLarge as error:
            raise ThetaTooLarge(error.theta, error.theta_max, step) from None
        return Corrected(prior.x + robust.K @ (z - H @ prior.x), robust.P)

    def _largest(self, P: Array, H: Array, R: Array, L: Array) -> float:
        """The share of the limit that "auto" takes; errors of a step without a measurement weigh nothing."""
        if not len(H):
            return 0.0
        limit = largest_theta(P if self.bounded == "prior" else robust_gain(P, H, R, L, 0.0).P, L)
        return self.fraction * limit if np.isfinite(limit) else 0.0


def _checked_theta(theta: float | str) -> float | None:
    if isinstance(theta, str) and theta == "auto":
        return None
    if not isinstance(theta, str) and 0.0 <= theta < np.inf:
        return float(theta)
    raise ct.ControlArgument(f"theta must be 'auto' or a finite number, not negative, got {theta!r}")


def _checked_fraction(fraction: float) -> float:
    if 0.0 < fraction < 1.0:
        return float(fraction)
    raise ct.ControlArgument(f"fraction must lie between 0 and 1, got {fraction!r}")
