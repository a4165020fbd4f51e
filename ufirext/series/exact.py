"""The exact error covariances of least squares over the windows of a series, side by side.

As `ufirext.engines.exact`, which goes window by window.
"""

from __future__ import annotations

import numpy as np

from .._arrays import Array
from .._constant import PATH_ROUNDING
from .batched import gram, padded, positive_solution, product
from .scan import WEAK_PIVOT
from .windows import Mask

__all__ = ["window_covariances"]

# Numbers that the products of transitions may hold.
TABLE = 4_000_000


def window_covariances(F: Array, Q: Array, grams: Array, horizon: int, lag: int) -> tuple[Array, Mask]:
    """P of the state `lag` steps before the end of each window, (T, n, n), and where its digits will do.

    F, Q, grams : (T, n, n), the transition into each step, its noise, and H'R^-1H of what is measured there.
    """
    steps, n = F.shape[:2]
    P, sound = np.empty((steps, n, n)), np.zeros(steps, dtype=np.bool_)
    together = max(1, TABLE // (horizon * n * n))
    for start in range(0, steps, together):
        some = slice(start, min(start + together, steps))
        first, length = start - horizon + 1, horizon - 1 + some.stop - start
        # Before the series nothing comes and nothing moves: windows begin with its first row.
        moves, noise, rows = (
            padded(series, first, length, outside)
            for series, outside in ((F, np.eye(n)), (Q, np.zeros((n, n))), (grams, np.zeros((n, n))))
        )
        if first <= 0:
            moves[-first] = np.eye(n)
        batched = [np.ascontiguousarray(series.transpose(1, 2, 0)) for series in (moves, noise, rows)]
        with np.errstate(over="ignore", invalid="ignore"):
            found, sound[some] = _side_by_side(batched[0], batched[1], batched[2], horizon, lag)
        P[some] = found.transpose(2, 0, 1)
    return P, sound


def _side_by_side(F: Array, Q: Array, grams: Array, horizon: int, lag: int) -> tuple[Array, Mask]:
    """The same for series (n, n, horizon - 1 + count) that begin with the first step of the first window."""
    n, count, aim = len(F), F.shape[2] - horizon + 1, horizon - 1 - lag

    def at(series: Array, step: int) -> Array:
        """What the series has at a step of every window."""
        return series[:, :, step : step + count]

    unit = np.broadcast_to(np.eye(n)[:, :, None], (n, n, count))
    ways = [unit]
    for step in range(1, horizon):
        ways.append(product(at(F, step), ways[-1]))
    information = np.zeros((n, n, count))
    for step, way in enumerate(ways):
        information += gram(way, product(at(grams, step), way))
    share, sound = positive_solution(information, ways[aim].transpose(1, 0, 2), WEAK_PIVOT)
    P = product(ways[aim], share)
    path, total = np.zeros((n, n, count)), np.zeros((n, n, count))
    for step in range(horizon - 1, -1, -1):
        # What an error that enters at this step does to the estimate, less what it does to the state.
        if step < horizon - 1:
            path = product(path, at(F, step + 1))
        path = path - gram(product(ways[step], share), at(grams, step))
        if step == aim:
            path += unit
        if step:
            P += _through(path, at(Q, step))
            total += at(Q, step)
    # The oldest path is 0 but for rounding, which has entered all others to about the same amount.
    diagonal = range(n), range(n)
    rounding = _through(path, total)[diagonal]
    sound &= (rounding <= PATH_ROUNDING**2 * P[diagonal]).all(axis=0)
    return 0.5 * (P + P.transpose(1, 0, 2)), sound


def _through(path: Array, Q: Array) -> Array:
    return product(product(path, Q), path.transpose(1, 0, 2))
