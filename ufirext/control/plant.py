"""A control.StateSpace read as a plant: matrices, noise inputs and names, or an error with advice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import control as ct
import numpy as np
from numpy.typing import ArrayLike

from .._arrays import Array, check_covariance, finite, real
from ..errors import CovarianceError
from ..model import Model

__all__ = ["Indices", "Plant", "covariance_matrix", "linear_system", "read_plant", "told_apart"]

Indices = int | slice | list[int] | list[str] | None


@dataclass(frozen=True)
class Plant:
    """x[k+1] = A x[k] + B u[k] + G w[k],  y[k] = C x[k] + D u[k] + v[k].

    Attributes
    ----------
    A, B, G, C, D : ndarray
        B and D for the known inputs only.
    dt : float or True
    measured, known : list of str
        Names of y and u.
    noisy_outputs : bool
        Whether the disturbances w also enter y.
    """

    A: Array
    B: Array
    G: Array
    C: Array
    D: Array
    dt: float | bool
    measured: list[str]
    known: list[str]
    noisy_outputs: bool

    @property
    def dim_x(self) -> int:
        """Number of states."""
        return len(self.A)

    @property
    def dim_z(self) -> int:
        """Number of measurements."""
        return len(self.C)

    @property
    def dim_u(self) -> int:
        """Number of known inputs."""
        return int(self.B.shape[1])

    def model(self, QN: ArrayLike | None = None, RN: ArrayLike | None = None) -> Model:
        """The model F = A, H = C, Q = G QN G', R = RN; without QN no process noise, without RN identity."""
        Q = None if QN is None else self.G @ self.process_noise(QN) @ self.G.T
        R = None if RN is None else self.measurement_noise(RN)
        return Model(self.A, self.C, Q, R, self.B if self.dim_u else None)

    def process_noise(self, QN: ArrayLike) -> Array:
        """QN as a covariance that fits G."""
        if self.noisy_outputs:
            raise NotImplementedError(
                "nonzero 'D' matrix for the disturbances not implemented: they would enter y and x at once, "
                "and so correlate the noises; leave them out of disturbance_indices (give control_indices "
                "too) and count what they do to y in RN"
            )
        return covariance_matrix(QN, self.G.shape[1], "QN")

    def measurement_noise(self, RN: ArrayLike) -> Array:
        """RN as a covariance that fits C."""
        return covariance_matrix(RN, self.dim_z, "RN")


def read_plant(
    sys: Any,
    caller: str,
    *,
    G: ArrayLike | None = None,
    C: ArrayLike | None = None,
    control_indices: Indices = None,
    disturbance_indices: Indices = None,
) -> Plant:
    """The plant that a discrete-time StateSpace stands for, its inputs told apart as python-control does.

    Raises
    ------
    control.ControlArgument
        For anything but a discrete-time StateSpace with at least one state.
    control.ControlDimension
        For a G or C that does not fit.
    """
    linear_system(sys, caller)
    _require_discrete(sys, caller)
    known, noise = told_apart(sys, control_indices, disturbance_indices)
    n, B, D = sys.nstates, real(sys.B, "B"), real(sys.D, "D")
    # As in python-control: without disturbances of their own, noise is added to the inputs.
    own = bool(noise) and noise != known
    entry = B[:, noise] if noise else B
    if G is not None:
        entry, own = np.atleast_2d(real(G, "G")), False
        if len(entry) != n:
            raise ct.ControlDimension(
                f"Incompatible dimensions of G matrix; expected ({n}, any) but found {entry.shape}"
            )
    output, names = _measured(sys, C)
    through = D if C is None else output @ D
    return Plant(
        A=finite(real(sys.A, "A"), "A"),
        B=finite(B[:, known], "B"),
        G=finite(entry, "G"),
        C=finite(output, "C"),
        D=finite(through[:, known], "D"),
        dt=sys.dt,
        measured=names,
        known=[sys.input_labels[i] for i in known],
        noisy_outputs=own and bool(through[:, noise].any()),
    )


def linear_system(sys: Any, caller: str) -> None:
    """Raise ControlArgument unless `sys` is a StateSpace with states and outputs."""
    if not isinstance(sys, ct.StateSpace):
        kind = type(sys).__name__
        if isinstance(sys, ct.lti.LTI):
            raise ct.ControlArgument(
                f"LTI system must be in state space form, got {kind}; convert it first: ct.ss(sys)"
            )
        advice = (
            "; linearize it first: sys.linearize(x0, u0)" if isinstance(sys, ct.InputOutputSystem) else ""
        )
        raise ct.ControlArgument(f"Input system must be a linear I/O system, got {kind}{advice}")
    if sys.nstates == 0:
        raise ct.ControlArgument(
            f"{caller}() called with a static gain: a system without states has nothing to estimate"
        )
    if sys.noutputs == 0:
        raise ct.ControlDimension(f"{caller}() called with a system without outputs: nothing is measured")


