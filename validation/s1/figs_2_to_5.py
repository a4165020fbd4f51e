"""S1, Figs 2 to 5: tracking in the north direction and its errors, with and without time stamps."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ufirext import DelayKalmanFilter, Model
from validation.claims import AtLeast, AtMost, Claim, Interval, Tolerance, sampling
from validation.figures import INK, ORANGE, STYLES, new_figure
from validation.item import Item, Outcome, Table
from validation.linear import Finite, Linear, recursion
from validation.papers import S1
from validation.s1.filters import COUNT, PRINTED, SUITED, Group, groups, tracked, truths, windowed
from validation.scores import SETTLING, ratio, rmse, squares
from validation.study import Study
from validation.vehicle import HORIZON

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["ASSUMED", "OPEN", "PARAMETERS", "PICTURES"]

Array = NDArray[np.float64]

SPAN = slice(720, 920)
SPEED, CORNER, NEAR = 11.0, 100, 1.0
KF, SLOW = "KF, σ_w = 2", "KF, σ_w = 0.2 as printed"
LOOKS: dict[str, Any] = {
    "UFIR": STYLES["UFIR"],
    KF: STYLES["KF"],
    SLOW: {"color": ORANGE, "linestyle": "-."},
}
SMALL = (
    "with sigma_w = 0.2 m/s as printed the KF believes that the car hardly turns: at a corner it runs on for "
    "19 m; with the 2 m/s of S0 the statement holds"
)


class Network(NamedTuple):
    """The runs of one network, and the states of every filter."""

    found: list[Group]
    truth: Array
    states: dict[str, Array]

    @property
    def share(self) -> float:
        """Of the steps that bring a new datum."""
        return float(np.mean([[k is not None for k in group.delays] for group in self.found]))

    @property
    def late(self) -> float:
        """Of the new data, those that are a step late."""
        return float(np.mean([group.late for group in self.found])) / self.share

    @property
    def squares(self) -> dict[str, Array]:
        """Mean squared errors of the runs, by filter."""
        return {name: squares(states, self.truth) for name, states in self.states.items()}


def network(study: Study, number: int) -> Network:
    """All filters on the same runs; both networks have the same tracks."""
    found = groups(study, number)
    states = {
        "UFIR": windowed(study, found, number),
        KF: tracked(found, number, SUITED),
        SLOW: tracked(found, number, PRINTED),
    }
    return Network(found, truths(found), states)


def corner(tracker: Linear) -> tuple[float, int]:
    """Excursion, m, and steps until the error stays below NEAR, at a corner without noise or network."""
    north = SPEED * np.minimum(np.arange(COUNT), CORNER)
    truth = np.stack([np.zeros(COUNT), north], axis=1)[None]
    errors = np.abs(tracker.track(truth)[0, CORNER:, 2] - truth[0, CORNER:, 1])
    return float(errors.max()), int(np.flatnonzero(errors > NEAR)[-1]) + 1


def run_tracking_stamped(study: Study) -> Outcome:
    """Figure 2."""
    one = network(study, 3)
    filled = squares(windowed(study, one.found, 3, "predict"), one.truth)
    compensated = ratio(filled, one.squares["UFIR"])

    def plain(model: Model) -> Linear:
        return recursion(DelayKalmanFilter(4, 2), model, [0] * COUNT)

    turns = {name: corner(plain(model)) for name, model in ((KF, SUITED), (SLOW, PRINTED))}
    turns["UFIR"] = peak, settled = corner(Finite.ufir(PRINTED, HORIZON))
    larger, shorter, none = AtLeast(1.0, "large overshoot"), AtMost(1.0, "short transient"), Tolerance()
    fine, item = Interval(0.9, 1.1, "successful estimation"), study.item
    claims = [
        Claim("s1", item, "overshoot, UFIR to KF, printed Q", larger, peak / turns[SLOW][0], none,
              because=SMALL, expected=Interval(0.2, 0.3)),
        Claim("s1", item, "overshoot, UFIR to KF, sigma_w = 2", larger, peak / turns[KF][0], none),
        Claim("s1", item, "transient, UFIR to KF, printed Q", shorter, settled / turns[SLOW][1], none),
        Claim("s1", item, "transient, UFIR to KF, sigma_w = 2", shorter, settled / turns[KF][1], none),
        Claim("s1", item, "predicted data to rows left out, UFIR", fine, compensated.value, sampling(2),
              compensated.error),
    ]  # fmt: skip
    rows: list[tuple[str | float, ...]] = [
        (name, str(rmse(found)), turns[name][0], str(turns[name][1])) for name, found in one.squares.items()
    ]
    rows.append(("UFIR, predictions in place of lost data", str(rmse(filled)), "", ""))
    columns = ("filter", "y-RMSE, m", "overshoot, m", f"steps until below {NEAR:g} m")
    title = f"{len(one.truth)} runs with network (3); a corner at {SPEED:g} m/s without noise or network"
    note = (
        "Data are one step late at most, so that phi, the correlation with the newest process noise, is all "
        "there is: the KF of the paper, its signs corrected, is the exact one here."
    )
    return Outcome(claims, [Table(title, columns, rows)], partial(draw_tracking, one), [note])


def run_tracking_unstamped(study: Study) -> Outcome:
    """Figure 3."""
    stamped, unstamped = network(study, 3), network(study, 5)
    worse = AtLeast(1.0, "largest overshoot and transient")
    lag = "with the printed Q the error of the KF is its lag at corners, on which losses have little effect"
    claims = []
    for name, label in (("UFIR", "UFIR"), (KF, "KF, sigma_w = 2"), (SLOW, "KF, printed Q")):
        score = ratio(unstamped.squares[name], stamped.squares[name])
        because, expected = (lag, Interval(0.9, 1.05)) if name == SLOW else ("", None)
        label = f"error with (5) to that with (3), {label}"
        claims.append(
            Claim("s1", study.item, label, worse, score.value, sampling(2), score.error, because, expected)
        )
    rows: list[tuple[str | float, ...]] = [
        (name, str(rmse(stamped.squares[name])), str(rmse(unstamped.squares[name])))
        for name in stamped.squares
    ]
    rows.append(("share of steps with a new datum", stamped.share, unstamped.share))
    rows.append(("share of those that are late", stamped.late, unstamped.late))
    title = f"y-RMSE, m, of {len(stamped.truth)} runs, the same tracks in both networks"
    note = (
        "Network (3) brings fewer new data, and more of them late, and its filters err less all the same: "
        "it is worth more to know when a datum was made than to have it on time."
    )
    columns = ("filter", "(3), time stamps", "(5), none")
    return Outcome(claims, [Table(title, columns, rows)], partial(draw_tracking, unstamped), [note])


def run_errors(study: Study, number: int) -> Outcome:
    """Figures 4 and 5."""
    one = network(study, number)
    errors = {
        name: states[:, SETTLING:, 2] - one.truth[:, SETTLING:, 1] for name, states in one.states.items()
    }
    claims = []
    for name, label in (("UFIR", "UFIR"), (KF, "KF, sigma_w = 2")):
        means = errors[name].mean(axis=1)
        chance = float(means.std(ddof=1)) / len(means) ** 0.5
        claims.append(
            Claim(
                "s1",
                study.item,
                f"mean error, {label}",
                0.0,
                float(means.mean()),
                sampling(3),
                chance,
                unit="m",
            )
        )
    if number == 5:
        claims += _about_large_errors(study, errors)
    rows: list[tuple[str | float, ...]] = [
        (name, str(rmse(one.squares[name])), float(_large(error).mean())) for name, error in errors.items()
    ]
    title = f"{len(one.truth)} runs with network ({number})"
    columns = ("filter", "y-RMSE, m", "exceeded by 1 % of the errors, m")
    return Outcome(claims, [Table(title, columns, rows)], partial(draw_errors, one))


def _about_large_errors(study: Study, errors: dict[str, Array]) -> list[Claim]:
    other = network(study, 3)
    because = (
        "more steps of network (3) bring no new datum, and the largest errors are those after a few such"
    )
    claims = []
    for name, label in (("UFIR", "UFIR"), (KF, "KF, sigma_w = 2")):
        large = _large(errors[name])
        before = _large(other.states[name][:, SETTLING:, 2] - other.truth[:, SETTLING:, 1])
        scatter = np.std(large / large.mean() - before / before.mean(), ddof=1) / len(large) ** 0.5
        value = float(large.mean() / before.mean())
        claims.append(
            Claim("s1", study.item, f"large errors with (5) to (3), {label}",
                  AtLeast(1.0, "big error values"), value, sampling(2), value * float(scatter), because,
                  Interval(0.85, 1.0))
        )  # fmt: skip
    return claims


def _large(errors: Array) -> Array:
    """What 1 % of the errors of a run exceed, m."""
    return np.asarray(np.quantile(np.abs(errors), 0.99, axis=1))


def draw_tracking(one: Network) -> Figure:
    """North against time."""
    figure = new_figure(9.0, 7.0)
    group = one.found[0]
    for axes, span, letter in zip(figure.subplots(2, 1), (slice(0, COUNT), SPAN), "ab", strict=True):
        time = np.arange(COUNT)[span]
        axes.plot(time, group.truth[0, span, 1], color=INK, lw=3, alpha=0.35, label="truth")
        axes.plot(time, group.zs[0, span, 1], ".", color=INK, ms=2.5, alpha=0.7, label="received")
        for name, look in LOOKS.items():
            axes.plot(time, one.states[name][0, span, 2], label=name, **look)
        axes.set(xlabel="time, s", ylabel="north y, m", title=f"({letter}) {span.start} ≤ n ≤ {span.stop}")
        if letter == "b":
            _mark_losses(axes, group, span)
    figure.axes[0].legend(ncols=2)
    return figure


def draw_errors(one: Network) -> Figure:
    """Error of y against time."""
    figure = new_figure(9.0, 7.0)
    for axes, span, letter in zip(figure.subplots(2, 1), (slice(0, COUNT), SPAN), "ab", strict=True):
        time = np.arange(COUNT)[span]
        for name, look in LOOKS.items():
            axes.plot(time, one.states[name][0, span, 2] - one.truth[0, span, 1], label=name, **look)
        axes.set(xlabel="time, s", ylabel="error of y, m", title=f"({letter}) {span.start} ≤ n ≤ {span.stop}")
        if letter == "b":
            _mark_losses(axes, one.found[0], span)
    figure.axes[0].legend(ncols=3)
    return figure


def _mark_losses(axes: Axes, group: Group, span: slice) -> None:
    lost = [step for step in range(span.start, span.stop) if group.delays[step] is None]
    for step in lost:
        axes.axvspan(step - 0.5, step + 0.5, color=INK, alpha=0.12, lw=0)
    axes.annotate("grey: nothing new arrives", (0.01, 0.03), xycoords="axes fraction", color=INK, fontsize=9)


PARAMETERS = {
    "α0, α1": "0.7, 0.9",
    "Q": "σ² [[τ²/4, τ/2], [τ/2, 1]] for each axis, σ = 0.2 m/s",
    "R": "3.75² I m²",
    "speed": "about 11 m/s",
}
OPEN = [
    "Which Geolife track of Beijing; N; the probability of a loss in network (3).",
    "Whether σ = 0.2 m/s is meant, with which a KF cannot follow a car around corners.",
]
ASSUMED = [
    "Simulated city drives of 1000 points at 11 m/s; the KF with the printed σ = 0.2 and with S0's 2 m/s.",
    "N = 5. In network (3) 90 % of the packets arrive. Duplicates are dropped: they have the same noise.",
    "R and φ as corrected (section 3 of the paper has signs and powers of F wrong).",
]


def _item(number: int, title: str, run: Any, claims: tuple[str, ...]) -> Item:
    return Item(
        id=f"s1-fig-{number}",
        paper=S1,
        title=f"Fig. {number}: {title}",
        run=run,
        claims=claims,
        parameters=PARAMETERS,
        open_questions=OPEN,
        assumptions=ASSUMED,
    )


MEANS = ("mean error, UFIR", "mean error, KF, sigma_w = 2")
PICTURES = (
    _item(
        2,
        "tracking with time stamps, model (3)",
        run_tracking_stamped,
        (
            "overshoot, UFIR to KF, printed Q",
            "overshoot, UFIR to KF, sigma_w = 2",
            "transient, UFIR to KF, printed Q",
            "transient, UFIR to KF, sigma_w = 2",
            "predicted data to rows left out, UFIR",
        ),
    ),
    _item(
        3,
        "tracking without time stamps, model (5)",
        run_tracking_unstamped,
        tuple(
            f"error with (5) to that with (3), {name}"
            for name in ("UFIR", "KF, sigma_w = 2", "KF, printed Q")
        ),
    ),
    _item(4, "errors with time stamps, model (3)", partial(run_errors, number=3), MEANS),
    _item(
        5,
        "errors without time stamps, model (5)",
        partial(run_errors, number=5),
        (*MEANS, *(f"large errors with (5) to (3), {name}" for name in ("UFIR", "KF, sigma_w = 2"))),
    ),
)
