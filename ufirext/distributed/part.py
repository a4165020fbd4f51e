"""A part of a long series: the rows before it that it depends on, and the numbers of the whole series.

A window of the last N rows knows nothing of what came before. A part preceded by horizon - 1 + lag + the
largest delay rows has therefore exactly the estimates of the whole series, unless rows are missing and a
window reaches further back, or an estimate coasts across the edge: then `Task.run` says so.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._arrays import Array, integer, lag_within, one_of
from ..engines.records import Limits
from ..errors import UfirextError
from ..gains import observability_index
from ..model import Model, require_model
from ..series import SeriesPlan, filter_series, series_plan
from ..series.plan import chosen_horizon

__all__ = ["BeyondOverlap", "BeyondOverlapWarning", "Task", "chunk_length"]

# A part is at least so long: a million rows filter in hundredths of a second, a scheduler takes about one.
SHORTEST = 1_000_000
# ... and so many times as long as its overlap, which is filtered twice.
OVERLAPS = 50
BEYOND = ("raise", "warn")


class BeyondOverlap(UfirextError):
    """Rows are missing, and estimates of a part depend on rows before its overlap.

    Examples
    --------
    >>> import numpy as np
    >>> from ufirext import kinematic
    >>> from ufirext.distributed import BeyondOverlap, filter_series
    >>> zs = np.arange(4000.0)
    >>> zs[1990:2020] = np.nan
    >>> try:
    ...     filter_series(kinematic(1, 1, 1.0), zs, 10, chunks=2000).x.compute()
    ... except BeyondOverlap as error:
    ...     print("overlap=" in str(error))
    True
    """


class BeyondOverlapWarning(UserWarning):
    """Estimates of a part may differ from those of the whole series: rows are missing before them.

    Examples
    --------
    >>> import warnings
    >>> import numpy as np
    >>> from ufirext import kinematic
    >>> from ufirext.distributed import BeyondOverlapWarning, filter_series
    >>> zs = np.arange(4000.0)
    >>> zs[1990:2020] = np.nan
    >>> lazy = filter_series(kinematic(1, 1, 1.0), zs, 10, chunks=2000, beyond="warn")
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always", BeyondOverlapWarning)
    ...     x = lazy.x.compute(scheduler="synchronous")
    >>> BeyondOverlapWarning in {warning.category for warning in caught}
    True
    """


@dataclass(frozen=True)
class Task:
    """What is done with every part of a series; small, immutable and picklable."""

    model: Model
    horizon: int
    lag: int = 0
    missing: str = "extend"
    noise: tuple[Any, Any] | None = None
    window: str = "arrivals"
    longest_delay: int = 0
    overlap: int = 0
    beyond: str = "raise"

    @property
    def plan(self) -> SeriesPlan:
        """The plan that all parts share."""
        return series_plan(self.model, self.horizon, self.lag, self.noise)

    @property
    def limits(self) -> Limits:
        """How far windows with missing rows reach."""
        instants = (observability_index(self.model) or 1) + 2
        return Limits(self.horizon, instants, self.missing != "skip", self.window == "arrivals")

    @property
    def sufficient(self) -> int:
        """Overlap that is enough whatever is missing: a window of rows `reach` old that coasts as long."""
        need = self.horizon - 1 + self.lag + self.longest_delay
        return max(need, 2 * self.limits.reach - 1 + self.longest_delay) if self.limits.extends else need

    def run(self, z: Array, start: int, before: int, delays: Any = None, us: Array | None = None) -> Array:
        """Estimates (S, T, dim_x) of rows start .. start + T - 1, NaN where not ready.

        `z` (S, before + T, dim_z), `delays` (S, before + T) and `us` (S, before + T, dim_u) begin `before`
        rows earlier: as many as the overlap, or all there are.
        """
        if z.shape[1] == before:
            return np.empty((len(z), 0, self.model.dim_x))
        holes = np.array([_has_hole(one) for one in z], dtype=bool)
        if delays is not None or us is not None:
            x = self._filtered(z, delays, us)[:, before:]
        elif not holes.any():
            return self._aligned(z, start, before)
        else:
            x = np.empty((len(z), z.shape[1] - before, self.model.dim_x))
            if not holes.all():
                x[~holes] = self._aligned(z[~holes], start, before)
            x[holes] = self._filtered(z[holes], None, None)[:, before:]
        if start > before and holes.any() and self.limits.extends:
            late = None if delays is None else delays[holes]
            self._say_what_is_beyond(z[holes], x[holes], late, np.flatnonzero(holes), start, before)
        return x

    def _filtered(self, z: Array, delays: Any, us: Array | None) -> Array:
        options: dict[str, Any] = {"missing": self.missing, "noise": self.noise, "window": self.window}
        return filter_series(self.model, z, self.horizon, lag=self.lag, delays=delays, us=us, **options).x

    def _aligned(self, z: Array, start: int, before: int) -> Array:
        """Of series without holes: zeros in front put every row where it has its place in the whole series.

        Then the same products of the same shapes meet it, so that the bits are the same if parts begin and
        end at multiples of the plan's alignment. What the zeros spoil is not kept.
        """
        shift = (start - before) % self.plan.alignment
        if shift and before:
            zeros = np.zeros((len(z), shift, z.shape[2]), dtype=z.dtype)
            z = np.concatenate([zeros, z], axis=1)
        else:
            shift = 0
        return self._filtered(z, None, None)[:, shift + before :]

    # -- missing rows ----------------------------------------------------------------------------------------

    def _say_what_is_beyond(
        self, z: Array, x: Array, delays: Any, series: Any, start: int, before: int
    ) -> None:
        for place, number in enumerate(series.tolist()):
            arrived = ~np.isnan(z[place]).all(axis=1)
            ready = ~np.isnan(x[place]).any(axis=1)
            late = None if delays is None else delays[place]
            doubtful = np.flatnonzero(~self.settled(arrived, ready, before, late))
            if doubtful.size:
                message = (
                    f"rows {start + doubtful[0]} to {start + doubtful[-1]} of series {number} depend on "
                    f"measurements more than {self.overlap} rows before the part that begins at row {start}, "
                    f"because rows are missing there; overlap={self.sufficient} is enough for any gap"
                )
                if self.beyond == "raise":
                    raise BeyondOverlap(message)
                warnings.warn(message, BeyondOverlapWarning, stacklevel=2)

    def settled(
        self, arrived: NDArray[np.bool_], ready: NDArray[np.bool_], before: int, delays: Any = None
    ) -> NDArray[np.bool_]:
        """Which rows from `before` on no row ahead of the overlap can change.

        `arrived` (before + T,): steps with a measurement; `ready` (T,): rows of the result with an estimate.
        """
        limits, steps = self.limits, np.arange(len(arrived))
        newest = np.maximum.accumulate(np.where(arrived, steps, -1))[before:]
        fresh = arrived
        if delays is not None:  # rows of one origin are one instant
            origins = np.where(arrived, steps - delays, steps + len(steps) + int(delays.max(initial=0)))
            fresh = np.zeros(len(arrived), bool)
            fresh[np.unique(origins, return_index=True)[1]] = True
            fresh &= arrived
        count = np.concatenate([[0], np.cumsum(fresh)])
        wanted, last = min(limits.horizon, limits.instants), newest + 1
        within = count[last] - count[np.maximum(last - limits.horizon, 0)]
        enough = (within >= wanted) | (count[last] >= wanted) | (newest >= limits.reach - 1)
        lost = newest <= steps[before:] - limits.reach
        known = ready | (steps[before:] >= limits.reach - 1)
        return np.asarray(lost | ((newest >= limits.horizon - 1) & enough & known))


def _has_hole(z: Array) -> bool:
    """Whether a measurement is missing; the sum of squares is the quickest look."""
    if z.dtype.kind != "f":
        return False
    with np.errstate(over="ignore", invalid="ignore"):
        return not np.isfinite(np.vdot(z, z)) and bool(np.isnan(z).any())


def checked(
    model: Model, horizon: int | str, overlap: int | None, steps_apart: str = "overlap", **options: Any
) -> Task:
    """The task of these arguments; `overlap` None: horizon - 1 + lag + the largest delay."""
    if options["missing"] == "predict":
        raise UfirextError(
            'missing must be "extend" or "skip" for parts of a series, got "predict": that feeds the filter '
            "its own output, which remembers everything"
        )
    require_model(model)
    one_of(options["beyond"], BEYOND, "beyond")
    chosen = chosen_horizon(model, horizon)
    lag = lag_within(chosen, options["lag"])
    delay = integer(options["longest_delay"], "longest_delay", 0)
    least = chosen - 1 + lag + delay
    wide = (
        least if overlap is None else integer(overlap, steps_apart, least, advice="horizon - 1 + lag + delay")
    )
    return Task(model, chosen, overlap=wide, **{**options, "lag": lag, "longest_delay": delay})


def chunk_length(model: Model, horizon: int | str, *, lag: int = 0, overlap: int | None = None) -> int:
    """Rows of a part of a long series: long enough to pay, a multiple of the plan's alignment.

    At least a million rows, because a scheduler takes as long to hand out a part as such a part takes to
    filter; at least 50 overlaps, because those are filtered twice (2 % more work); a multiple of the
    alignment, because then the parts have the bits of the whole series.

    Parameters
    ----------
    model : Model
    horizon : int or "auto"
    lag : int, optional
    overlap : int, optional
        Rows before each part; default horizon - 1 + lag.

    Returns
    -------
    int

    Raises
    ------
    HorizonError, UnobservableWindow
        As `ufir_gain`; HorizonError also for an overlap that is no natural number.

    Examples
    --------
    >>> from ufirext import kinematic
    >>> from ufirext.distributed import chunk_length
    >>> chunk_length(kinematic(1, 1, 0.1), 300) >= 1_000_000
    True
    """
    plan = series_plan(model, horizon, lag)
    wide = plan.reach() if overlap is None else overlap
    return -(-max(SHORTEST, OVERLAPS * wide) // plan.alignment) * plan.alignment
