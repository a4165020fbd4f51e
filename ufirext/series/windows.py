"""Which steps of a series are solved, how far back their windows reach, and what the others are.

The rules of the streaming filter, for all steps of one series at once. How windows are solved is for the
subclasses: together where they can be, one by one where they must reach back or are ill conditioned.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from .._arrays import Array
from ..engines.records import Limits

__all__ = ["Mask", "Windows"]

Mask = NDArray[np.bool_]


class Windows:
    """The windows of one series.

    Parameters
    ----------
    came : (T,)
        Whether a step brought a measurement.
    limits : Limits
    lag : int
    coasts : bool
        Steps without a measurement keep the last estimate, moved along.
    doubled : int
        So many rows may be of one instant.
    """

    def __init__(self, came: Mask, limits: Limits, lag: int, coasts: bool, doubled: int = 1) -> None:
        self.came, self.limits, self.lag = came, limits, lag
        self.wanted = min(limits.horizon, limits.instants) if limits.extends else 0
        self.total: NDArray[np.int64] = np.concatenate([[0], np.cumsum(came, dtype=np.int64)])
        steps = np.arange(len(came))
        self.starts = np.maximum(steps - limits.horizon + 1, 0)
        inside = self.total[1:] - self.total[self.starts]
        # Lagged states are always asked of the window.
        self.coasts, self.waits = coasts and not lag, coasts
        self.solved = came.copy() if self.coasts else np.ones_like(came)
        reached = np.maximum(steps - limits.reach + 1, 0)
        older = self.total[self.starts] - self.total[reached] > 0
        self.short: Mask = limits.extends & (inside < self.wanted * doubled) & older

    def together(self, wanted: Mask, x: Array) -> Mask:
        """Solve windows of the plain length that end at the steps `wanted`; which of them are solved well."""
        raise NotImplementedError

    def alone(self, step: int, begin: int, lag: int) -> Array | None:
        """The state of step - lag from the window begin .. step; None where its rows do not determine it."""
        raise NotImplementedError

    def instants(self, step: int, begin: int) -> int:
        """Number of instants measured in the window begin .. step."""
        return int(self.total[step + 1] - self.total[begin])

    def moved(self, x: Array, steps: NDArray[np.int64]) -> Array:
        """States (count, dim_x) of the steps before `steps`, moved on to them."""
        raise NotImplementedError

    def fill(self, x: Array, ready: Mask, wanted: Mask | None = None) -> None:
        """Estimates of the steps `wanted` (default: all) into x (T, dim_x) and ready; others are there."""
        wanted = self.solved if wanted is None else self.solved & wanted
        sound = self.together(wanted & ~self.short, x)
        # Whether the newest state is determined; full windows that are not asked for determine it.
        newest = sound | (~wanted & (np.arange(len(x)) >= self.limits.instants - 3))
        for step in np.flatnonzero(wanted & ~sound).tolist():
            newest[step], found = self._reaching(step)
            sound[step] = found is not None
            x[step] = np.nan if found is None else found
        ready[wanted] = sound[wanted]
        ready[: self.lag] = False
        if self.lag and self.waits:
            self._as_at_the_last_row(ready, newest)
        if self.coasts:
            self._coast(x, ready)
        x[~ready] = np.nan

    def _as_at_the_last_row(self, ready: Mask, newest: Mask) -> None:
        """A filter that coasts is as ready as it was when the last row came."""
        last: NDArray[np.int64] = np.maximum.accumulate(np.where(self.came, np.arange(len(ready)), -1))
        ready &= np.where(last < 0, False, newest[last])

    def _reaching(self, step: int) -> tuple[bool, Array | None]:
        """One window, as far back as it must reach: does it determine the newest state, and the one wanted.

        It is the newest state that decides how far, also where a lagged one is wanted.
        """
        limits = self.limits
        floor, begin = max(step - limits.reach + 1, 0), max(step - limits.horizon + 1, 0)
        while True:
            older = np.flatnonzero(self.came[floor:begin])
            if not len(older) or self.instants(step, begin) >= self.wanted:
                found = self.alone(step, begin, 0)
                if found is not None and self.lag:
                    return True, self.alone(step, begin, self.lag) if step >= self.lag else None
                if found is not None or not len(older) or not limits.extends:
                    return found is not None, found
            begin = floor + int(older[-1])

    def _coast(self, x: Array, ready: Mask) -> None:
        """Steps without a measurement are predictions, as long as the window reaches enough rows."""
        steps = np.arange(len(x))
        last: NDArray[np.int64] = np.maximum.accumulate(np.where(self.came, steps, -1))
        ready[last < 0] = False
        gap = np.where(last < 0, 0, steps - last)
        certain = self.limits.reach - self.limits.horizon
        order = np.argsort(gap, kind="stable")
        bounds = np.searchsorted(gap[order], np.arange(1, int(gap.max(initial=0)) + 2))
        for length, (low, high) in enumerate(pairwise(bounds.tolist()), 1):
            here = order[low:high]
            x[here] = self.moved(x[here - 1], here)
            ready[here] = ready[here - 1]
            if length >= certain:
                for step in here[ready[here]].tolist():
                    ready[step] = self._reaching(step)[0]
