"""Dead time of a sampled plant: delay lines in its state, which make A singular."""

from __future__ import annotations

import control as ct
import numpy as np

from .._arrays import Array, integer
from .plant import Indices, read_plant, told_apart

__all__ = ["with_dead_time"]


def with_dead_time(
    sys: ct.StateSpace,
    input_delay: int = 0,
    output_delay: int = 0,
    *,
    control_indices: Indices = None,
    disturbance_indices: Indices = None,
    name: str | None = None,
) -> ct.StateSpace:
    """The plant whose known inputs act, and whose outputs show, some steps later.

    Its state is that of `sys` followed by the delay lines, newest entry first: the last known inputs, then
    the last outputs. Signal names are kept; disturbances are not delayed. A window of such a plant spends its
    first `output_delay` measurements on the delay line: lengthen the horizon by as much.

    Parameters
    ----------
    sys : control.StateSpace
        Discrete-time.
    input_delay, output_delay : int, optional
        Steps.
    control_indices, disturbance_indices : optional
        Which inputs are delayed and which are not, as for `create_ufir_iosystem`.
    name : str, optional

    Returns
    -------
    control.StateSpace
        A has a pole at 0 for every step and signal that is delayed.

    Raises
    ------
    control.ControlArgument
        For a system that does not fit.
    HorizonError
        If a delay is no count.

    Examples
    --------
    >>> import control as ct
    >>> from ufirext.control import create_ufir_iosystem, with_dead_time
    >>> plant = ct.ss([[1, 0.1], [0, 1]], [[0], [0.1]], [[1, 0]], 0, dt=0.1)
    >>> late = with_dead_time(plant, input_delay=2, output_delay=1)
    >>> late.state_labels
    ['x[0]', 'x[1]', 'u[0][k-1]', 'u[0][k-2]', 'y[0][k-1]']
    >>> create_ufir_iosystem(late, horizon=12).noutputs
    5
    """
    read_plant(sys, "with_dead_time")
    known, _ = told_apart(sys, control_indices, disturbance_indices)
    steps_in = integer(input_delay, "input_delay", 0)
    steps_out = integer(output_delay, "output_delay", 0)
    A, B, C, D = _outputs_delayed(*_inputs_delayed(sys, known, steps_in), steps_out)
    past = _past([sys.input_labels[i] for i in known], steps_in) + _past(sys.output_labels, steps_out)
    return ct.StateSpace(
        A,
        B,
        C,
        D,
        sys.dt,
        inputs=sys.input_labels,
        outputs=sys.output_labels,
        states=list(sys.state_labels) + past,
        name=name,
        remove_useless_states=False,
    )


def _past(names: list[str], steps: int) -> list[str]:
    return [f"{name}[k-{age}]" for age in range(1, steps + 1) for name in names]


def _line(width: int, steps: int) -> tuple[Array, Array, Array]:
    """A delay line: A, B, C of s[k+1] = [a[k]; s without its last entry], out = its last entry."""
    size = width * steps
    A = np.eye(size, k=-width)
    return A, np.eye(size, width), np.eye(width, size, k=size - width)


def _inputs_delayed(sys: ct.StateSpace, known: list[int], steps: int) -> tuple[Array, Array, Array, Array]:
    if not steps:
        return sys.A, sys.B, sys.C, sys.D
    shift, enter, leave = _line(len(known), steps)
    others = np.array(sys.B), np.array(sys.D)
    late = others[0][:, known], others[1][:, known]
    others[0][:, known] = others[1][:, known] = 0.0
    own = np.zeros((len(shift), sys.ninputs))
    own[:, known] = enter
    A = np.block([[sys.A, late[0] @ leave], [np.zeros((len(shift), sys.nstates)), shift]])
    return A, np.vstack([others[0], own]), np.hstack([sys.C, late[1] @ leave]), others[1]


def _outputs_delayed(A: Array, B: Array, C: Array, D: Array, steps: int) -> tuple[Array, Array, Array, Array]:
    if not steps:
        return A, B, C, D
    shift, enter, leave = _line(len(C), steps)
    through = np.block([[A, np.zeros((len(A), len(shift)))], [enter @ C, shift]])
    out = np.hstack([np.zeros((len(C), len(A))), leave])
    return through, np.vstack([B, enter @ D]), out, np.zeros_like(D)
