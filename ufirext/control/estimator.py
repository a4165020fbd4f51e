"""FIREstimator: an FIR estimator as a linear system, a shift register with a constant gain."""

from __future__ import annotations

from typing import Any

import control as ct
import numpy as np
from numpy.typing import ArrayLike

from .._arrays import Array, column, finite
from ..errors import UfirextError
from ..joint import square_root
from .design import Design
from .labels import Labels, signal_names
from .plant import Plant

__all__ = ["FIREstimator"]

# A register that represents x0 gives it back this well, relative to the size of x0.
REPRODUCED = 1e-7


class FIREstimator(ct.StateSpace):  # type: ignore[misc]
    """An FIR estimator as a discrete-time ``control.StateSpace``, as `create_ufir_iosystem` returns it.

    Inputs are y then u, outputs xhat. The states are the last measurements and inputs, oldest first; all
    poles lie at 0. Everything python-control does with linear systems works.

    Attributes
    ----------
    K : ndarray, (dim_x, horizon * dim_z)
        Gain on the measurements of the window, oldest first.
    noise_power_gain : ndarray, (dim_x, dim_x)
        K K'.
    horizon, lag : int
    form : {"predictor", "filter"}

    Examples
    --------
    >>> import control as ct
    >>> from ufirext.control import create_ufir_iosystem
    >>> plant = ct.ss([[1, 1], [0, 1]], [[0.5], [1]], [[1, 0]], 0, dt=1)
    >>> est = create_ufir_iosystem(plant, horizon=4)
    >>> est.nstates, est.input_labels, est.output_labels
    (8, ['y[0]', 'u[0]'], ['xhat[0]', 'xhat[1]'])
    """

    def __init__(
        self, plant: Plant, design: Design, labels: Labels, states: Any = None, name: str | None = None
    ) -> None:
        self._plant, self._design = plant, design
        cells = _cells(design)
        own = _past(labels.measurement, cells) + _past(labels.control, cells)
        super().__init__(
            *_realised(design.K, _on_inputs(plant, design), cells),
            plant.dt,
            inputs=labels.inputs,
            outputs=labels.outputs,
            states=own if states is None else states,
            name=name,
            remove_useless_states=False,
        )

    @property
    def K(self) -> Array:
        """Gain on the measurements of the window, oldest first, (dim_x, horizon * dim_z)."""
        return self._design.gain

    @property
    def noise_power_gain(self) -> Array:
        """K K', (dim_x, dim_x): the error covariance under unit white measurement noise alone."""
        return self.K @ self.K.T

    @property
    def horizon(self) -> int:
        """Number of measurements in the window."""
        return self._design.horizon

    @property
    def lag(self) -> int:
        """How many steps before the present one the estimated state lies."""
        return self._design.lag

    @property
    def form(self) -> str:
        """'predictor': xhat[k] from y up to k - 1; 'filter': up to k."""
        return self._design.form

    def covariance(self, QN: ArrayLike, RN: ArrayLike) -> Array:
        """Exact covariance of x[k - lag] - xhat[k] under white noises w, v of covariance QN, RN.

        Parameters
        ----------
        QN : array_like, (dim_w, dim_w)
            Of the disturbances that `disturbance_indices` or `G` told of.
        RN : array_like, (dim_z, dim_z)

        Returns
        -------
        ndarray, (dim_x, dim_x)
        """
        model = self._plant.model(QN, RN)
        return self._design.covariance(model.Q, model.R)

    def error_system(
        self,
        QN: ArrayLike | None = None,
        RN: ArrayLike | None = None,
        *,
        error_labels: str | list[str] = "e[{i}]",
        name: str | None = None,
    ) -> ct.StateSpace:
        """The channel from the noises to the error x[k - lag] - xhat[k], in FIR form.

        The known inputs and the state itself cancel, so that it is stable for every plant. With QN and RN its
        inputs are scaled to unit white noise: ``ct.norm(est.error_system(QN, RN))**2`` is the trace of
        ``est.covariance(QN, RN)``.

        Parameters
        ----------
        QN, RN : array_like, optional
            Without them the inputs are w and v themselves.
        error_labels : str or list of str, optional
        name : str, optional

        Returns
        -------
        control.StateSpace
            Inputs w[i] then v[i], outputs e[i].

        Examples
        --------
        >>> import control as ct
        >>> from ufirext.control import create_ufir_iosystem
        >>> plant = ct.ss([[1, 1], [0, 1]], [[0.5], [1]], [[1, 0]], 0, dt=1)
        >>> est = create_ufir_iosystem(plant, horizon=8)
        >>> error = est.error_system(QN=[[0.01]], RN=[[4]])
        >>> round(float(ct.norm(error) ** 2), 6) == round(float(est.covariance([[0.01]], [[4]]).trace()), 6)
        True
        """
        plant, design = self._plant, self._design
        w = np.eye(plant.G.shape[1]) if QN is None else square_root(plant.process_noise(QN))
        v = np.eye(plant.dim_z) if RN is None else square_root(plant.measurement_noise(RN))
        through = _with_newest(design.E @ (plant.G @ w), design)
        names = [f"w[{i}]" for i in range(w.shape[1])], [f"v[{i}]" for i in range(v.shape[1])]
        cells = _cells(design)
        return ct.StateSpace(
            *_realised(through, -(design.K @ v), cells),
            plant.dt,
            inputs=names[0] + names[1],
            outputs=signal_names(error_labels, "error", [f"e[{i}]" for i in range(plant.dim_x)]),
            states=_past(names[0], cells) + _past(names[1], cells),
            name=name,
            remove_useless_states=False,
        )

    def initial_state(self, x0: ArrayLike) -> Array:
        """The register's state for a plant known to start at x0, so that its first outputs are right.

        The register is filled with the smallest past that leads to x0. Without it the estimator has to fill
        its window first, `horizon` steps.

        Parameters
        ----------
        x0 : array_like, (dim_x,)
            State of the plant at k = 0.

        Returns
        -------
        ndarray, (nstates,)
            X0 of ``ct.input_output_response(est, T, U, X0)``.

        Raises
        ------
        control.ControlDimension
            If x0 has the wrong length.
        ValueError
            If no past as long as the window ends in x0 (a singular A), or it is beyond double precision.

        Examples
        --------
        >>> import control as ct
        >>> from ufirext.control import create_ufir_iosystem
        >>> plant = ct.ss([[1, 1], [0, 1]], [[0.5], [1]], [[1, 0]], 0, dt=1)
        >>> est = create_ufir_iosystem(plant, horizon=4)
        >>> (est.C @ est.initial_state([3, -1])).round(9)
        array([ 3., -1.])
        """
        plant, design, cells = self._plant, self._design, _cells(self._design)
        wanted = np.asarray(x0, dtype=float)
        if wanted.size != plant.dim_x:
            raise ct.ControlDimension(
                f"Incompatible dimensions of x0; expected ({plant.dim_x},) but found {wanted.shape}"
            )
        wanted = finite(column(wanted, plant.dim_x, "x0"), "x0")
        x, u = _shortest_past(plant, wanted, cells)
        path = [x]
        for step in range(cells):
            path.append(plant.A @ path[-1] + plant.B @ u[step])
        y = np.array([plant.C @ path[k] + plant.D @ u[k] for k in range(cells)])
        state = np.concatenate([y.reshape(-1), u.reshape(-1)])
        now = np.concatenate([plant.C @ wanted, np.zeros(plant.dim_u)])
        misses = (
            np.abs(path[-1] - wanted).max(),
            np.abs(self.C @ state + self.D @ now - path[-1 - design.lag]),
        )
        # The first finds an x0 out of reach, the second a past so large that rounding drowns the estimate.
        if not max(misses[0], misses[1].max()) <= REPRODUCED * np.abs(wanted).max(initial=1e-300):
            raise UfirextError(
                f"x0 must be the end of some trajectory of {cells} steps, so that the register can hold one, "
                f"got {wanted}; fill the delay line of a plant with dead time, or start from zeros and wait"
            )
        return state


