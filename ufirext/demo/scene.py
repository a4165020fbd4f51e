"""What the demo looks at: a simulated city drive, or a recorded track, as trials to be drawn."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from .._arrays import Array
from ..errors import UfirextError
from .compare import DENSITIES, Trial, models, tuned_density
from .simulate import Drive, city_drive

__all__ = ["LONGEST", "Scene", "city", "recorded"]

LONGEST = 2000
"""Steps of a recorded track that are used: enough for the table, and a run stays a matter of minutes."""


@dataclass(frozen=True)
class Scene:
    """Where the trials come from.

    Attributes
    ----------
    title : str
    notes : list of str
        What a reader of the table ought to know.
    trial : callable
        Draws one Trial from a generator.
    runs : int
        How many trials a minute or two allows.
    """

    title: str
    notes: list[str]
    trial: Callable[[np.random.Generator], Trial]
    runs: int = 20


def city(rng: np.random.Generator, noise: float) -> Scene:
    """Another drive through another city in every trial, measured with white noise (std, m, per axis)."""

    def trial(rng: np.random.Generator, q: float) -> Trial:
        drive = city_drive(rng)
        return _noisy(rng, drive, noise, q)

    q = _best_q(trial, rng)
    notes = [
        "Truth: simulated, 858 points at 1 Hz; blocks, right-angled turns, red lights; new in every run.",
        f"Measurements: truth plus white noise of {noise:g} m per axis.",
        _about_q(q, noise),
    ]
    return Scene("A drive through a city", notes, lambda rng: trial(rng, q))


def recorded(path: Path, rng: np.random.Generator, noise: float) -> Scene:
    """A recorded track: measured against its own truth columns, or taken as truth itself, with noise added.

    Raises
    ------
    UnusableTrack
        When no track can be read from the file.
    UfirextError
        When fewer than 100 rows in a row are without a gap.
    """
    from ..track.reading import read_track

    track = read_track(path)
    notes = list(track.notes)
    rows = np.arange(len(track))
    if track.age is not None:
        rows = rows[track.age == 0]
        notes.append("Rows that were late in the file are left out: the demo makes delays of its own.")
    rows = rows[_stretch(track.seconds[rows])]
    notes.append(
        f"{len(rows)} of {track.rows_read} rows are used: the longest without a gap, at most {LONGEST}."
    )
    seconds = track.seconds[rows] - track.seconds[rows[0]]
    if track.truth is not None:
        notes.append("Truth: the file's own columns; measurements: as recorded, only the link is simulated.")
        notes.append(
            "A receiver's own errors are correlated in time: no filter for white noise gains much on them."
        )
        drive = Drive(seconds, track.truth[rows])
        measured = track.position[rows]
        noise = float(np.sqrt(np.nanmean((measured - drive.position) ** 2)))

        def trial(rng: np.random.Generator, q: float) -> Trial:
            return Trial(drive, measured, models(seconds, q, noise**2))
    else:
        notes.append(
            f"The file has no truth: the recorded track is taken as truth, "
            f"white noise of {noise:g} m is added."
        )
        drive = Drive(seconds, track.position[rows])

        def trial(rng: np.random.Generator, q: float) -> Trial:
            return _noisy(rng, drive, noise, q)

    q = _best_q(trial, rng)
    return Scene(path.name, [*notes, _about_q(q, noise)], lambda rng: trial(rng, q), _affordable(seconds))


def _affordable(seconds: Array) -> int:
    """As many runs as cost what 20 city drives do; models that change at every step cost 5 times more."""
    irregular = len(np.unique(np.diff(seconds).round(6))) > 1
    return int(np.clip(17_000 // (len(seconds) * (5 if irregular else 1)), 3, 20))


def _noisy(rng: np.random.Generator, drive: Drive, noise: float, q: float) -> Trial:
    measured: Array = drive.position + noise * rng.standard_normal(drive.position.shape)
    return Trial(drive, measured, models(drive.seconds, q, noise**2))


def _best_q(trial: Callable[[np.random.Generator, float], Trial], rng: np.random.Generator) -> float:
    """Tuned on one drive, the same for every q."""
    seed = int(rng.integers(2**32))
    return tuned_density(lambda q: trial(np.random.default_rng(seed), q))


def _about_q(q: float, noise: float) -> str:
    found = (
        f"Right R: ({noise:.3g} m)^2. Right Q: the one with which the Kalman filter errs least on "
        f"the true track (density {q:.3g} m^2/s^3), found by "
        "looking at the truth, as nobody can outside a simulation."
    )
    if any(math.isclose(q, edge) for edge in DENSITIES):
        way = "less" if math.isclose(q, DENSITIES[0]) else "more"
        found += f" The search ended there, at its edge: {way} may be better still."
    return found


def _stretch(seconds: Array) -> slice:
    """The longest run of rows without a gap above five usual steps, LONGEST rows at most."""
    steps = np.diff(seconds)
    cuts = np.flatnonzero(steps > 5 * np.median(steps)) + 1 if len(steps) else np.array([], dtype=int)
    edges = [0, *cuts.tolist(), len(seconds)]
    size, first = max((b - a, -a) for a, b in pairwise(edges))
    if size < 100:
        raise UfirextError(f"the longest stretch without a gap has {size} rows; the demo needs 100")
    return slice(-first, -first + min(size, LONGEST))
