"""S2, Fig. 4: error against a wrong scale of the noise, beta, with gamma = 0.5."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from ufirext import ThetaTooLarge
from validation.claims import AtLeast, Claim, Interval, absolute, printed, sampling
from validation.drives import Scene
from validation.figures import INK, ORANGE, PURPLE, STYLES, new_figure
from validation.item import Item, Outcome, Table
from validation.papers import S2
from validation.s2.filters import drawn, expectation, kalman, robust, robust_squares, ufir
from validation.scores import Score, ratio, rmse, squares
from validation.study import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["ITEM"]

Array = NDArray[np.float64]

GAMMA = 0.5
THETA, OTHER_THETA = 0.86e-4, 1.86e-3
BETAS = np.geomspace(0.1, 10.0, 33)
NAMES = ("UFIR", "KF", "H∞ of the paper", "a-posteriori H∞", f"H∞ of the paper, θ = {OTHER_THETA:g}")


def at_beta(beta: float, scene: Scene) -> dict[str, Array]:
    """Mean squared errors of the runs, by filter."""
    found = (
        squares(ufir(GAMMA, beta).track(scene.zs), scene.truth),
        squares(kalman(GAMMA, beta).track(scene.zs), scene.truth),
        robust_squares(scene, GAMMA, THETA, beta),
        robust_squares(scene, GAMMA, THETA, beta, "posterior"),
        robust_squares(scene, GAMMA, OTHER_THETA, beta),
    )
    return dict(zip(NAMES, found, strict=True))


def crossings(over: Array) -> tuple[float, float]:
    """The betas where the error of a filter, over that of UFIR, falls below 1 and exceeds it again."""
    above, logs = np.log(over), np.log(BETAS)
    below = np.flatnonzero(above < 0.0)
    first, last = int(below[0]), int(below[-1])

    def between(i: int) -> float:
        share = above[i] / (above[i] - above[i + 1])
        return float(np.exp(logs[i] + share * (logs[i + 1] - logs[i])))

    return between(first - 1), between(last)


def edge(theta: float) -> float:
    """The beta at which the paper's H-infinity filter loses its stability."""

    def excess(log: float) -> float:
        try:
            return robust(GAMMA, theta, float(np.exp(log))).radius - 1.0
        except ThetaTooLarge:
            return 1e3

    return float(np.exp(brentq(excess, np.log(0.01), 0.0, rtol=1e-3)))


def run(study: Study) -> Outcome:
    """Sweep beta on the same runs."""
    scene = drawn(study, study.choose(8, 100), GAMMA)
    found = study.sweep(at_beta, BETAS.tolist(), scene)
    scores = {name: [rmse(one[name]) for one in found] for name in NAMES}
    ours = crossings(np.array([ratio(one["KF"], one["UFIR"]).value for one in found]))
    expected = np.array([expectation(kalman(GAMMA, beta), scene.truth, GAMMA).mean() for beta in BETAS])
    expected_ufir = float(expectation(ufir(GAMMA), scene.truth, GAMMA).mean())
    predicted = crossings(np.sqrt(expected / expected_ufir))
    claims = [
        *_about_errors(found, at_beta(1.0, scene)),
        *_about_crossings(ours, predicted, _jackknife(found)),
        *_about_divergence(),
    ]
    return Outcome(
        claims,
        [_table(scores, len(scene.truth)), _crossing_table(study, ours, predicted)],
        partial(draw, scores, ours),
        [
            "With θ = 1.86e-3, which the paper prints for Figs 2 and 3, its H∞ diverges just where it says, "
            "below β = 0.2; with the 0.86e-4 that is printed here it does not. One of the two may be a slip.",
        ],
    )


def _about_errors(found: list[dict[str, Array]], middle: dict[str, Array]) -> list[Claim]:
    at_one = ratio(middle["UFIR"], middle["KF"])
    growth = min(ratio(found[i]["KF"], middle["KF"]) for i in (0, -1))
    flat = [rmse(one["UFIR"]).value for one in found]
    less, grows = Interval(1.0, 1.1, "a bit less accurate"), AtLeast(1.2, "errors grow rapidly")
    item, change = ITEM.id, max(flat) - min(flat)
    return [
        Claim("s2", item, "UFIR to KF, beta = 1", less, at_one.value, sampling(2), at_one.error),
        Claim(
            "s2", item, "KF at beta = 0.1 or 10 to beta = 1", grows, growth.value, sampling(2), growth.error
        ),
        Claim("s2", item, "UFIR over all beta, change of its RMSE", 0.0, change, absolute(1e-9), unit="m"),
    ]