def _cells(design: Design) -> int:
    """How many past instants the register holds."""
    return design.horizon if design.form == "predictor" else design.horizon - 1


def _past(names: list[str], cells: int) -> list[str]:
    """Names of the register's states, oldest instant first."""
    return [f"{name}[k-{age}]" for age in range(cells, 0, -1) for name in names]


def _on_inputs(plant: Plant, design: Design) -> Array:
    """Gain on u: as the state is driven, less what D u adds to every measurement."""
    return _with_newest(design.L, design) - design.K @ plant.D


def _with_newest(response: Array, design: Design) -> Array:
    """A response on transitions as one on instants: what drives x[k+1] reaches no filter's window."""
    missing = design.horizon - response.shape[1]
    return np.pad(response, ((0, 0), (0, missing), (0, 0)))


def _realised(first: Array, second: Array, cells: int) -> tuple[Array, Array, Array, Array]:
    """A, B, C, D of xhat[k] = sum_j first[:, j] a[..] + second[:, j] b[..]: two registers of `cells`.

    first : (n, horizon, p), second : (n, horizon, m), oldest instant first; a filter's newest instant passes
    straight through.
    """
    n, p, m = len(first), first.shape[2], second.shape[2]
    A, B = np.zeros((cells * (p + m),) * 2), np.zeros((cells * (p + m), p + m))
    for start, width, signal in ((0, p, slice(0, p)), (cells * p, m, slice(p, p + m))):
        stop = start + cells * width
        A[start : stop - width, start + width : stop] = np.eye((cells - 1) * width) if cells > 1 else 0.0
        B[max(stop - width, start) : stop, signal] = np.eye(width) if cells else 0.0
    C = np.hstack([first[:, :cells].reshape(n, -1), second[:, :cells].reshape(n, -1)])
    D = np.hstack([first[:, cells:].sum(axis=1), second[:, cells:].sum(axis=1)])
    return A, B, C, D


def _shortest_past(plant: Plant, x0: Array, steps: int) -> tuple[Array, Array]:
    """The smallest state `steps` ago and inputs since that lead to x0: (dim_x,), (steps, dim_u)."""
    moved, reach = np.eye(plant.dim_x), []
    for _ in range(steps):
        reach.append(moved @ plant.B)
        moved = plant.A @ moved
    into = np.hstack([moved, *reach[::-1]])
    found = np.asarray(np.linalg.lstsq(into, x0)[0], dtype=float)
    return found[: plant.dim_x], found[plant.dim_x :].reshape(steps, plant.dim_u)
