"""From a control.StateSpace to a filter with filterpy's verbs, and back."""

from __future__ import annotations

from typing import Any, TypeVar

import control as ct
import numpy as np
from numpy.typing import ArrayLike

from .._arrays import Array
from ..errors import UfirextError
from ..model import discretise
from .plant import Indices, Plant, linear_system, read_plant

__all__ = ["from_statespace", "to_statespace"]

FilterT = TypeVar("FilterT")


def from_statespace(
    kind: type[FilterT],
    sys: ct.StateSpace,
    QN: ArrayLike | None = None,
    RN: ArrayLike | None = None,
    dt: float | None = None,
    *,
    G: ArrayLike | None = None,
    C: ArrayLike | None = None,
    control_indices: Indices = None,
    disturbance_indices: Indices = None,
    **options: Any,
) -> FilterT:
    """A filter of class `kind` for the plant `sys`: F = A, B of the known inputs, H = C, Q = G QN G', R = RN.

    Parameters
    ----------
    kind : type
        UFIRFilter, FMSFilterSmoother, DelayKalmanFilter or DelayHInfinityFilter.
    sys : control.StateSpace
        Discrete-time, or continuous-time with `dt`.
    QN, RN : array_like, (dim_w, dim_w) and (dim_z, dim_z), optional
        Covariances of the disturbances and of the measurement noise of one sample; of a continuous system
        QN is the spectral density. Only least squares over a horizon that is given, or adaptive, do without:
        UFIRFilter then keeps the identity for R.
    dt : float, optional
        Step in seconds by which a continuous system is discretised: zero-order hold for u, Van Loan for QN.
    G, C, control_indices, disturbance_indices : optional
        As for `create_ufir_iosystem`.
    **options
        Keywords of the class.

    Returns
    -------
    kind

    Raises
    ------
    control.ControlArgument, control.ControlDimension
        For a system or a matrix that does not fit; for a continuous system without `dt`; without QN or RN
        where the filter, or horizon="auto", weighs them.
    NotImplementedError
        For D != 0, for which filterpy's verbs have no place.

    Examples
    --------
    >>> import control as ct
    >>> from ufirext import UFIRFilter
    >>> from ufirext.control import from_statespace
    >>> cart = ct.ss([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], 0)
    >>> from_statespace(UFIRFilter, cart, QN=0.1, RN=4.0, dt=0.5, horizon=8).F
    array([[1. , 0.5],
           [0. , 1. ]])
    """
    caller = f"{kind.__name__}.from_statespace"
    linear_system(sys, caller)
    named: dict[str, Any] = {
        "C": C,
        "control_indices": control_indices,
        "disturbance_indices": disturbance_indices,
    }
    if dt is None and ct.isctime(sys, strict=True):
        raise ct.ControlArgument(
            f"{caller}() called with a continuous-time system; pass dt, the step in seconds, to discretise "
            f"it: {caller}(sys, QN, RN, dt=...)"
        )
    if dt is not None and ct.isctime(sys, strict=True):
        plant, Q = _sampled(sys, caller, QN, dt, G, named)
    else:
        _require_step(sys, dt, caller)
        plant = read_plant(sys, caller, G=G, **named)
        Q = None if QN is None else plant.model(QN).Q
    if plant.D.any():
        raise NotImplementedError(
            f"{caller}() called with nonzero 'D' matrix: update(z) has no place for it; make the filter from "
            "the system with D = 0 and pass update(y - D @ u)"
        )
    new: Any = kind(plant.dim_x, plant.dim_z, plant.dim_u, **options)  # type: ignore[call-arg]
    if (QN is None or RN is None) and new._weighing:
        raise ct.ControlArgument(
            f"{caller}(): {new._weighing} weighs process against measurement noise: give QN and RN"
        )
    new.F, new.H = plant.A, plant.C
    if plant.dim_u:
        new.B = plant.B
    if Q is not None:
        new.Q = Q
    if RN is not None:
        new.R = plant.measurement_noise(RN)
    return new  # type: ignore[no-any-return]


def _sampled(
    sys: ct.StateSpace,
    caller: str,
    QN: ArrayLike | None,
    dt: float,
    G: ArrayLike | None,
    named: dict[str, Any],
) -> tuple[Plant, Array | None]:
    """The discretised plant and the covariance that its noise gathers over one step."""
    if isinstance(dt, bool) or not 0.0 < dt < np.inf:
        raise ct.ControlArgument(f"{caller}() needs dt as a positive number of seconds, got {dt!r}")
    # As if it were discrete, to find G and to check QN; the hold changes both.
    same = ct.StateSpace(
        sys.A, sys.B, sys.C, sys.D, float(dt), inputs=sys.input_labels, outputs=sys.output_labels
    )
    raw = read_plant(same, caller, G=G, **named)
    plant = read_plant(ct.c2d(sys, float(dt), copy_names=True), caller, G=G, **named)
    Q = None if QN is None else discretise(raw.A, raw.G, raw.process_noise(QN), float(dt))[1]
    return plant, Q


def _require_step(sys: ct.StateSpace, dt: float | None, caller: str) -> None:
    if dt is None or sys.dt is None or sys.dt is True or np.isclose(dt, sys.dt, rtol=1e-9):
        return
    raise ct.ControlArgument(
        f"{caller}() called with dt={dt} and a discrete-time system with dt={sys.dt}; leave dt out"
    )


def to_statespace(filter: Any, dt: float | bool = True, *, disturbances: bool | None = None) -> ct.StateSpace:  # noqa: A002
    """The plant that a filter assumes, as a discrete-time ``control.StateSpace``.

    Parameters
    ----------
    filter : UFIRFilter, FMSFilterSmoother, DelayKalmanFilter or DelayHInfinityFilter
        Or anything else with filterpy's F, B and H.
    dt : float or True, optional
        Step in seconds; a filter does not know it.
    disturbances : bool, optional
        Add an input w[i] for each state, the process noise: ``disturbance_indices=dim_x`` and QN=filter.Q
        then describe it. Default: only where the filter has no B, as a system needs some input.

    Returns
    -------
    control.StateSpace
        Inputs u[i] (then w[i]), outputs y[i].

    Raises
    ------
    ValueError
        For a filter without B and disturbances=False.

    Examples
    --------
    >>> import control as ct
    >>> from ufirext import UFIRFilter
    >>> from ufirext.control import to_statespace
    >>> plant = ct.ss([[1, 0.1], [0, 1]], [[0], [0.1]], [[1, 0]], 0, dt=0.1)
    >>> f = UFIRFilter.from_statespace(plant, [[1]], [[0.01]], horizon=12)
    >>> back = to_statespace(f, dt=0.1)
    >>> bool((back.A == plant.A).all() and (back.B == plant.B).all())
    True
    """
    F, H = np.atleast_2d(filter.F), np.atleast_2d(filter.H)
    n = len(F)
    B = np.zeros((n, 0)) if filter.B is None else np.asarray(filter.B, dtype=float).reshape(n, -1)
    noisy = not B.shape[1] if disturbances is None else disturbances
    if not noisy and not B.shape[1]:
        raise UfirextError(
            "a system needs an input, but the filter has no B; pass disturbances=True, or leave it out"
        )
    names = [f"u[{i}]" for i in range(B.shape[1])]
    if noisy:
        B, names = np.hstack([B, np.eye(n)]), names + [f"w[{i}]" for i in range(n)]
    return ct.StateSpace(F, B, H, np.zeros((len(H), B.shape[1])), dt, inputs=names)