def _about_crossings(ours: tuple[float, float], predicted: tuple[float, float], errors: Array) -> list[Claim]:
    track = (
        "where the errors of KF and UFIR cross belongs to the track: a slow KF loses at corners; "
        "expected is the crossing of mean and covariance on our drives"
    )
    names = ("beta below which UFIR is better", "beta above which UFIR is better")
    allowed = printed(1) + sampling(2)
    return [
        Claim("s2", ITEM.id, name, reported, value, allowed, float(error), track, expected)
        for name, reported, value, error, expected in zip(
            names, (0.9, 2.2), ours, errors, predicted, strict=True
        )
    ]


def _about_divergence() -> list[Claim]:
    small = "with 0.86e-4 the gap between the limits is not reached before beta = 0.05"
    return [
        Claim("s2", ITEM.id, "beta below which H-inf diverges", 0.2, edge(THETA), printed(1), because=small,
              expected=Interval(0.03, 0.06)),
        Claim("s2", ITEM.id, "the same with theta = 1.86e-3", 0.2, edge(OTHER_THETA), printed(1)),
    ]  # fmt: skip


def _jackknife(found: list[dict[str, Array]]) -> Array:
    """Standard errors of the crossings."""
    count = len(found[0]["KF"])
    everyone = np.arange(count)
    left_out = []
    for i in everyone:
        runs = np.delete(everyone, i)
        left_out.append(
            crossings(np.array([ratio(one["KF"][runs], one["UFIR"][runs]).value for one in found]))
        )
    spread = np.array(left_out)
    return np.asarray(np.sqrt((count - 1) / count * ((spread - spread.mean(axis=0)) ** 2).sum(axis=0)))


def _crossing_table(study: Study, ours: tuple[float, float], expected: tuple[float, float]) -> Table:
    """Whether the data were sent with 0.5 or 0.8 is not said: both."""
    scene = drawn(study, study.choose(8, 100))
    U = squares(ufir(GAMMA).track(scene.zs), scene.truth)
    over = [ratio(squares(kalman(GAMMA, beta).track(scene.zs), scene.truth), U).value for beta in BETAS]
    rows = [
        ("paper", 0.9, 2.2),
        ("sent and assumed with γ = 0.5", *ours),
        ("the same, expected", *expected),
        ("sent with γ = 0.8", *crossings(np.array(over))),
    ]
    return Table(
        "UFIR errs less than the KF below the first β and above the second", ("", "first", "second"), rows
    )


def _table(scores: dict[str, list[Score]], runs: int) -> Table:
    shown = range(0, len(BETAS), 4)
    rows = [[f"{BETAS[i]:.3g}", *(str(row[i]) for row in scores.values())] for i in shown]
    return Table(f"y-RMSE, m, over {runs} runs (∞: diverges)", ("β", *scores), rows)


def draw(scores: dict[str, list[Score]], crossing: tuple[float, float]) -> Figure:
    """y-RMSE against beta."""
    figure = new_figure(8.5, 5.0)
    axes = figure.subplots()
    looks: tuple[dict[str, Any], ...] = (
        STYLES["UFIR"], STYLES["KF"], STYLES["H-inf"],
        {"color": PURPLE, "linestyle": ":"}, {"color": ORANGE, "linestyle": "-."},
    )  # fmt: skip
    for (name, row), look in zip(scores.items(), looks, strict=True):
        axes.plot(BETAS, [score.value for score in row], marker=".", label=name, **look)
    for beta in crossing:
        axes.axvline(beta, color=INK, lw=0.8, ls=":")
    axes.set(xlabel="β", ylabel="y-RMSE, m", xscale="log", ylim=(3.0, 20.0))
    axes.set_xticks([0.1, 0.2, 0.5, 1, 2, 5, 10], ["0.1", "0.2", "0.5", "1", "2", "5", "10"])
    axes.legend(title="dotted: UFIR and KF cross", loc="upper center")
    return figure


ITEM = Item(
    id="s2-fig-4",
    paper=S2,
    title="Fig. 4: effect of errors in the noise statistics, γ = 0.5",
    run=run,
    claims=(
        "UFIR to KF, beta = 1",
        "beta below which UFIR is better",
        "beta above which UFIR is better",
        "KF at beta = 0.1 or 10 to beta = 1",
        "UFIR over all beta, change of its RMSE",
        "beta below which H-inf diverges",
        "the same with theta = 1.86e-3",
    ),
    parameters={"γ": "0.5", "N": "5", "θ": "0.86e-4", "α": "1/β", "β": "0.1 to 10"},
    open_questions=[
        "Whether γ = 0.5 is that of the data, or assumed for data with 0.8.",
        "The track, and the page with the model.",
    ],
    assumptions=[
        "Data are sent with γ = 0.5, as assumed; the crossings for 0.8 are in the second table.",
        "The vehicle, Q and R of S0; simulated city drives; no losses.",
    ],
)
