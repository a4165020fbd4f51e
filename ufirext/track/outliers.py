"""Rows far from where the filter expects them: pointed at, not removed."""

from __future__ import annotations

import numpy as np

from .run import Estimates
from .series import Track

__all__ = ["outliers"]

_APART = 8.0  # robust standard deviations; the noise of no receiver goes as far
_SCALE = 1.4826  # from the median of absolute values to the standard deviation, of normal noise
_NOTHING = 1e-6  # m; smaller innovations mean nothing


def outliers(track: Track, estimates: Estimates) -> list[str]:
    """A note of the rows whose innovation is larger than any noise explains, with the farthest one.

    A robust standard deviation, by the median absolute innovation, is not drawn along by those it is to find.
    """
    predicted = np.flatnonzero(estimates.predicted)
    if not len(predicted):
        return []
    sizes = np.abs(estimates.innovation[predicted])
    spread = np.maximum(_SCALE * np.median(sizes, axis=0), _NOTHING)
    apart = (sizes > _APART * spread).any(axis=1)
    if not apart.any():
        return []
    worst = int(np.argmax((sizes / spread).max(axis=1)))
    count = int(apart.sum())
    rows = "1 row lies" if count == 1 else f"{count:,} rows lie"
    line, farthest = track.lines[predicted[worst]], sizes[worst].max()
    limit = f"{_APART * spread.max():.3g} m"
    return [
        f"{rows} out of line: more than {_APART:g} robust standard deviations ({limit}) "
        f"from the prediction; the farthest, {track.counted} {line}, by {farthest:.3g} m. Filters follow "
        "outliers, and the rows after one suffer too: leave such rows out of the file, or put a gate in "
        "front of a filter (docs/horizon.md, Outliers)"
    ]
