"""How the rows of a track lie in time: the nominal step, the grid, the gaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._arrays import Array
from .series import Mask, Track, UnusableTrack

__all__ = ["APART", "Timing", "age_in_steps", "pieces", "timing"]

_NEARLY = 0.05  # of a step: closer to the grid than this counts as on it
APART = 1e6  # steps: longer than any window
_FINE = 1000  # stamps off the grid are rounded to this part of a step


@dataclass(frozen=True)
class Timing:
    """The time axis of a track.

    Attributes
    ----------
    step : float
        Nominal step, s.
    regular : bool
        Whether the rows lie on a grid of that step (some of its points may be empty).
    steps : ndarray, (n,)
        Steps since the row before, 0 for the first; whole numbers on a grid, else multiples of 1/1000; not
        the true number where they are more than any window holds.
    """

    step: float
    regular: bool
    steps: Array


def timing(track: Track, longest: int = 64) -> Timing:
    """Nominal step and place of every row.

    Gaps longer than `longest` steps need not fit the grid, and neither need the breaks between segments:
    these count as longer than any window, however short they are.
    """
    spans = np.diff(track.seconds)
    across = np.zeros(len(spans), dtype=bool)
    across[track.breaks - 1] = True
    forward = spans[(spans > 0) & ~across]
    if not len(forward):
        forward = spans[spans > 0]
    if not len(forward):
        raise UnusableTrack(
            f"{track.path}: only one time stamp among its {len(track)} usable rows{_why(track)}"
        )
    median = float(f"{np.median(forward):.12g}")
    spans[across] = np.maximum(spans[across], APART * median)
    step = _step(spans, median, longest)
    steps = spans / step
    regular = _on_grid(spans, step, longest)
    if regular:
        # after a long gap the rows may lie on a grid of their own, which no window spans
        steps = np.where(_near(steps), np.rint(steps), APART)
    else:
        fine = np.rint(np.concatenate([[0.0], np.cumsum(np.minimum(steps, APART))]) * _FINE)
        steps = np.maximum(np.diff(fine), spans > 0) / _FINE
    return Timing(step, regular, np.concatenate([[0.0], steps]))


def _step(spans: Array, median: float, longest: int) -> float:
    """The median step, or what many steps together say, where they lie on its grid: stamps are rounded."""
    inner = spans[spans <= longest * median]
    whole = float(np.rint(inner / median).sum())
    finer = float(inner.sum()) / max(whole, 1.0)
    return finer if whole > 0 and _on_grid(spans, finer, longest) else median


def _on_grid(spans: Array, step: float, longest: int) -> bool:
    steps = spans / step
    distinct = (np.rint(steps) >= 1) | (spans == 0)
    return bool(np.all((_near(steps) | (steps > longest)) & distinct))


def _near(steps: Array) -> Mask:
    return np.asarray(np.abs(steps - np.rint(steps)) <= _NEARLY)


def _why(track: Track) -> str:
    if not track.left_out:
        return ""
    first = track.left_out[0]
    return f" ({len(track.left_out)} left out; the first, line {first.line}: {first.fault})"


def pieces(axis: Timing, horizon: int) -> list[slice]:
    """The stretches between gaps longer than `horizon` steps, or breaks; a filter starts afresh in each."""
    cuts = (1 + np.flatnonzero(axis.steps[1:] > horizon)).tolist()
    return [slice(start, stop) for start, stop in zip([0, *cuts], [*cuts, len(axis.steps)], strict=True)]


def age_in_steps(track: Track, axis: Timing) -> Array:
    """How many steps old each row was on arrival, (n,)."""
    if track.age is None:
        return np.zeros(len(track))
    return track.age if track.age_unit == "steps" else track.age / axis.step
