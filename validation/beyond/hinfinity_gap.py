"""H-infinity: the two filters that have a guarantee, and the pairing in S0 and S2 that has none."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ufirext import DelayHInfinityFilter, DelayKalmanFilter, ThetaTooLarge, worst_case_gain
from validation.claims import AtLeast, AtMost, Claim, Interval, Tolerance, absolute
from validation.figures import BLUE, GREEN, ORANGE, RED, new_figure
from validation.item import Item, Outcome, Table
from validation.linear import Recursion, recursion
from validation.papers import BEYOND
from validation.study import Study
from validation.vehicle import vehicle

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["ITEM"]

Array = NDArray[np.float64]

MODEL = vehicle()
STEPS = 50
FORMS = ("posterior", "prior", "mixed")
WORDS = {"posterior": "a-posteriori", "prior": "a-priori", "mixed": "the papers' pairing"}


class Worst(NamedTuple):
    """What theta does to a filter: the exact worst J theta over the steps, and its spectral radius."""

    gain: float
    radius: float


def tracker(theta: float, form: str) -> Recursion:
    """The filter without delays.

    Raises
    ------
    ThetaTooLarge
    """
    return recursion(DelayHInfinityFilter(4, 2, theta=theta, form=form), MODEL, [0] * STEPS)


def limit(form: str) -> float:
    """The theta beyond which the filter does not exist within the steps, by bisection."""
    low, high = 0.0, 0.2
    while high - low > 1e-6 * high:
        theta = 0.5 * (low + high)
        try:
            tracker(theta, form)
            low = theta
        except ThetaTooLarge:
            high = theta
    return low


def worst(theta: float, form: str) -> Worst:
    """By singular values of the map from all disturbances to all errors: no theory of H-infinity enters."""
    found = tracker(theta, form)
    case = worst_case_gain(
        list(found.K), MODEL.F, MODEL.H, MODEL.Q, MODEL.R, np.eye(4), theta=theta,
        form="prior" if form == "prior" else "posterior",
    )  # fmt: skip
    return Worst(case.gain, found.radius)


def swept(theta: float) -> dict[str, Worst | None]:
    """Every form at one theta; None where it does not exist."""
    result: dict[str, Worst | None] = {}
    for form in FORMS:
        try:
            result[form] = worst(theta, form)
        except ThetaTooLarge:
            result[form] = None
    return result


def run(study: Study) -> Outcome:
    """Each filter near its limit, and all of them over theta."""
    limits = dict(zip(FORMS, study.sweep(limit, FORMS), strict=True))
    near = {form: worst(0.999 * limits[form], form) for form in ("posterior", "prior")}
    middle = 0.5 * (limits["prior"] + limits["posterior"])
    gap = worst(middle, "mixed")
    kalman = recursion(DelayKalmanFilter(4, 2), MODEL, [0] * STEPS)
    same = max(float(np.abs(tracker(0.0, form).K - kalman.K).max()) for form in FORMS)
    thetas = limits["posterior"] * np.linspace(0.02, 0.998, study.choose(25, 100))
    found = study.sweep(swept, thetas.tolist())
    tight = Interval(0.99, 1.0, "met, and tight")
    item = ITEM.id
    paired = "the gain belongs to the a-priori filter, which does not exist here: neither error is bounded"
    claims = [
        Claim("beyond", item, "a-posteriori at 0.999 of its limit: worst J theta", tight,
              near["posterior"].gain, absolute(1e-9)),
        Claim("beyond", item, "a-priori at 0.999 of its limit: worst J theta", tight, near["prior"].gain,
              absolute(1e-9)),
        Claim("beyond", item, "S0's pairing between the limits: worst J theta",
              AtMost(1.0, "J < 1/theta, as S0 states"), gap.gain, Tolerance(), because=paired,
              expected=AtLeast(100.0)),
        Claim("beyond", item, "S0's pairing between the limits: spectral radius", AtLeast(1.0, "diverges"),
              gap.radius, Tolerance()),
        Claim("beyond", item, "a-posteriori at the same theta: spectral radius", AtMost(1.0, "does not"),
              worst(middle, "posterior").radius, Tolerance()),
        Claim("beyond", item, "limit of S0's condition to the a-posteriori one", 1.0,
              limits["mixed"] / limits["posterior"], absolute(1e-5)),
        Claim("beyond", item, "theta = 0: difference to the KF's gain", 0.0, same, absolute(1e-9)),
    ]  # fmt: skip
    rows: list[tuple[str | float, ...]] = [(WORDS[form], limits[form]) for form in FORMS]
    return Outcome(
        claims,
        [Table(f"Largest theta that exists, {STEPS} steps, S = I, P0 = I", ("filter", "limit"), rows)],
        partial(draw, thetas, found, limits),
        [
            "J is sum |x - x^|² over |x0 - x^0|²/P0 + sum |w|²/Q + sum |v|²/R; a filter with a guarantee "
            "keeps J θ at most 1 for every disturbance. The largest singular value of the map from the "
            "disturbances to the errors, squared, is the exact worst case.",
        ],
    )


def draw(thetas: Array, found: list[dict[str, Worst | None]], limits: dict[str, float]) -> Figure:
    """Worst J theta and spectral radius against theta."""
    figure = new_figure(10.0, 4.5)
    left, right = figure.subplots(1, 2)
    colours = {"posterior": GREEN, "prior": ORANGE, "mixed": RED}
    for form in FORMS:
        there = [(theta, one[form]) for theta, one in zip(thetas, found, strict=True)]
        kept = [(1e3 * theta, value) for theta, value in there if value is not None]
        along = [theta for theta, _ in kept]
        line = "-." if form == "posterior" else "-"
        left.plot(along, [v.gain for _, v in kept], ".", ls=line, color=colours[form], label=WORDS[form])
        right.plot(along, [v.radius for _, v in kept], ".", ls=line, color=colours[form])
    for axes in (left, right):
        axes.axhline(1.0, color=RED, lw=0.8, ls=":")
        axes.axvspan(1e3 * limits["prior"], 1e3 * limits["posterior"], color=BLUE, alpha=0.1, lw=0)
        axes.set(xlabel="θ / 10⁻³ (blue: between the limits)", yscale="log")
    left.set(ylabel="worst J θ", ylim=(1e-3, 1e4))
    right.set(ylabel="spectral radius of (I - K H) F", ylim=(0.1, 100))
    left.legend()
    return figure


ITEM = Item(
    id="beyond-hinfinity-gap",
    paper=BEYOND,
    title="The two H-infinity filters, and the pairing in S0 and S2",
    run=run,
    claims=(
        "a-posteriori at 0.999 of its limit: worst J theta",
        "a-priori at 0.999 of its limit: worst J theta",
        "S0's pairing between the limits: worst J theta",
        "S0's pairing between the limits: spectral radius",
        "a-posteriori at the same theta: spectral radius",
        "limit of S0's condition to the a-posteriori one",
        "theta = 0: difference to the KF's gain",
    ),
    parameters={"model": "vehicle, Q and R of S0, no delay", "S, P0": "I"},
    assumptions=["Nothing is drawn: the worst case is a singular value."],
)
