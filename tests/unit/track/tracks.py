"""Small tracks for the tests, as files and as values."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from ufirext.track.series import Track


def write_table(path: Path, columns: Mapping[str, Sequence[object]], separator: str = ",") -> Path:
    """A table of text with one named column for each item."""
    rows = zip(*columns.values(), strict=True)
    lines = [separator.join(columns), *(separator.join(map(str, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def straight(seconds: np.ndarray) -> np.ndarray:
    """A straight drive at constant velocity."""
    return np.column_stack([100.0 + 3.0 * seconds, -40.0 - 1.5 * seconds])


def bend(seconds: np.ndarray) -> np.ndarray:
    """A smooth bend."""
    return np.column_stack([200 * np.sin(seconds / 25), 150 * np.cos(seconds / 40)])


def noisy(rng: np.random.Generator, seconds: np.ndarray, sigma: float, path: Callable = bend) -> np.ndarray:
    """A path with white noise."""
    return path(seconds) + sigma * rng.standard_normal((len(seconds), 2))


def recorded(seconds: np.ndarray, position: np.ndarray, **more: object) -> Track:
    """A track as if it had been read."""
    lines = np.arange(2, len(seconds) + 2)
    return Track(
        Path("a.csv"), np.asarray(seconds, float), np.asarray(position, float), ("x", "y"), lines, **more
    )
