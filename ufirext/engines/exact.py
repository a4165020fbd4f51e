"""The exact error covariance of least squares over a window, from the grams of its rows.

x^ - x = sum_j D_j w_j + noise of the rows; with Lam the information of all rows on the oldest state a, and
T = Phi(now, a), the gain on a row is T Lam^-1 Phi(o, a)' H' R^-1. As `ufirext.gains.exact_covariance`, in
which the equations are, without stacking anything.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from .._arrays import Array, symmetric
from .._constant import PATH_ROUNDING
from .._lapack import cholesky_solver
from ..window import Row
from .records import Step


def window_covariance(rows: Sequence[Row], step: Callable[[int], Step], now: int) -> Array | None:
    """P of the newest state from the rows; None where the digits would not do."""
    n = rows[0].H.shape[1]
    first = min(row.origin for row in rows)
    steps = [step(number) for number in range(first + 1, now + 1)]
    grams = np.zeros((len(steps) + 1, n, n))
    for row in rows:
        grams[row.origin - first] += row.gram[:-1, :-1]
    products = [np.eye(n)]
    for transition in steps:
        products.append(transition.F.dot(products[-1]))
    ahead = np.array(products)
    information = (ahead.transpose(0, 2, 1) @ grams @ ahead).sum(axis=0)
    _, share, info = cholesky_solver()(information, products[-1].T)  # Lam^-1 T'
    if info:
        return None
    pulls = (ahead @ share).transpose(0, 2, 1) @ grams  # g_r H_r, summed over the rows of a step
    paths = [np.eye(n) - pulls[-1]]
    for transition, pull in zip(reversed(steps), pulls[-2::-1], strict=True):
        paths.append(paths[-1].dot(transition.F) - pull)
    P: Array = symmetric(products[-1].dot(share))
    if steps:
        D, Q = np.array(paths[-2::-1]), np.array([one.Q for one in steps])
        P = P + (D @ Q @ D.transpose(0, 2, 1)).sum(axis=0)
        # D_0 = 0 but for rounding, which has entered every D to about the same amount.
        rounding = paths[-1] @ Q.sum(axis=0) @ paths[-1].T
        if not (rounding.diagonal() <= PATH_ROUNDING**2 * P.diagonal()).all():
            return None
    return symmetric(P)
