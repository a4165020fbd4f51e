"""UFIR against KF when Q and R are wrong by 10 and 100."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ufirext import DelayKalmanFilter, Model, TimeStamped, UFIRFilter, best_horizon
from validation.claims import AtMost, Claim, Interval, Tolerance, absolute, sampling
from validation.drives import STEPS, Scene, scenes
from validation.figures import INK, PURPLE, SKY, STYLES, new_figure
from validation.item import Item, Outcome, Table
from validation.linear import Finite, recursion
from validation.papers import BEYOND
from validation.scores import Score, ratio, rmse, squares
from validation.study import Study
from validation.vehicle import HORIZON, vehicle

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["ITEM", "adaptive"]

Array = NDArray[np.float64]

MODEL = vehicle()
FACTORS = (1e-2, 1e-1, 1.0, 10.0, 100.0)
FIXED, AUTO, KALMAN = "UFIR, N = 5", "UFIR, horizon='auto'", "KF"
NEVER_TOLD = "UFIR, horizon='adaptive'"


def believed(q: float, r: float = 1.0) -> Model:
    """The model with Q and R multiplied."""
    return Model(MODEL.F, MODEL.H, q * MODEL.Q, r * MODEL.R, dt=1.0)


def trackers(model: Model) -> dict[str, Any]:
    """What each filter makes of a belief."""
    return {
        KALMAN: recursion(DelayKalmanFilter(4, 2), model, [0] * STEPS),
        FIXED: Finite.ufir(model, HORIZON),
        AUTO: Finite.ufir(model, best_horizon(model)),
    }


def adaptive(zs: Array, model: Model) -> Array:
    """States (steps, 4) of one run by the filter that chooses its horizon from the data, without Q."""
    f = UFIRFilter(4, 2, horizon="adaptive")
    f.F, f.H, f.R = model.F, model.H, model.R
    states = np.empty((len(zs), 4))
    for step, z in enumerate(zs):
        f.predict()
        f.update(z)
        states[step] = f.x.ravel()
    return states


def at_factor(factor: float, scene: Scene) -> dict[str, Array]:
    """Mean squared errors of the runs with Q multiplied by `factor`."""
    found = trackers(believed(factor))
    return {name: squares(tracker.track(scene.zs), scene.truth) for name, tracker in found.items()}


def run(study: Study) -> Outcome:
    """Score every filter at every factor on the same runs."""
    scene = scenes(study, TimeStamped(0), study.choose(12, 200))
    found = dict(zip(FACTORS, study.sweep(at_factor, FACTORS, scene), strict=True))
    states = study.sweep(adaptive, list(scene.zs), believed(1.0, 100.0))
    told_nothing = squares(np.array(states), scene.truth)
    horizons = {factor: best_horizon(believed(factor)) for factor in FACTORS}
    return Outcome(
        [*_about_factors(found), *_about_adaptive(found, told_nothing), *_about_ratios()],
        [_table(found, told_nothing, horizons)],
        partial(draw, found, rmse(told_nothing)),
        [
            "A KF depends on the ratio of Q and R only: R too large by 10 is Q too small by 10. UFIR with a "
            "given N is never told either; with horizon='auto' it takes N from them and inherits the error: "
            "where Q is too small N is too long, and it is no better than the KF. With horizon='adaptive' it "
            "asks the data, and errs as little as with the best N.",
            "What the comparison does not show: N = 5 suits this car, and somebody had to know.",
        ],
    )


def _about_factors(found: dict[float, dict[str, Array]]) -> list[Claim]:
    """The KF is the optimum where it is told the truth; UFIR is better where it is told wrong."""
    best = ratio(found[1.0][KALMAN], found[1.0][FIXED])
    claims = [
        Claim("beyond", ITEM.id, "right Q and R: KF to UFIR", AtMost(1.0, "the KF is the optimum"),
              best.value, sampling(2), best.error)
    ]  # fmt: skip
    for factor in FACTORS:
        if factor == 1.0:
            continue
        for name, label in ((FIXED, "UFIR"), (AUTO, "UFIR auto")):
            score = ratio(found[factor][name], found[factor][KALMAN])
            robust = AtMost(1.0, "UFIR is more robust")
            claims.append(
                Claim("beyond", ITEM.id, f"Q x {factor:g}: {label} to KF", robust, score.value, sampling(2),
                      score.error, *EXCEPTIONS.get((factor, name), ("", None)))
            )  # fmt: skip
    return claims


INHERITED = (
    "horizon='auto' takes N from the same wrong Q: 9 and 15 steps round off the corners as the KF does with "
    "it; a fixed or adaptive horizon does not"
)
EXCEPTIONS = {(factor, AUTO): (INHERITED, Interval(1.0, 1.1)) for factor in (0.01, 0.1)}


def _about_adaptive(found: dict[float, dict[str, Array]], told_nothing: Array) -> list[Claim]:
    loss = ratio(told_nothing, found[1.0][FIXED])
    small = AtMost(1.05, "close to the best fixed horizon")
    return [
        Claim(
            "beyond",
            ITEM.id,
            "UFIR adaptive, no Q, R x 100, to N = 5",
            small,
            loss.value,
            sampling(2),
            loss.error,
        )
    ]


def _about_ratios() -> list[Claim]:
    """What can be said without drawing anything: gains are the same, or horizons."""
    one, other = (
        recursion(DelayKalmanFilter(4, 2), model, [0] * STEPS) for model in (believed(0.1), believed(1, 10))
    )
    same = float(np.abs(one.K[-1] - other.K[-1]).max())
    stretch = best_horizon(believed(1e-4)) / best_horizon(believed(1.0))
    return [
        Claim("beyond", ITEM.id, "R x 10 is Q / 10: change of the KF's gain", 0.0, same, absolute(1e-9)),
        # N = sqrt(12 sigma_v / (tau sigma_w)): sigma_w / 100 makes it 10 times as long, up to rounding of N.
        Claim(
            "beyond", ITEM.id, "Q x 1e-4: horizon auto, times longer", 10.0, stretch, Tolerance(relative=0.1)
        ),
    ]


def _table(found: dict[float, dict[str, Array]], adaptive: Array, horizons: dict[float, int]) -> Table:
    rows: list[list[str | float]] = [
        [name, *(str(rmse(found[factor][name])) for factor in FACTORS)] for name in (KALMAN, FIXED, AUTO)
    ]
    rows.append(["its N", *(str(horizons[factor]) for factor in FACTORS)])
    rows.append([NEVER_TOLD, *[str(rmse(adaptive))] * len(FACTORS)])
    columns = ("filter", *(f"Q × {f:g} (R / {f:g})" if f != 1 else "right Q, R" for f in FACTORS))
    return Table(f"y-RMSE, m, over {len(adaptive)} drives", columns, rows)


def draw(found: dict[float, dict[str, Array]], adaptive: Score) -> Figure:
    """y-RMSE against the factor."""
    figure = new_figure(8.5, 4.5)
    axes = figure.subplots()
    looks: dict[str, Any] = {KALMAN: STYLES["KF"], FIXED: STYLES["UFIR"], AUTO: {"color": SKY, "ls": "-."}}
    for name, look in looks.items():
        scores = [rmse(found[factor][name]) for factor in FACTORS]
        axes.errorbar(
            FACTORS, [s.value for s in scores], [s.error for s in scores], marker="o", ms=4, capsize=2,
            label=name, **look,
        )  # fmt: skip
    axes.axhline(adaptive.value, color=PURPLE, ls=":", label=f"{NEVER_TOLD}, told neither")
    axes.axvline(1.0, color=INK, lw=0.8, ls=":")
    axes.set(xlabel="Q / R believed, over the right one", ylabel="y-RMSE, m", xscale="log", ylim=(0.0, None))
    axes.legend()
    return figure


_WRONG = [f for f in FACTORS if f != 1.0]
ITEM = Item(
    id="beyond-wrong-noise",
    paper=BEYOND,
    title="UFIR against KF when Q and R are wrong by 10 and 100",
    run=run,
    claims=(
        "right Q and R: KF to UFIR",
        *(f"Q x {f:g}: {label} to KF" for f in _WRONG for label in ("UFIR", "UFIR auto")),
        "UFIR adaptive, no Q, R x 100, to N = 5",
        "R x 10 is Q / 10: change of the KF's gain",
        "Q x 1e-4: horizon auto, times longer",
    ),
    parameters={"model": "vehicle, Q and R of S0", "factors": "1/100, 1/10, 1, 10, 100 on Q, or on 1/R"},
    assumptions=["Simulated city drives, everything on time, white noise of 3.75 m in each axis."],
)
