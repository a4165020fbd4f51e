"""Error covariances of whole series, when somebody reads them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .._arrays import Array
from .constant import head_covariances
from .engines import CONSTANT, SCAN, limits_of, plan_of
from .exact import window_covariances
from .plan import SeriesPlan
from .request import Request
from .rows import rows_of
from .stepwise import stepwise_covariances
from .variance import VarianceScan
from .windows import Mask

__all__ = ["covariances"]


def covariances(request: Request, kinds: NDArray[np.int8], ready: Mask, many: bool) -> Array:
    """P of all series: those of series without holes are the same but for the prior."""
    shape, n = (request.count, request.steps), request.model.dim_x
    regular = kinds == CONSTANT
    if len(kinds) and not regular.any():
        P = _one_by_one(request, kinds, ready)
        return P if many else P[0]
    common = _common_covariances(request, plan_of(request))
    if regular.all() and request.prior is None:
        return np.broadcast_to(common, (*shape, n, n)) if many else common
    P = np.empty((*shape, n, n))
    P[regular] = common
    if not regular.all():
        P[~regular] = _one_by_one(request.only(~regular), kinds[~regular], ready[~regular])
    if request.prior is not None:
        stop = plan_of(request).first - 1
        head = replace(request.only(regular), z=request.z[regular, :stop])
        P[regular, :stop] = stepwise_covariances(head)
    return P if many else P[0]


def _common_covariances(request: Request, plan: SeriesPlan) -> Array:
    n, begin = request.model.dim_x, min(plan.horizon - 1, request.steps)
    P = np.empty((request.steps, n, n))
    P[begin:] = plan.gain.P
    if begin and plan.head is None:
        P[:begin] = stepwise_covariances(replace(request.only(slice(1)), z=request.z[:1, :begin]))[0]
    elif begin:
        P[:begin] = head_covariances(plan, begin)
    return P


def _one_by_one(request: Request, kinds: NDArray[np.int8], ready: Mask) -> Array:
    """Series of which each has covariances of its own."""
    n = request.model.dim_x
    P = np.empty((request.count, request.steps, n, n))
    for series, kind in enumerate(kinds.tolist()):
        one = request.only(slice(series, series + 1))
        found = _side_by_side(one, ready[series]) if kind == SCAN else None
        P[series] = stepwise_covariances(one)[0] if found is None else found
    return P


def _side_by_side(request: Request, ready: Mask) -> Array | None:
    """All windows of one series together, with what is too delicate for that step by step.

    None where measurements are late or missing: windows are not all alike then.
    """
    limits = limits_of(request)
    rows = None if request.delays is not None else rows_of(request, 0, limits)
    if rows is None or not rows.came.all():
        return None
    n = request.model.dim_x
    F, H = rows.G[:, :n, :n], rows.A[:, :, :n]
    Q = np.broadcast_to(request.model.Q if request.per_step.Q is None else request.per_step.Q, F.shape)
    if request.unbiased:
        P, sound = window_covariances(F, Q, H.transpose(0, 2, 1) @ H, request.horizon, request.lag)
    else:
        P, sound = VarianceScan(rows, Q, limits).covariances()
    P[~ready] = np.nan
    others = np.flatnonzero(ready & ~sound if request.prior is None else ~(ready & sound))
    if len(others):
        stop = int(others[-1]) + 1
        P[others] = stepwise_covariances(replace(request, z=request.z[:, :stop]))[0, others]
    return P
