"""Error covariances of whole series, when somebody reads them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .._arrays import Array
from .constant import head_covariances
from .engines import CONSTANT, plan_of
from .plan import SeriesPlan
from .request import Request
from .stepwise import stepwise_covariances

__all__ = ["covariances"]


def covariances(request: Request, kinds: NDArray[np.int8], many: bool) -> Array:
    """P of all series: those of series without holes are the same but for the prior."""
    shape, n = (request.count, request.steps), request.model.dim_x
    regular = kinds == CONSTANT
    if len(kinds) and not regular.any():
        P = stepwise_covariances(request)
        return P if many else P[0]
    common = _common_covariances(request, plan_of(request))
    if regular.all() and request.prior is None:
        return np.broadcast_to(common, (*shape, n, n)) if many else common
    P = np.empty((*shape, n, n))
    P[regular] = common
    if not regular.all():
        P[~regular] = stepwise_covariances(request.only(~regular))
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
