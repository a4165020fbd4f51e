"""RecursiveEstimator: Kalman and H-infinity filters as I/O systems with states xhat and P."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import control as ct
import numpy as np
from numpy.typing import ArrayLike

from .._arrays import Array, integer
from ..model import Model
from ..recursions.augmented import Lifted, lift, predict_lifted
from .labels import Labels, Names, signal_names
from .plant import Plant, covariance_matrix

__all__ = ["Corrected", "Correction", "Recursion", "RecursiveEstimator", "checked_recursion", "with_age"]


class Corrected(NamedTuple):
    """Estimate after a measurement, and the matrix from which the next prediction starts."""

    x: Array
    P: Array


# (prior, y, H, R, step) -> what follows; y, H and R without rows where nothing was measured.
Correction = Callable[[Lifted, Array, Array, Array, int], Corrected]


@dataclass(frozen=True)
class Recursion:
    """The step of an estimator of [x[k]; x[k-1]; ..; x[k-delay]].

    Attributes
    ----------
    plant : Plant
    model : Model
        With the process noise G QN G'.
    delay : int
        The oldest measurement, in steps.
    stamped : bool
        Whether the age of each measurement is an input.
    correction : callable
        What a measurement does to the estimate.
    P0 : ndarray or None
        Covariance to start from, None for that of the Kalman filter's steady state.
    """

    plant: Plant
    model: Model
    delay: int
    stamped: bool
    correction: Correction
    P0: Array | None

    @property
    def size(self) -> int:
        """Length of the augmented state."""
        return self.plant.dim_x * (self.delay + 1)

    def corrected(self, t: float, state: Array, signals: Array, correct: bool) -> Corrected:
        """The estimate with the measurement of this step in it."""
        prior = self.prior(state)
        y, u, age = self._parted(signals)
        came = ~np.isnan(y) if correct and 0 <= age <= self.delay else np.zeros(len(y), dtype=bool)
        H = np.zeros((int(came.sum()), self.size))
        n = self.plant.dim_x
        if len(H):
            H[:, age * n : (age + 1) * n] = self.plant.C[came]
        z = (y - self.plant.D @ u)[came]
        step = round(t / self.plant.dt)
        return self.correction(prior, z, H, self.model.R[np.ix_(came, came)], step)

    def advanced(self, corrected: Corrected, signals: Array) -> Array:
        """The states of the I/O system one step on."""
        u = self._parted(signals)[1]
        known = self.plant.B @ u
        ahead = predict_lifted(Lifted(*corrected), self.model.F, self.model.Q, known)
        return np.concatenate([ahead.x, ahead.P.reshape(-1)])

    def prior(self, state: Array) -> Lifted:
        """Estimate and covariance in the states of the I/O system."""
        return Lifted(state[: self.size], state[self.size :].reshape(self.size, self.size))

    def _parted(self, signals: Array) -> tuple[Array, Array, int]:
        """y, u and the age of y; a stamp that is no number says that nothing came."""
        m, known = self.plant.dim_z, self.plant.dim_z + self.plant.dim_u
        if not self.stamped:
            return signals[:m], signals[m:], self.delay
        stamp = signals[known]
        return signals[:m], signals[m:known], round(float(stamp)) if np.isfinite(stamp) else -1


class RecursiveEstimator(ct.NonlinearIOSystem):  # type: ignore[misc]
    """A Kalman or H-infinity filter as a ``control.NonlinearIOSystem``.

    Inputs are y then u (then, stamped, the age of y), outputs xhat. The states are xhat and its covariance,
    row by row; with a delay, those of [x[k]; x[k-1]; ..; x[k-delay]]. As in ``create_estimator_iosystem``,
    ``params={"correct": False}`` predicts without measurements. A NaN in y is a missing component.

    Attributes
    ----------
    delay : int
    form : {"predictor", "filter"}

    Examples
    --------
    >>> import control as ct
    >>> from ufirext.control import create_delay_kalman_iosystem
    >>> walk = ct.ss([[1.0]], [[1.0]], [[1.0]], 0, dt=1.0)
    >>> est = create_delay_kalman_iosystem(walk, QN=1.0, RN=2.0, delay=1)
    >>> type(est).__name__, est.delay, est.form
    ('RecursiveEstimator', 1, 'predictor')
    """

    def __init__(
        self,
        recursion: Recursion,
        form: str,
        labels: Labels,
        covariance_labels: Names,
        states: Any = None,
        name: str | None = None,
    ) -> None:
        self._recursion, self.form = recursion, form
        own = _state_names(recursion, labels, covariance_labels)
        super().__init__(
            self._update,
            self._output,
            dt=recursion.plant.dt,
            inputs=labels.inputs,
            outputs=labels.outputs,
            states=own if states is None else states,
            name=name,
        )

    @property
    def delay(self) -> int:
        """Age of the oldest measurement that is taken, in steps."""
        return self._recursion.delay

    def initial_state(self, x0: ArrayLike | None = None, P0: ArrayLike | None = None) -> Array:
        """The states for a plant that starts at x0, known with covariance P0.

        Parameters
        ----------
        x0 : array_like, (dim_x,), optional
            Default 0.
        P0 : array_like, (dim_x, dim_x), optional
            Default: the P0 that the estimator was made with, or the steady state of the Kalman filter.

        Returns
        -------
        ndarray, (nstates,)
            X0 of ``ct.input_output_response(est, T, U, X0)``.

        Raises
        ------
        control.ControlDimension
            For an x0 or P0 that does not fit.
        control.ControlArgument
            Without P0, if there is no steady state.

        Examples
        --------
        >>> import control as ct
        >>> from ufirext.control import create_delay_kalman_iosystem
        >>> plant = ct.ss([[1, 1], [0, 1]], [[0.5], [1]], [[1, 0]], 0, dt=1)
        >>> est = create_delay_kalman_iosystem(plant, [[0.01]], [[4]])
        >>> est.initial_state([3, -1], [[9, 0], [0, 1]])
        array([ 3., -1.,  9.,  0.,  0.,  1.])
        """
        n, model = self._recursion.plant.dim_x, self._recursion.model
        x = np.zeros(n) if x0 is None else np.asarray(x0, dtype=float).reshape(-1)
        if x.size != n:
            raise ct.ControlDimension(f"Incompatible dimensions of x0; expected ({n},) but found ({x.size},)")
        P = self._recursion.P0 if P0 is None else covariance_matrix(P0, n, "P0")
        P = _steady(model) if P is None else P
        start = lift(x, P, self.delay + 1)
        return np.concatenate([start.x, start.P.reshape(-1)])

    def _update(self, t: float, x: Array, u: Array, params: dict[str, Any]) -> Array:
        correct = bool(params.get("correct", True))
        return self._recursion.advanced(self._recursion.corrected(t, x, u, correct), u)

    def _output(self, t: float, x: Array, u: Array, params: dict[str, Any]) -> Array:
        n = self._recursion.plant.dim_x
        if self.form == "predictor":
            return x[:n]
        return self._recursion.corrected(t, x, u, bool(params.get("correct", True))).x[:n]


def checked_recursion(
    plant: Plant,
    QN: ArrayLike,
    RN: ArrayLike,
    P0: ArrayLike | None,
    correction: Correction,
    *,
    delay: int,
    stamped: bool,
) -> Recursion:
    """The step of an estimator, or the error that says what does not fit."""
    delay = integer(delay, "delay", 0)
    if delay and plant.D.any():
        raise NotImplementedError(
            "nonzero 'D' matrix not implemented for delayed measurements: the u that they hold is past; "
            "pass y less D u, of the same age, to the estimator of the plant with D = 0"
        )
    start = None if P0 is None else covariance_matrix(P0, plant.dim_x, "P0")
    return Recursion(plant, plant.model(QN, RN), delay, stamped, correction, start)


def with_age(named: Labels, inputs: Any, delay_label: str, stamped: bool) -> Labels:
    """The labels with the age of the measurement as the last input, unless `inputs` says all."""
    if not stamped or inputs is not None:
        return named
    return replace(named, inputs=[*named.inputs, delay_label])


def _state_names(recursion: Recursion, labels: Labels, covariance: Names) -> list[str]:
    """xhat, the older blocks of the state, and the covariance."""
    older = [f"{name}[k-{age}]" for age in range(1, recursion.delay + 1) for name in labels.estimate]
    size = range(recursion.size)
    default = [f"P[{i},{j}]" for i in size for j in size]
    if isinstance(covariance, str):
        return labels.estimate + older + [covariance.format(i=i, j=j) for i in size for j in size]
    return labels.estimate + older + signal_names(covariance, "covariance", default)


def _steady(model: Model) -> Array:
    """Covariance of the Kalman predictor in its steady state."""
    try:
        P, *_ = ct.dare(model.F.T, model.H.T, model.Q, model.R)
    except (ct.ControlArgument, np.linalg.LinAlgError, ValueError, ArithmeticError) as error:
        # slycot, where it is installed, raises ArithmeticErrors.
        reason = " ".join(str(error).split())
        raise ct.ControlArgument(f"the Kalman filter has no steady state ({reason}); give P0") from error
    return np.asarray(P)
