"""A window grown row by row: gain and exact covariance where the stacked equations are ill-conditioned.

Long windows of unstable models drown their early rows in the powers of F. Here a short prefix of good
condition is solved at once; later rows are absorbed by recursive least squares, which forgets rounding as it
forgets data. Once the state aimed at has been passed, the pair (x now, x aimed at) is carried: lags work too.

With V a whitened row, G the noise power and P the error covariance of the pair, recursive least squares is
K = G V' (V G V' + I)^-1,  G <- (I - K V) G,  P <- (I - K V) P (I - K V)' + K K',  with F and Q between steps.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ._arrays import Array, symmetric
from .window import Window

# A prefix whose scaled rows have a condition below this is a good start.
GOOD_CONDITION = 1e4
# A better conditioned start is looked for within this many more rows for each state.
SEARCH_PER_STATE = 4
# Columns of the root of the error covariance, for each of its rows, beyond which it is compressed.
COLUMNS_PER_ROW = 8


def grown_gain(window: Window) -> Array | None:
    """Gain on the raw rows (dim_x, components); None if no prefix of the rows is a start."""
    growth = _grow(window, covariance=False)
    return None if growth is None else unwhitened(window, growth.K[-window.dim_x :])


def grown_covariance(window: Window) -> Array | None:
    """Exact error covariance (dim_x, dim_x); None if no prefix of the rows is a start."""
    growth = _grow(window, covariance=True)
    if growth is None:
        return None
    error = growth.error[-window.dim_x :]
    return symmetric(error @ error.T)


def _grow(window: Window, covariance: bool) -> _Growth | None:
    count = _start(window)
    if count is None:
        return None
    growth = _Growth(window, count, covariance)
    for index in range(count, len(window.H)):
        growth.advance(window.origins[index])
        growth.absorb(index)
    growth.advance(max(window.aim, window.origins[-1]))
    return growth


def _start(window: Window) -> int | None:
    """How many rows, oldest first, to solve at once: the first that suffice or a better start soon after."""
    best, best_condition, last = None, np.inf, len(window.H)
    for count in range(1, len(window.H) + 1):
        if count > last:
            break
        if count < len(window.H) and window.origins[count] == window.origins[count - 1]:
            continue
        head = _head(window, count)
        if best is None and not _determines(head, window.aim):
            continue
        if best is None:
            last = min(len(window.H), count + SEARCH_PER_STATE * window.dim_x)
        if head.condition < best_condition:
            best, best_condition = count, head.condition
        if best_condition < GOOD_CONDITION:
            break
    return best


def _head(window: Window, count: int) -> Window:
    """The oldest `count` rows, the newest of their states aimed at."""
    end = window.origins[count - 1]
    F, Q = window.F[:end], window.Q[:end]
    return Window(F, Q, window.H[:count], window.R[:count], window.origins[:count], end, window.W[:count])


def _determines(head: Window, aim: int) -> bool:
    """Whether the rows determine their newest state, and the one aimed at if it is not newer."""
    if not (head.rank and head.determined()):
        return False
    if aim >= head.aim:
        return True
    return Window(head.F, head.Q, head.H, head.R, head.origins, aim, head.W).determined()


class _Growth:
    """Gains on whitened rows, and roots of the noise power and the error covariance of the pair.

    Roots, because a start of condition c has variances of order c^2 that would drown what later rows leave.
    """

    def __init__(self, window: Window, count: int, covariance: bool) -> None:
        head = _head(window, count)
        aims = [head.aim] if window.aim >= head.aim else [head.aim, window.aim]
        rank = head.rank
        U, s, Vt = head.spectrum
        targets = np.concatenate([head.products[aim] for aim in aims]) / head.scale
        self.power = targets @ (Vt[:rank].T / s[:rank])
        start = self.power @ U[:, :rank].T
        self.window, self.time = window, head.aim
        self.K = np.zeros((len(start), window.starts[-1]))
        self.K[:, : head.starts[-1]] = start
        self.covariance = covariance
        self.error = np.zeros((len(start), 0))
        if covariance:
            self.error = np.concatenate(_error_columns(head, unwhitened(head, start.copy()), aims), axis=1)

    def advance(self, until: int) -> None:
        """Transitions up to the time `until`; the state aimed at is cloned when it is passed."""
        n, window = self.window.dim_x, self.window
        while self.time < until:
            if self.time == window.aim and len(self.K) == n:
                self.K, self.power, self.error = (
                    np.concatenate([A, A]) for A in (self.K, self.power, self.error)
                )
            for A in (self.K, self.power, self.error):
                A[:n] = window.F[self.time] @ A[:n]
            if self.covariance and window.Q[self.time].any():
                entering = np.zeros((len(self.K), n))
                entering[:n] = root(window.Q[self.time])
                self.error = np.concatenate([self.error, entering], axis=1)
            self.time += 1

    def absorb(self, index: int) -> None:
        """One row, of the present time: A. Andrews' square-root update (AIAA J. 6(6), 1968)."""
        n, window = self.window.dim_x, self.window
        W = window.W[index]
        V = W @ window.H[index]
        one = np.eye(len(V))
        seen = V @ self.power[:n]
        lower = np.linalg.cholesky(seen @ seen.T + one)
        cross = np.linalg.solve(lower, seen @ self.power.T)
        step = np.linalg.solve(lower.T, cross).T
        self.power = self.power - cross.T @ np.linalg.solve(lower + one, seen)
        self.K -= step @ (V @ self.K[:n])
        self.K[:, window.starts[index] : window.starts[index + 1]] += step
        if not self.covariance:
            return
        noise = step @ (W @ root(window.R[index]))
        self.error = np.concatenate([self.error - step @ (V @ self.error[:n]), noise], axis=1)
        if self.error.shape[1] > COLUMNS_PER_ROW * len(self.error):
            self.error = np.asarray(np.linalg.qr(self.error.T, mode="r")).T


