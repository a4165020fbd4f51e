"""UFIR and KF on recorded tracks: as recorded, against a reference, and with seeded noise."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ufirext import DelayKalmanFilter, UFIRFilter, kinematic
from ufirext.track.reading import read_track
from validation.claims import AtLeast, AtMost, Claim, Interval, Tolerance, sampling
from validation.figures import BLUE, INK, ORANGE, RED, SKY, new_figure
from validation.item import Item, Outcome, Table, recorded_tracks
from validation.papers import BEYOND
from validation.scores import Score
from validation.study import Study
from validation.vehicle import SIGMA_V

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["ITEM"]

Array = NDArray[np.float64]

FILES = {
    "Berlin": "car_berlin_potsdamer_ublox_truth_5hz.csv",
    "California": "car_california_comma2k19_ublox_truth_10hz.csv",
    "Chemnitz": "car_chemnitz_truthonly_1hz.csv",
    "Dresden": "car_dresden_balzer_10hz.csv",
    "Edge 605": "bike_hampshire_edge605_1hz.csv",
    "Moto G3": "bike_hampshire_motog3_gaps.csv",
}
REFERENCED = ("Berlin", "California")
UNREFERENCED = ("Dresden", "Edge 605", "Moto G3")
DENSITIES = (0.1, 1.0, 10.0, 100.0)
"""Of the KF's process noise, m^2/s^3; the best is found by looking at the truth."""
START = 20
RAW, UFIR, BEST, LOW, HIGH = "raw", "UFIR, horizon='adaptive'", "KF, best Q", "KF, Q / 100", "KF, Q × 100"


class Recorded(NamedTuple):
    """A stretch of a track.

    Attributes
    ----------
    seconds : ndarray, (n,)
    position : ndarray, (n, 2)
        As recorded, m.
    truth : ndarray, (n, 2) or None
        The reference, where there is one.
    """

    seconds: Array
    position: Array
    truth: Array | None

    @property
    def reference(self) -> Array:
        """The best that is known of where the vehicle was."""
        return self.position if self.truth is None else self.truth


def stretch(path: Path, longest: int) -> Recorded:
    """The rows without a long gap, `longest` at most, over which the vehicle went farthest."""
    track = read_track(path)
    steps = np.diff(track.seconds)
    gaps = np.concatenate([[0], np.cumsum(steps > 5.0 * np.median(steps))])
    truth = track.position if track.truth is None else track.truth
    usable = np.isfinite(truth.sum(axis=1))
    way = np.concatenate([[0.0], np.cumsum(np.nan_to_num(np.linalg.norm(np.diff(truth, axis=0), axis=1)))])
    best, rows = -1.0, slice(0, 0)
    for first in range(0, len(way) - 100, 10):
        last = min(first + longest, int(np.searchsorted(gaps, gaps[first], side="right")))
        if last - first >= 100 and usable[first:last].all() and way[last - 1] - way[first] > best:
            best, rows = way[last - 1] - way[first], slice(first, last)
    position = track.position[rows]
    return Recorded(track.seconds[rows], position, None if track.truth is None else track.truth[rows])


def track_with(f: Any, seconds: Array, zs: Array, q: float, r: float) -> Array:
    """Positions (n, 2) by a filter whose F and Q follow the steps' lengths."""
    steps = np.diff(seconds, prepend=2.0 * seconds[0] - seconds[1]).round(3)
    positions = np.empty_like(zs)
    dt = None
    for i, (step, z) in enumerate(zip(steps.tolist(), zs, strict=True)):
        if step != dt:
            dt, model = step, kinematic(1, 2, step, q=q, r=r)
            f.F, f.Q, f.H, f.R = model.F, model.Q, model.H, model.R
        if i == 0:
            f.x = np.array([z[0], 0.0, z[1], 0.0])
        f.predict()
        f.update(z)
        positions[i] = f.x.ravel()[::2]
    return positions


def kalman(seconds: Array, zs: Array, q: float, r: float) -> Array:
    """The KF, at rest at the first row."""
    f = DelayKalmanFilter(4, 2)
    f.P = np.diag([r, 100.0, r, 100.0])
    return track_with(f, seconds, zs, q, r)


