"""UFIR against KF under outliers and manoeuvres."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ufirext import DelayKalmanFilter
from ufirext.demo.simulate import city_drive
from validation.beyond.wrong_noise import MODEL, adaptive, believed
from validation.claims import AtLeast, AtMost, Claim, Interval, Tolerance, sampling
from validation.drives import STEPS
from validation.figures import INK, ORANGE, PURPLE, STYLES, new_figure
from validation.item import Item, Outcome, Table
from validation.linear import Finite, Linear, recursion
from validation.papers import BEYOND
from validation.scores import ratio, rmse, squares
from validation.study import Study
from validation.vehicle import HORIZON, SIGMA_V

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["ITEM"]

Array = NDArray[np.float64]

SHARE, SIZE = 0.02, 50.0
"""Of the data that are outliers, and the standard deviation of their error in each axis, m."""
SCENES = ("calm", "outliers", "manoeuvres", "both")
UFIR, KF, SMOOTH, ADAPTIVE = "UFIR, N = 5", "KF", "KF, Q / 100", "UFIR, horizon='adaptive'"


def trackers() -> dict[str, Linear]:
    """The filters whose gains do not depend on the data."""
    return {
        UFIR: Finite.ufir(MODEL, HORIZON),
        KF: recursion(DelayKalmanFilter(4, 2), MODEL, [0] * STEPS),
        SMOOTH: recursion(DelayKalmanFilter(4, 2), believed(0.01), [0] * STEPS),
    }


def zigzag(rng: np.random.Generator) -> Array:
    """10 m/s all the time, and every 10 to 30 s a right angle at once: positions (STEPS, 2)."""
    turns = np.cumsum(rng.integers(10, 31, STEPS // 10))
    heading = np.full(STEPS, rng.uniform(0.0, 2.0 * np.pi))
    for turn in turns[turns < STEPS]:
        heading[turn:] += rng.choice([-0.5, 0.5]) * np.pi
    return np.asarray(np.cumsum(10.0 * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0))


def draw_run(rng: np.random.Generator) -> dict[str, tuple[Array, Array]]:
    """Truth and measurements by scene: the same noise and outliers in all."""
    tracks = city_drive(rng).position, zigzag(rng)
    noise = SIGMA_V * rng.standard_normal((STEPS, 2))
    struck = (rng.random(STEPS) < SHARE)[:, None] * SIZE * rng.standard_normal((STEPS, 2))
    found = {}
    for name, track, added in zip(
        SCENES, np.repeat(tracks, 2, axis=0).reshape(4, STEPS, 2), (0, 1, 0, 1), strict=True
    ):
        found[name] = (track, track + noise + added * struck)
    return found


def run(study: Study) -> Outcome:
    """Score the filters in every scene, and follow a single outlier."""
    runs = study.runs(draw_run, study.choose(6, 100))
    found: dict[str, dict[str, Array]] = {}
    for scene in SCENES:
        truth, zs = (np.stack([run[scene][part] for run in runs]) for part in (0, 1))
        found[scene] = {name: squares(t.track(zs), truth, axis=None) for name, t in trackers().items()}
        states = np.array(study.sweep(adaptive, list(zs), MODEL))
        found[scene][ADAPTIVE] = squares(states, truth, axis=None)
    names = (*trackers(), ADAPTIVE)
    rows = [[name, *(str(rmse(found[scene][name])) for scene in SCENES)] for name in names]
    title = f"RMSE of the position, m, over {len(runs)} runs"
    responses = {name: response(tracker) for name, tracker in trackers().items()}
    return Outcome(
        [*_about_memory(responses), *_about_scenes(found)],
        [Table(title, ("filter", *SCENES), rows)],
        partial(draw, responses, found),
        [
            "No linear filter is robust against outliers while they last: each passes on its share of them. "
            "What finite memory gives is that after N steps nothing is left, and that a wrong Q cannot make "
            "it slow. The KF with Q / 100 is the one that outliers hurt least, and corners most.",
        ],
    )


def response(tracker: Linear) -> Array:
    """Error of the position after a single outlier of 50 m, from the outlier on."""
    zs = np.zeros((1, STEPS, 2))
    at = STEPS // 2
    zs[0, at, 1] = SIZE
    return np.asarray(tracker.track(zs)[0, at : at + 30, 2])


def _about_memory(responses: dict[str, Array]) -> list[Claim]:
    left = np.abs(responses[KF][HORIZON:]).max() / np.abs(responses[KF]).max()
    last = int(np.flatnonzero(np.abs(responses[UFIR]) > 1e-9 * SIZE)[-1]) + 1
    none = Tolerance()
    return [
        Claim("beyond", ITEM.id, "steps until UFIR has forgotten an outlier", HORIZON, last, none,
              unit="steps"),
        Claim("beyond", ITEM.id, "share of an outlier that the KF keeps after N steps",
              AtLeast(0.01, "an infinite memory"), float(left), none),
    ]  # fmt: skip


def _about_scenes(found: dict[str, dict[str, Array]]) -> list[Claim]:
    robust, optimum = AtMost(1.0, "UFIR is more robust"), AtMost(1.0, "the KF is the optimum")
    right = (
        "a KF whose Q and R suit the track has less noise gain than a window, for outliers as for noise, and "
        "is as fast; finite memory is robust against a wrong Q, not against outliers"
    )
    near = Interval(0.8, 1.1, "told nothing, not far from N = 5")
    claims = [_claim("calm: KF to UFIR", optimum, found["calm"], KF, UFIR)]
    for scene in SCENES[1:]:
        scores = found[scene]
        claims += [
            _claim(f"{scene}: UFIR to KF", robust, scores, UFIR, KF, right, Interval(1.0, 1.1)),
            _claim(f"{scene}: UFIR to KF with Q / 100", robust, scores, UFIR, SMOOTH),
            _claim(f"{scene}: UFIR adaptive to N = 5", near, scores, ADAPTIVE, UFIR),
        ]
    return claims


def _claim(
    name: str, reported: Interval, scores: dict[str, Array], one: str, other: str, because: str = "",
    expected: Interval | None = None,
) -> Claim:  # fmt: skip
    score = ratio(scores[one], scores[other])
    return Claim("beyond", ITEM.id, name, reported, score.value, sampling(2), score.error, because, expected)


def draw(responses: dict[str, Array], found: dict[str, dict[str, Array]]) -> Figure:
    """What is left of an outlier, and the errors by scene."""
    figure = new_figure(10.0, 4.5)
    left, right = figure.subplots(1, 2)
    looks: dict[str, Any] = {
        UFIR: STYLES["UFIR"],
        KF: STYLES["KF"],
        SMOOTH: {"color": ORANGE, "linestyle": "-."},
        ADAPTIVE: {"color": PURPLE, "linestyle": ":"},
    }
    for name, error in responses.items():
        left.plot(error, marker=".", label=name, **looks[name])
    left.axvline(HORIZON, color=INK, lw=0.8, ls=":")
    left.set(xlabel="steps after an outlier of 50 m (dotted: N)", ylabel="error of the position, m")
    for place, (name, look) in enumerate(looks.items()):
        values = [rmse(found[scene][name]) for scene in SCENES]
        at = np.arange(len(SCENES)) + 0.2 * (place - 1.5)
        right.bar(
            at,
            [v.value for v in values],
            0.18,
            yerr=[v.error for v in values],
            color=look["color"],
            label=name,
        )
    right.set_xticks(range(len(SCENES)), SCENES)
    right.set(ylabel="RMSE of the position, m")
    right.grid(axis="x", visible=False)
    right.legend()
    return figure


ITEM = Item(
    id="beyond-outliers",
    paper=BEYOND,
    title="UFIR against KF under outliers and manoeuvres",
    run=run,
    claims=(
        "steps until UFIR has forgotten an outlier",
        "share of an outlier that the KF keeps after N steps",
        "calm: KF to UFIR",
        *(
            f"{scene}: {what}"
            for scene in SCENES[1:]
            for what in ("UFIR to KF", "UFIR to KF with Q / 100", "UFIR adaptive to N = 5")
        ),
    ),
    parameters={
        "model": "vehicle, Q and R of S0",
        "outliers": f"{100 * SHARE:g} % of the data, {SIZE:g} m in each axis",
        "manoeuvres": "10 m/s, a right angle at once every 10 to 30 s",
    },
    assumptions=["White noise of 3.75 m in each axis; no gate against outliers in any filter."],
)