def root(P: Array) -> Array:
    """S with S S' = P for a positive semidefinite P, singular or not."""
    if P.shape == (1, 1):
        return np.sqrt(P)
    scale = np.sqrt(np.maximum(np.diag(P), 0.0))
    unit = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(P / np.outer(unit, unit))
    return np.asarray(unit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def unwhitened(window: Window, K: Array) -> Array:
    """A gain on whitened rows, in place, as a gain on the raw ones."""
    for W, start, stop in zip(window.W, window.starts, window.starts[1:], strict=False):
        K[:, start:stop] = K[:, start:stop] @ W
    return K


def _error_columns(window: Window, K: Array, aims: Sequence[int]) -> list[Array]:
    """Columns whose outer products sum to the exact error covariance: D_j Q_j^1/2 and g_r R_r^1/2."""
    paths = noise_paths(window, K, aims)
    process = [D @ root(Q) for D, Q in zip(paths[1:], window.Q, strict=False)]
    gains = (K[:, start:stop] for start, stop in zip(window.starts, window.starts[1:], strict=False))
    return process + [g @ root(R) for g, R in zip(gains, window.R, strict=True)]


def noise_paths(window: Window, K: Array, aims: Sequence[int]) -> list[Array]:
    """D_0 .. D_end of raw gains that aim at one or several times (stacked): responses to w_j.

    D_j = Phi(aim, j) - sum_{r: o_r >= j} g_r H_r Phi(o_r, j) by backward recursion: no inverse of F. D_0 is
    zero for an unbiased gain; what stands there is what rounding has grown to.
    """
    n, end = window.dim_x, max(*aims, window.origins[-1])
    carried = np.zeros((n * len(aims), n))
    index = len(window.H) - 1
    paths = []
    for time in range(end, -1, -1):
        if time < end:
            carried = carried @ window.F[time]
        for place, aim in enumerate(aims):
            if time == aim:
                carried[place * n : (place + 1) * n] += np.eye(n)
        while index >= 0 and window.origins[index] == time:
            carried = carried - K[:, window.starts[index] : window.starts[index + 1]] @ window.H[index]
            index -= 1
        paths.append(carried)
    return paths[::-1]
