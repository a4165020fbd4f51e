"""S0, Fig. 5: five and ten data lost on the way, with a delay of 3 steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ufirext import DelayKalmanFilter, UFIRFilter
from validation.claims import AtLeast, AtMost, Claim, Interval, Tolerance, sampling
from validation.drives import STEPS, constant_delay, scenes
from validation.figures import INK, ORANGE, PURPLE, new_figure
from validation.item import Item, Outcome, Table
from validation.linear import Recursion, recursion
from validation.papers import S0
from validation.s0.fig_4 import DELAY, LOOKS, THETA
from validation.s0.filters import MODEL, effective, kalman, robust
from validation.scores import ratio
from validation.study import Study
from validation.vehicle import HORIZON

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["ITEM", "LOST"]

Array = NDArray[np.float64]

LOST = (*range(615, 621), *range(665, 676))
FIRST, LAST = 540, 760
SPAN = slice(600, 720)
CORNER, SPEED, NEAR = 668, 10.0, 1.0
WAYS = {
    "left out": "UFIR, rows left out",
    "Hb F x": "UFIR, Hb F x^ in their place",
    "H F x": "UFIR, H F x^ in their place (as printed)",
}


def windowed(zs: Array, way: str) -> Array:
    """UFIR estimates (steps, 4) of one run with the lost data left out, or predicted in one of two ways."""
    f = UFIRFilter(4, 2, horizon=HORIZON)
    f.F, f.H, f.Q, f.R = MODEL.F, MODEL.H, MODEL.Q, MODEL.R
    believed = MODEL.H if way == "H F x" else effective(DELAY).H
    states = np.full((STEPS, 4), np.nan)
    for step in range(FIRST, LAST):
        f.predict()
        if step < FIRST + DELAY:
            continue
        if step not in LOST:
            f.update(zs[step], delay=DELAY)
        elif way == "left out":
            f.update(None)
        else:
            f.update(believed @ f.x_prior.ravel(), delay=DELAY)
        states[step] = f.x.ravel()
    return states


def filters() -> dict[str, Callable[[Array], Array]]:
    """Estimates by name. A predicted datum has no innovation: it moves neither KF nor H-infinity."""
    rows = list(LOST)

    def idle(tracker: Recursion) -> Recursion:
        K = tracker.K.copy()
        K[rows] = 0.0
        return replace(tracker, K=K)

    delays = [None if step < DELAY or step in LOST else DELAY for step in range(STEPS)]
    exact = recursion(DelayKalmanFilter(4, 2, max_delay=DELAY), MODEL, delays, effective(DELAY).H)
    named: dict[str, Callable[[Array], Array]] = {WAYS[way]: partial(_windows, way=way) for way in WAYS}
    return named | {
        "KF": idle(kalman(DELAY, "white")).track,
        "H∞": idle(robust(DELAY, THETA)).track,
        "exact KF": exact.track,
    }


def _windows(zs: Array, way: str) -> Array:
    return np.array([windowed(run, way) for run in zs])


def run(study: Study) -> Outcome:
    """Score the spans of the paper on drives, and a corner in the longer gap without noise."""
    scene = scenes(study, constant_delay(DELAY), study.choose(8, 100))
    tracked = {name: track(scene.zs) for name, track in filters().items()}
    errors = {name: (states[:, :, 0] - scene.truth[:, :, 0]) ** 2 for name, states in tracked.items()}
    during = {name: error[:, 615:700].mean(axis=1) for name, error in errors.items()}
    after = {name: error[:, 700:LAST].mean(axis=1) for name, error in errors.items()}
    transients = {name: _transient(track) for name, track in filters().items()}
    rows: list[tuple[str | float, ...]] = [
        (name, float(during[name].mean() ** 0.5), float(after[name].mean() ** 0.5), _words(transients[name]))
        for name in tracked
    ]
    shown = {name: states[0, :, 0] for name, states in tracked.items()}
    columns = ("filter", "615 to 700", "700 to 760", f"steps after the gap until below {NEAR:g} m")
    title = f"x-RMSE over {len(scene.truth)} runs, m, and a corner in the gap without noise"
    return Outcome(
        _claims(during, transients),
        [Table(title, columns, rows)],
        partial(draw, scene.truth[0, :, 0], scene.zs[0, :, 0], shown),
        [
            "The printed y = H F x^ puts a position of now in the place of one that is 3 s old: UFIR then "
            "runs ahead of itself, further with every lost datum. Hb F x^ works, and so does leaving the "
            "rows out, which keeps the memory finite.",
        ],
    )


def _transient(track: Callable[[Array], Array]) -> int | None:
    """Steps after the longer gap until a corner within it is forgotten; None: never."""
    east = SPEED * np.minimum(np.arange(STEPS), CORNER)
    truth = np.stack([east, np.zeros(STEPS)], axis=1)[None]
    zs = np.full_like(truth, np.nan)
    zs[:, DELAY:] = truth[:, :-DELAY]
    errors = np.abs(track(zs)[0, LOST[-1] + 1 : LAST, 0] - truth[0, LOST[-1] + 1 : LAST, 0])
    late = np.flatnonzero(errors > NEAR)
    return None if len(late) == len(errors) else int(late[-1]) + 1


def _words(steps: int | None) -> str:
    return "never" if steps is None else str(steps)


def _claims(during: dict[str, Array], transients: dict[str, int | None]) -> list[Claim]:
    left, working, printed = (WAYS[way] for way in ("left out", "Hb F x", "H F x"))
    scores = [ratio(during[working], during[name]) for name in ("KF", "H∞")]
    together = max(scores, key=lambda score: abs(np.log(score.value)))
    literal, out = ratio(during[printed], during[working]), ratio(during[left], during[working])
    fast, slow = transients[working], transients["KF"]
    wrong = "y = H F x^ is the datum of now, taken for one 3 steps old; with Hb F x^ the statement holds"
    ranges = "the printed range holds one more, both ends included"
    none, consistent = Tolerance(), Interval(0.8, 1.25, "act consistently")
    return [
        Claim("s0", ITEM.id, "data lost in 615 to 620", 5, 6, none, because=ranges, expected=6),
        Claim("s0", ITEM.id, "data lost in 665 to 675", 10, 11, none, because=ranges, expected=11),
        Claim("s0", ITEM.id, "error over 615 to 700, UFIR to the farther of KF and H-inf", consistent,
              together.value, sampling(2), together.error),
        Claim("s0", ITEM.id, "the same for UFIR with the printed y = H F x", consistent,
              literal.value, sampling(2), literal.error, wrong, AtLeast(10.0)),
        Claim("s0", ITEM.id, "error with the rows left out to Hb F x", consistent,
              out.value, sampling(2), out.error),
        Claim("s0", ITEM.id, "transient after the gap, UFIR to KF", AtMost(1.0, "shorter transients"),
              np.inf if fast is None or slow is None else fast / slow, none),
    ]  # fmt: skip


def draw(truth: Array, zs: Array, estimates: dict[str, Array]) -> Figure:
    """East against time around the two gaps."""
    figure = new_figure(10.0, 5.0)
    axes = figure.subplots()
    time = np.arange(STEPS)[SPAN]
    received = [step for step in time if step not in LOST]
    axes.plot(time, truth[SPAN], color=INK, lw=3, alpha=0.35, label="truth")
    axes.plot(received, zs[received], ".", color=INK, ms=3, alpha=0.7, label="received, 3 s late")
    looks = {WAYS["left out"]: LOOKS["UFIR"], WAYS["Hb F x"]: {"color": ORANGE, "ls": (0, (4, 1))}}
    for name in (*looks, "KF", "H∞"):
        axes.plot(time, estimates[name][SPAN], label=name, **(looks | LOOKS)[name])
    low, high = axes.get_ylim()
    printed = estimates[WAYS["H F x"]]
    axes.plot(time, printed[SPAN], color=PURPLE, ls=":", label=WAYS["H F x"])
    margin = 0.15 * (high - low)
    axes.set_ylim(low - margin, high + margin)
    for first, last in ((615, 620), (665, 675)):
        axes.axvspan(first, last, color=INK, alpha=0.1, lw=0)
    axes.set(xlabel="time, s", ylabel="east x, m", title="grey: nothing arrives")
    axes.legend(loc="upper left", bbox_to_anchor=(0.06, 1.0))
    return figure


ITEM = Item(
    id="s0-fig-5",
    paper=S0,
    title="Fig. 5: tracking in the east direction with temporarily missing data",
    run=run,
    claims=(
        "data lost in 615 to 620",
        "data lost in 665 to 675",
        "error over 615 to 700, UFIR to the farther of KF and H-inf",
        "the same for UFIR with the printed y = H F x",
        "error with the rows left out to Hb F x",
        "transient after the gap, UFIR to KF",
    ),
    parameters={"k": "3", "N": "5", "θ": "3.3e-4", "lost": "n = 615 to 620 and 665 to 675"},
    open_questions=["The track; whether the covariances of KF and H∞ go on as if the data had come."],
    assumptions=[
        "KF and H∞ take the prediction for a datum: no innovation, and gains as if it had come.",
        f"The transient is that of a corner at n = {CORNER}, within the longer gap, at {SPEED:g} m/s, "
        "without noise.",
    ],
)
