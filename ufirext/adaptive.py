"""The horizon from data: matched-lead prediction errors, over a recorded series or while it streams.

An estimate with window N is judged by how well it foretells measurements it has not used: a row (o, a, z) is
compared with H x^_o as it stood at time o if it is late, else with H F x^_{o-1}. Needs no Q.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike

from ._arrays import Array, integer, number, readings
from .errors import HorizonError, NonFiniteError, ShapeError
from .gains import least_squares
from .model import Model
from .window import model_window, whitener

__all__ = ["BANK", "HorizonBank", "bank_candidates", "from_data"]

# Horizons of the online bank, about a factor 1.35 apart.
BANK = (3, 4, 5, 6, 8, 11, 15, 21, 30)
# Ratio of neighbours in the first grid over a recorded series.
GRID_RATIO = 1.25
# At most this many predictions of a long series, evenly spread, are judged.
JUDGED = 5000
# Predictions computed at once: bounds the memory of the windows.
CHUNK = 1000
# Eigenvalues of scaled normal equations below this fraction count as zero.
INFORMATION_TOLERANCE = 1e-10


def from_data(model: Model, zs: ArrayLike, first: int, last: int) -> int:
    """The horizon in first .. last with the least mean-square one-step prediction error over a series."""
    z, seen = _series(model, zs)
    needed = 2 * first
    if seen.any(axis=1).sum() < needed:
        raise ShapeError(
            f"zs must hold at least {needed} measurements to choose among horizons from {first} on, "
            f"got {int(seen.any(axis=1).sum())} in {len(z)} rows"
        )
    top = min(last, len(z) // 2)
    targets = np.flatnonzero(seen.any(axis=1))
    targets = targets[targets >= top]
    targets = targets[np.linspace(0, len(targets) - 1, min(len(targets), JUDGED)).astype(int)]
    grid = _grid(first, top)
    table = np.array([_prediction_errors(model, z, seen, targets, N) for N in grid])
    # Long gaps leave short windows without an estimate: those that seldom have one do not compete.
    kept = np.isfinite(table).mean(axis=1) >= 0.5 if len(targets) else np.zeros(len(grid), dtype=bool)
    if not kept.any():
        raise ShapeError(
            f"zs must hold measurements close enough together to predict one from the {top} steps before it, "
            f"got {int(seen.any(axis=1).sum())} in {len(z)} rows"
        )
    table = table[kept]
    common = np.isfinite(table).all(axis=0)
    competing = [N for N, keep in zip(grid, kept, strict=True) if keep]
    scores = dict(zip(competing, table[:, common].mean(axis=1).tolist(), strict=True))
    while True:
        best = min(scores, key=lambda N: (scores[N], N))
        fresh = _between(sorted(scores), best)
        if not fresh:
            return best
        for N in fresh:
            scores[N] = float(_prediction_errors(model, z, seen, targets[common], N).mean())


def _series(model: Model, zs: ArrayLike) -> tuple[Array, Array]:
    """The series as (steps, dim_z) with zeros for NaN, and which components are there."""
    z = readings(zs, "zs")
    if z.ndim == 3 and z.shape[2] == 1:
        z = z[:, :, 0]
    if z.ndim == 1 and model.dim_z == 1:
        z = z[:, None]
    if z.ndim != 2 or z.shape[1] != model.dim_z:
        raise ShapeError(f"zs must have shape (any, {model.dim_z}) (steps, dim_z), got {z.shape}")
    if np.isinf(z).any():
        step = int(np.flatnonzero(np.isinf(z).any(axis=1))[0])
        raise NonFiniteError(f"zs must be finite or NaN (missing), got an infinity at step {step}")
    seen = np.isfinite(z)
    if np.count_nonzero(model.R - np.diag(np.diag(model.R))):
        # Correlated noise cannot be weighted component by component: a broken row is left out whole.
        seen = np.repeat(seen.all(axis=1, keepdims=True), model.dim_z, axis=1)
    return np.where(seen, z, 0.0), seen


def _grid(first: int, top: int) -> list[int]:
    """Horizons from first to top in equal ratios."""
    count = max(2, int(np.ceil(np.log(max(top / first, 1.0)) / np.log(GRID_RATIO))) + 1)
    return [int(N) for N in np.unique(np.round(np.geomspace(first, max(top, first), count)))]


def _between(tried: Sequence[int], best: int) -> list[int]:
    """Up to six untried horizons between the best one and its neighbours."""
    place = tried.index(best)
    low, high = tried[max(place - 1, 0)], tried[min(place + 1, len(tried) - 1)]
    sides = [np.linspace(low, best, 5)[1:-1], np.linspace(best, high, 5)[1:-1]]
    return sorted({round(float(N)) for side in sides for N in side} - set(tried))


def _prediction_errors(model: Model, z: Array, seen: Array, targets: Array, horizon: int) -> Array:
    """(targets,) squared R-weighted errors of z_o against H F x^_{o-1}; NaN where no estimate exists."""
    window = model_window(model, horizon)
    C, T = window.C / window.scale, window.T / window.scale
    W = whitener(model.R)
    ahead = W @ model.H @ model.F
    gain = ahead @ least_squares(window)
    values = sliding_window_view(z, horizon, axis=0)
    masks = sliding_window_view(seen, horizon, axis=0)
    result = np.empty(len(targets))
    for begin in range(0, len(targets), CHUNK):
        chosen = targets[begin : begin + CHUNK]
        # (chunk, dim_z, horizon) -> oldest row first, as in a gain
        Z = values[chosen - horizon].transpose(0, 2, 1).reshape(len(chosen), -1)
        there = masks[chosen - horizon].transpose(0, 2, 1).reshape(len(chosen), -1)
        foretold = Z @ gain.T
        holed = ~there.all(axis=1)
        if holed.any():
            foretold[holed] = _masked(C, ahead @ T, W, Z[holed], there[holed])
        errors = np.where(seen[chosen], z[chosen] @ W.T - foretold, 0.0)
        result[begin : begin + CHUNK] = (errors**2).sum(axis=1)
    return result


def _masked(C: Array, aim: Array, W: Array, Z: Array, there: Array) -> Array:
    """Predictions of windows with holes: normal equations over the rows that are there; NaN if undetermined.

    C is whitened and column-scaled; zeros in Z stand for what is missing, so that only C'C needs the mask.
    """
    count, states = C.shape
    m = len(W)
    white = (Z.reshape(-1, m) @ W.T).reshape(len(Z), count)
    information = (there @ (C[:, :, None] * C[:, None, :]).reshape(count, -1)).reshape(-1, states, states)
    values, vectors = np.linalg.eigh(information)
    visible = values > INFORMATION_TOLERANCE * np.maximum(values[:, -1:], np.finfo(float).tiny)
    inverse = np.where(visible, 1.0 / np.where(visible, values, 1.0), 0.0)
    directions = aim @ vectors
    unseen = np.sqrt((np.where(visible[:, None, :], 0.0, directions) ** 2).sum(axis=2))
    size = np.sqrt((aim**2).sum(axis=1))
    projected = (white @ C)[:, None, :] @ vectors
    foretold = (directions * inverse[:, None, :] * projected).sum(axis=2)
    foretold[(unseen > np.sqrt(INFORMATION_TOLERANCE) * size).any(axis=1)] = np.nan
    return np.asarray(foretold)


def bank_candidates(shortest: int) -> tuple[int, ...]:
    """Horizons of the bank for a model whose shortest horizon is `shortest`: one row to spare at least.

    Examples
    --------
    >>> from ufirext.adaptive import bank_candidates
    >>> bank_candidates(4)
    (5, 6, 8, 11, 15, 21, 30)
    """
    lowest = shortest + 1
    kept = tuple(N for N in BANK if lowest <= N)
    # A model that needs longer windows than the bank holds gets the same ratios from its own shortest one.
    return kept if len(kept) > 2 else tuple(round(lowest * N / BANK[0]) for N in BANK)


class HorizonBank:
    """Chooses a horizon online: exponentially forgotten mean-square prediction errors of several candidates.

    Parameters
    ----------
    candidates : sequence of int
        Horizons, ascending.
    forgetting : float
        Weight of a score after one more step, in (0, 1); 0.99 remembers about 100 measurements.

    Examples
    --------
    >>> from ufirext.adaptive import HorizonBank
    >>> bank = HorizonBank((4, 8, 16))
    >>> for _ in range(20):
    ...     bank.score([2.0, 1.5, 1.0])
    >>> bank.best
    16
    """

    # Effective number of errors a candidate needs before it may be chosen.
    ENOUGH = 8.0
    # A challenger must be better by this fraction: equal candidates do not take turns.
    MARGIN = 0.02
    # Means closer than this fraction are equal: the shortest horizon wins.
    TIE = 1e-9

    __slots__ = ("_best", "_counts", "_sums", "candidates", "forgetting")

    def __init__(self, candidates: Sequence[int], forgetting: float = 0.99) -> None:
        sizes = tuple(integer(N, "candidates", 1) for N in candidates)
        if not sizes or list(sizes) != sorted(set(sizes)):
            raise HorizonError(
                f"candidates must be ascending horizons, at least one, got {tuple(candidates)}"
            )
        forgetting = number(forgetting, "forgetting")
        if not 0.0 < forgetting < 1.0:
            raise HorizonError(f"forgetting must lie between 0 and 1, got {forgetting!r}")
        self.candidates = sizes
        self.forgetting = forgetting
        self._sums = np.zeros(len(sizes))
        self._counts = np.zeros(len(sizes))
        # The middle one until there is evidence: neither deadbeat nor sluggish.
        self._best = len(sizes) // 2

    @property
    def best(self) -> int:
        """The candidate in use."""
        return self.candidates[self._best]

    def score(self, errors: ArrayLike) -> None:
        """Take one row's squared whitened prediction errors, NaN for a candidate that had none."""
        fresh = readings(errors, "errors")
        if fresh.shape != self._sums.shape:
            raise ShapeError(
                f"errors must have shape {self._sums.shape} (one a candidate), got {fresh.shape}"
            )
        there = ~np.isnan(fresh)
        if not there.any():
            return
        self._sums *= self.forgetting
        self._counts *= self.forgetting
        self._sums += np.where(there, fresh, 0.0)
        self._counts += there
        self._choose()

    def _choose(self) -> None:
        eligible = self._counts >= self.ENOUGH
        if not eligible.any():
            return
        means = np.where(eligible, self._sums, np.inf) / np.where(eligible, self._counts, 1.0)
        # While windows grow the longer candidates are one and the same: rounding must not choose.
        challenger = int((means <= means.min() * (1.0 + self.TIE)).argmax())
        if means[challenger] < (1.0 - self.MARGIN) * means[self._best]:
            self._best = challenger

    def scores(self) -> Array:
        """(candidates,) forgotten mean-square errors, NaN where there is none yet."""
        return np.where(
            self._counts > 0.0, self._sums / np.where(self._counts > 0.0, self._counts, 1.0), np.nan
        )

    def copy(self) -> HorizonBank:
        """An independent bank in the same state."""
        twin = HorizonBank(self.candidates, self.forgetting)
        twin._sums[:], twin._counts[:], twin._best = self._sums, self._counts, self._best
        return twin