def ufir(seconds: Array, zs: Array, q: float, r: float) -> Array:
    """UFIR that finds its horizon in the data."""
    return track_with(UFIRFilter(4, 2, horizon="adaptive"), seconds, zs, q, r)


def rms(positions: Array, truth: Array) -> float:
    """Root-mean-square distance after the start, m."""
    return float(np.sqrt(((positions - truth)[START:] ** 2).sum(axis=1).mean()))


def contenders(track: Recorded, zs: Array) -> dict[str, float]:
    """Errors of all filters on one set of measurements, m."""
    r = float(((zs - track.reference) ** 2).mean())

    def error(filtered: Callable[[Array, Array, float, float], Array], q: float) -> float:
        return rms(filtered(track.seconds, zs, q, r), track.reference)

    by_density = {q: error(kalman, q) for q in DENSITIES}
    q = min(by_density, key=lambda density: by_density[density])
    return {
        RAW: rms(zs, track.reference),
        UFIR: error(ufir, q),
        BEST: by_density[q],
        LOW: error(kalman, q / 100.0),
        HIGH: error(kalman, q * 100.0),
    }


def noisy(rng: np.random.Generator, tracks: dict[str, Recorded]) -> dict[str, dict[str, float]]:
    """Every track with white noise on its reference."""
    return {
        name: contenders(track, track.reference + SIGMA_V * rng.standard_normal(track.reference.shape))
        for name, track in tracks.items()
    }


def run(study: Study) -> Outcome:
    """Read the tracks, filter them as they are, and with noise."""
    folder = recorded_tracks()
    longest = study.choose(300, 1500)
    tracks = {name: stretch(folder / file, longest) for name, file in FILES.items()}
    raw = {name: contenders(tracks[name], tracks[name].position) for name in REFERENCED}
    runs = study.runs(noisy, study.choose(3, 20), tracks)
    seeded = {name: {f: np.array([one[name][f] for one in runs]) for f in runs[0][name]} for name in tracks}
    moved = {name: _moved(tracks[name]) for name in UNREFERENCED}
    return Outcome(
        [*_about_raw(raw, moved), *_about_seeded(seeded)],
        [_raw_table(raw, moved), _seeded_table(seeded, tracks)],
        partial(draw, seeded, raw),
        [
            "The errors of a receiver are correlated over many steps: to a filter for white noise they look "
            "like motion, and there is little to gain. What matters on raw tracks is to do no harm.",
            "Where a file has no reference, the track as recorded is taken for the truth of the seeded runs.",
        ],
    )


def _moved(track: Recorded) -> float:
    """How far UFIR moves the recorded positions, root mean square, m."""
    return rms(ufir(track.seconds, track.position, 1.0, 1.0), track.position)


def _about_raw(raw: dict[str, dict[str, float]], moved: dict[str, float]) -> list[Claim]:
    none, harmless = Tolerance(), AtMost(1.05, "does no harm")
    claims = []
    for name, errors in raw.items():
        little = Interval(0.7, 1.0, "little to gain")
        best = min(errors[BEST], errors[UFIR], errors[RAW]) / errors[RAW]
        claims += [
            Claim("beyond", ITEM.id, f"{name}, raw: UFIR to raw", harmless, errors[UFIR] / errors[RAW], none),
            Claim("beyond", ITEM.id, f"{name}, raw: the better of UFIR and KF to raw", little, best, none),
        ]
    still = AtMost(1.0, "does no harm")
    claims += [
        Claim("beyond", ITEM.id, f"{name}, raw: UFIR moves it by", still, value, none, unit="m")
        for name, value in moved.items()
    ]
    return claims


