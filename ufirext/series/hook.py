"""What lets `batch_filter` of a streaming UFIRFilter take the fast way, where the numbers are the same.

The first windows and the last ones still stream, so that the warm-up and the state the filter is left in are
its own; all full windows between them are one convolution.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from .._arrays import Array, readings
from ..errors import UfirextError
from .constant import convolved
from .plan import series_plan

__all__ = ["whole_series"]

Results = tuple[Array, Array, Array, Array]


def whole_series(
    f: Any, zs: Any, per_step: Sequence[Any], stream: Callable[[Any], Results]
) -> Results | None:
    """Means and covariances after update and after predict of a fresh filter of a constant model.

    `stream` runs the filter over a part of the series. None, and nothing has happened, where only the stream
    does: changing models, inputs, holes, a filter that has a past or does not read its window alone.
    """
    z = _plain(f, zs, per_step)
    if z is None:
        return None
    state = f._state
    state.settle()
    state.refresh()
    limits, count = state.limits, len(z)
    horizon, left = limits.horizon, 2 * (limits.reach + 1)
    if state.index is None or count < 4 * left:
        return None
    try:
        plan = series_plan(state.model(), horizon)
    except UfirextError:
        return None
    begin = copy.deepcopy(state)
    results = tuple(np.empty((count, *part.shape[1:])) for part in stream(z[:1]))
    f._state = copy.deepcopy(begin)
    head, last = slice(horizon + 1), slice(count - left + horizon, count)
    for whole, part in zip(results, stream(z[head]), strict=True):
        whole[head] = part
    f._state = begin
    tail = stream(z[count - left :])
    flat = np.empty((count, f.dim_x))
    convolved(plan.summed, z[None], flat[None], plan.alignment)
    between = slice(horizon + 1, last.start)
    F, Q, means = f.F, f.Q, results[0].reshape(count, -1)
    means[between] = flat[between]
    results[2].reshape(count, -1)[between] = flat[horizon : last.start - 1] @ F.T
    P = plan.gain.P
    results[1][between], results[3][between] = P, F @ P @ F.T + Q
    for whole, part in zip(results, tail, strict=True):
        whole[last] = part[horizon:]
    return results[0], results[1], results[2], results[3]


def _plain(f: Any, zs: Any, per_step: Sequence[Any]) -> Array | None:
    """The series as (T, dim_z), if filter and series are plain."""
    if not f._plain or any(values is not None for values in per_step):
        return None
    try:
        z = zs if zs.__class__ is np.ndarray and zs.dtype == float else readings(zs, "zs")
    except ValueError:
        return None
    shapes = {(f.dim_z,), (f.dim_z, 1), *([()] if f.dim_z == 1 else [])}
    if not len(z) or z.shape[1:] not in shapes or not np.isfinite(np.vdot(z, z)):
        return None
    return z.reshape(len(z), f.dim_z)