def _require_discrete(sys: Any, caller: str) -> None:
    if sys.dt is None:
        raise ct.ControlArgument(
            f"{caller}() called with a system of unspecified timebase; say that it is discrete: "
            "ct.ss(sys, dt=True), or dt=the step in seconds"
        )
    if ct.isctime(sys, strict=True):
        raise ct.ControlArgument(
            f"{caller}() called with a continuous-time system; discretise it first: "
            "ct.c2d(sys, dt), and its process noise: ufirext.discretise(sys.A, G, QN, dt)"
        )


def _measured(sys: Any, C: ArrayLike | None) -> tuple[Array, list[str]]:
    """The output matrix and the names of what is measured."""
    if C is None:
        return real(sys.C, "C"), list(sys.output_labels)
    n, output = sys.nstates, np.atleast_2d(real(C, "C"))
    if sys.C.shape != (n, n) or not np.allclose(sys.C, np.eye(n)):
        raise ct.ControlDimension("System output must be full state where C is given")
    if output.shape[1] != n:
        raise ct.ControlDimension(
            f"Incompatible dimensions of C matrix; expected (any, {n}) but found {output.shape}"
        )
    return output, [f"y[{i}]" for i in range(len(output))]


def told_apart(sys: Any, control: Indices, disturbance: Indices) -> tuple[list[int], list[int]]:
    """Known inputs and disturbances; where one is given the other is the rest, where none is both are all."""
    everything = list(range(sys.ninputs))
    known = None if control is None else _chosen(control, "control", sys.input_labels, first=True)
    noise = (
        None if disturbance is None else _chosen(disturbance, "disturbance", sys.input_labels, first=False)
    )
    if known is None and noise is None:
        return everything, everything
    if known is None:
        return [i for i in everything if i not in (noise or [])], noise or []
    if noise is None:
        return known, [i for i in everything if i not in known]
    both = [sys.input_labels[i] for i in known if i in noise]
    if both:
        raise ct.ControlArgument(f"an input is either known or a disturbance, {both} were given as both")
    return known, noise


def _chosen(arg: Any, name: str, labels: list[str], *, first: bool) -> list[int]:
    """Indices as python-control reads them: a count (from the start or the end), a slice, or a list."""
    everything = list(range(len(labels)))
    if isinstance(arg, slice):
        return everything[arg]
    if isinstance(arg, int | np.integer) and not isinstance(arg, bool):
        count = int(arg) if first else -int(arg)
        if abs(count) > len(labels):
            raise ct.ControlArgument(f"{name}_indices is too large; max = {len(labels)}, got {arg}")
        return everything[:count] if count > 0 else everything[count:] if count else []
    if isinstance(arg, list | tuple | range):
        return [_index(entry, name, labels) for entry in arg]
    raise ct.ControlArgument(f"invalid argument for {name}_indices: {arg!r}; a count, slice or list is")


def _index(entry: Any, name: str, labels: list[str]) -> int:
    if isinstance(entry, str):
        if entry in labels:
            return labels.index(entry)
    elif isinstance(entry, int | np.integer) and -len(labels) <= entry < len(labels):
        return int(entry) % len(labels)
    raise ct.ControlArgument(f"{name}_indices names {entry!r}, but the inputs of the system are {labels}")


def covariance_matrix(value: ArrayLike, size: int, name: str) -> Array:
    """A covariance of `size`, checked in python-control's words."""
    array = np.atleast_2d(real(value, name))
    if array.ndim != 2 or array.shape[0] != array.shape[1]:
        raise ct.ControlDimension(f"{name} must be a square matrix, got shape {array.shape}")
    if len(array) != size:
        raise ct.ControlDimension(
            f"Incompatible dimensions of {name} matrix; expected ({size}, {size}) but found {array.shape}"
        )
    finite(array, name)
    try:
        check_covariance(array, name)
    except CovarianceError as error:
        if np.allclose(array, array.T):
            raise
        raise ct.ControlArgument(f"{name} must be a symmetric matrix") from error
    return array