def _about_seeded(seeded: dict[str, dict[str, Array]]) -> list[Claim]:
    gain, near = AtMost(0.95, "better than raw"), AtMost(1.15, "told nothing, close to the best KF")
    robust = AtLeast(1.0, "UFIR is more robust")
    claims = []
    for name, errors in seeded.items():
        wrong = LOW if errors[LOW].mean() > errors[HIGH].mean() else HIGH
        claims += [
            _claim(f"{name}, noise: UFIR to raw", gain, errors[UFIR], errors[RAW]),
            _claim(f"{name}, noise: UFIR to best KF", near, errors[UFIR], errors[BEST]),
            _claim(f"{name}, noise: KF with Q wrong by 100 to UFIR", robust, errors[wrong], errors[UFIR]),
        ]
    return claims


def _claim(name: str, reported: Interval, one: Array, other: Array) -> Claim:
    """The mean ratio of two errors over the runs."""
    ratios = one / other
    error = float(ratios.std(ddof=1)) / len(ratios) ** 0.5
    return Claim("beyond", ITEM.id, name, reported, float(ratios.mean()), sampling(2), error)


def _raw_table(raw: dict[str, dict[str, float]], moved: dict[str, float]) -> Table:
    names = (RAW, UFIR, BEST, LOW, HIGH)
    rows: list[list[str | float]] = [[name, *(errors[f] for f in names)] for name, errors in raw.items()]
    rows += [[f"{name}, no reference: moved by", "", value, "", "", ""] for name, value in moved.items()]
    return Table("As recorded: RMS distance to the reference, m", ("track", *names), rows)


def _seeded_table(seeded: dict[str, dict[str, Array]], tracks: dict[str, Recorded]) -> Table:
    names = (RAW, UFIR, BEST, LOW, HIGH)
    rows: list[list[str | float]] = []
    for name, errors in seeded.items():
        seconds = tracks[name].seconds
        rate = f"{len(seconds)} rows, {np.median(np.diff(seconds)):.2g} s"
        rows.append([name, rate, *(_mean(errors[f]) for f in names)])
    return Table(
        "With white noise of 3.75 m in each axis: RMS distance, m, ± standard error",
        ("track", "", *names),
        rows,
    )


def _mean(values: Array) -> str:
    error = float(values.std(ddof=1)) / len(values) ** 0.5
    return str(Score(float(values.mean()), error, 0.0))


def draw(seeded: dict[str, dict[str, Array]], raw: dict[str, dict[str, float]]) -> Figure:
    """Errors in units of the raw ones."""
    figure = new_figure(10.0, 4.5)
    axes = figure.subplots()
    looks = {UFIR: BLUE, BEST: RED, LOW: ORANGE, HIGH: SKY}
    labels = [f"{name}\nas recorded" for name in raw] + [f"{name}\n+ noise" for name in seeded]
    at = np.arange(len(labels))
    for place, (name, colour) in enumerate(looks.items()):
        values = [errors[name] / errors[RAW] for errors in raw.values()]
        values += [float(errors[name].mean() / errors[RAW].mean()) for errors in seeded.values()]
        axes.bar(at + 0.2 * (place - 1.5), values, 0.18, color=colour, label=name)
    axes.axhline(1.0, color=INK, lw=0.8, ls=":")
    axes.set_xticks(at, labels, fontsize=8)
    axes.set(ylabel="RMS distance / that of the measurements", ylim=(0.0, 3.4))
    axes.grid(axis="x", visible=False)
    axes.legend(ncols=2)
    return figure


ITEM = Item(
    id="beyond-real-tracks",
    paper=BEYOND,
    title="UFIR and KF on real tracks",
    run=run,
    claims=(
        *(
            f"{name}, raw: {what}"
            for name in REFERENCED
            for what in ("UFIR to raw", "the better of UFIR and KF to raw")
        ),
        *(f"{name}, raw: UFIR moves it by" for name in UNREFERENCED),
        *(
            f"{name}, noise: {what}"
            for name in FILES
            for what in ("UFIR to raw", "UFIR to best KF", "KF with Q wrong by 100 to UFIR")
        ),
    ),
    parameters={"model": "constant velocity, steps as recorded", "noise": "3.75 m in each axis, seeded"},
    assumptions=[
        "Of each track the rows without a long gap over which the vehicle went farthest.",
        "The KF has the best of four densities of process noise, found by looking at the truth; R is true.",
    ],
)
