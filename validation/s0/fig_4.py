"""S0, Fig. 4: tracking in the north direction with a delay of 3 steps."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from validation.claims import AtLeast, AtMost, Claim, Interval, Tolerance, absolute, sampling
from validation.drives import STEPS, Scene, constant_delay, scenes
from validation.figures import INK, PURPLE, STYLES, new_figure
from validation.item import Item, Outcome, Table
from validation.linear import Linear
from validation.papers import S0
from validation.s0.filters import best_theta, kalman, robust, ufir
from validation.scores import SETTLING, ratio, rmse, squares
from validation.study import Study
from validation.vehicle import HORIZON, SIGMA_V

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["DELAY", "ITEM", "LOOKS", "THETA", "trackers", "turn"]

Array = NDArray[np.float64]

DELAY, THETA = 3, 3.3e-4
SPEED, CORNER = 10.0, 200
NEAR = 1.0
"""A transient is over when the error stays below this, m."""

LOOKS: dict[str, Any] = {
    "UFIR": STYLES["UFIR"],
    "KF": STYLES["KF"],
    "H∞": STYLES["H-inf"],
    "exact KF": {"color": PURPLE, "linestyle": "-"},
}
SPANS = ((0, STEPS), (0, 200), (300, 400))


class Turn(NamedTuple):
    """What a corner does to a filter without any noise.

    Attributes
    ----------
    errors : ndarray
        m, one a second, from the corner on.
    transient : int
        Steps until they stay below NEAR.
    """

    errors: Array
    transient: int


def trackers() -> dict[str, Linear]:
    """The paper's three filters, and the exact KF, for k = 3."""
    return {
        "UFIR": ufir(DELAY),
        "KF": kalman(DELAY, "white"),
        "H∞": robust(DELAY, THETA),
        "exact KF": kalman(DELAY, "exact"),
    }


def _late(truth: Array) -> Array:
    """Measurements without noise, DELAY steps late."""
    zs = np.full_like(truth, np.nan)
    zs[:, DELAY:] = truth[:, :-DELAY]
    return zs


def turn(tracker: Linear) -> Turn:
    """North at 10 m/s, and from a corner on east: the response of the north axis, which stops."""
    north = SPEED * np.minimum(np.arange(STEPS), CORNER)
    truth = np.stack([np.zeros(STEPS), north], axis=1)[None]
    errors = tracker.track(_late(truth))[0, CORNER:, 2] - truth[0, CORNER:, 1]
    return Turn(errors, int(np.flatnonzero(np.abs(errors) > NEAR)[-1]) + 1)


def run(study: Study) -> Outcome:
    """Corners and drives without noise for the claims, one with noise for the picture."""
    scene = scenes(study, constant_delay(DELAY), study.choose(6, 100))
    filters = trackers()
    tracked = {name: tracker.track(scene.zs) for name, tracker in filters.items()}
    errors = {name: squares(states, scene.truth) for name, states in tracked.items()}
    turns = {name: turn(tracker) for name, tracker in filters.items()}
    quiet = {
        name: np.abs(tracker.track(_late(scene.truth))[:, SETTLING:, 2] - scene.truth[:, SETTLING:, 1])
        for name, tracker in filters.items()
    }
    rows: list[tuple[str | float, ...]] = [
        (name, float(quiet[name].max(axis=1).mean()), str(turns[name].transient), str(rmse(errors[name])))
        for name in turns
    ]
    title = (
        f"Excursions without noise on {len(scene.truth)} drives, transients after a corner, y-RMSE with noise"
    )
    columns = ("filter", "largest error of a drive, m", f"steps until below {NEAR:g} m", "y-RMSE, m")
    tuned = robust(DELAY, best_theta(DELAY, scene)).track(scene.zs)
    loss = ratio(errors["H∞"], squares(tuned, scene.truth))
    one = Scene(scene.truth[:1], scene.zs[:1], scene.origins[:1])
    return Outcome(
        [
            *_about_excursions({name: error.max(axis=1) for name, error in quiet.items()}),
            *_about_transients(turns),
            _about_straights(scene, quiet["KF"]),
            _claim("error with theta = 3.3e-4 to the best", AtMost(1.01, "the best theta for k = 3"),
                   loss.value, loss.error),
        ],
        [Table(title, columns, rows)],
        partial(draw, one, {name: states[0, :, 2] for name, states in tracked.items()}, turns),
        [
            "For the first k steps after a corner no filter can know of it, and all go on for 3 s. UFIR then "
            "needs N - 1 more steps and is exact; the others approach the truth for ever, each by its "
            "spectral radius.",
        ],
    )  # fmt: skip


def _about_excursions(peaks: dict[str, Array]) -> list[Claim]:
    """The largest errors without noise, over the drives."""
    high, low, middle, exact = (peaks[name] for name in LOOKS)
    larger = AtLeast(1.0, "larger excursions")
    because = (
        "the paper's KF takes the effective noise for white and so trusts what arrives too little: it is "
        "the slowest of the three; the exact KF has smaller excursions than UFIR, as the paper says"
    )
    # Where the KF is, in units of UFIR.
    slowest = float(low.mean() / high.mean())
    inside = Interval(min(1.0, slowest), max(1.0, slowest), "between KF and UFIR")
    below = "theta = 3.3e-4 undoes the distrust of the KF, and a little more"
    return [
        _claim("excursion, UFIR to KF", larger, *_mean_ratio(high, low), because, Interval(0.7, 0.9)),
        _claim("excursion, UFIR to exact KF", larger, *_mean_ratio(high, exact)),
        _claim("excursion, H-inf to UFIR", inside, *_mean_ratio(middle, high), below, Interval(0.95, 1.0)),
    ]


def _mean_ratio(one: Array, other: Array) -> tuple[float, float]:
    """Ratio of two means over the same runs, and its standard error."""
    value = float(one.mean() / other.mean())
    scatter = np.std(one / one.mean() - other / other.mean(), ddof=1)
    return value, value * float(scatter) / len(one) ** 0.5


def _about_transients(turns: dict[str, Turn]) -> list[Claim]:
    shorter, none = AtMost(1.0, "shorter transients"), Tolerance()
    fast, slow, middle = (turns[name].transient for name in ("UFIR", "KF", "H∞"))
    inside = Interval(fast, slow, "in between")
    exact = int(np.flatnonzero(np.abs(turns["UFIR"].errors) > 1e-6)[-1]) + 1
    return [
        Claim("s0", ITEM.id, "transient, UFIR to KF", shorter, fast / slow, none),
        Claim("s0", ITEM.id, "transient of H-inf", inside, middle, none, unit="steps"),
        Claim("s0", ITEM.id, "steps until UFIR is exact", HORIZON + DELAY - 1, exact, none, unit="steps"),
    ]


def _about_straights(scene: Scene, errors: Array) -> Claim:
    """The largest error without noise where the car has kept its velocity for 20 s."""
    changes = np.abs(np.diff(scene.truth[:, :, 1], n=2, axis=1)) > 1e-6
    changed = np.lib.stride_tricks.sliding_window_view(changes, 20, axis=1).any(axis=2)
    straight = np.zeros(scene.truth.shape[:2], dtype=bool)
    straight[:, 21:] = ~changed
    worst = float(errors[straight[:, SETTLING:]].max())
    reported = AtMost(0.0, "tracks well at constant velocity")
    # A tenth of the noise's standard deviation cannot be seen in the paper's picture.
    allowed = absolute(0.1 * SIGMA_V)
    return Claim("s0", ITEM.id, "error on straights without noise, KF", reported, worst, allowed, unit="m")


def _claim(
    name: str,
    reported: Interval,
    ours: float,
    error: float,
    because: str = "",
    expected: Interval | None = None,
) -> Claim:
    return Claim("s0", ITEM.id, name, reported, ours, sampling(2), error, because, expected)


def draw(scene: Scene, estimates: dict[str, Array], turns: dict[str, Turn]) -> Figure:
    """North against time: all of it, two stretches, and the corner without noise."""
    figure = new_figure(10.0, 9.0)
    grid = figure.add_gridspec(3, 2)
    panels = (figure.add_subplot(grid[0, :]), figure.add_subplot(grid[1, 0]), figure.add_subplot(grid[1, 1]))
    for axes, (first, last), letter in zip(panels, SPANS, "abc", strict=True):
        _draw_span(axes, scene, estimates, slice(first, last))
        axes.set(xlabel="time, s", ylabel="north y, m", title=f"({letter}) {first} ≤ n ≤ {last}")
    panels[0].legend(ncols=3)
    corner = figure.add_subplot(grid[2, :])
    for name, found in turns.items():
        corner.plot(found.errors[:30], marker=".", label=name, **LOOKS[name])
    corner.axvline(DELAY, color=INK, ls=":", lw=1)
    corner.text(DELAY + 3, 26, "dotted: from here on the corner can be known", color=INK, fontsize=9)
    corner.set(xlabel="steps after the corner", ylabel="error of y, m", title="One corner without noise")
    corner.legend()
    return figure


def _draw_span(axes: Axes, scene: Scene, estimates: dict[str, Array], span: slice) -> None:
    time = np.arange(STEPS)[span]
    axes.plot(time, scene.truth[0, span, 1], color=INK, lw=3, alpha=0.35, label="truth")
    axes.plot(time, scene.zs[0, span, 1], ".", color=INK, ms=2.5, alpha=0.7, label="measured, 3 s late")
    for name in ("UFIR", "KF", "H∞"):
        axes.plot(time, estimates[name][span], label=name, **LOOKS[name])


ITEM = Item(
    id="s0-fig-4",
    paper=S0,
    title="Fig. 4: tracking in the north direction, k = 3",
    run=run,
    claims=(
        "excursion, UFIR to KF",
        "excursion, UFIR to exact KF",
        "excursion, H-inf to UFIR",
        "transient, UFIR to KF",
        "transient of H-inf",
        "steps until UFIR is exact",
        "error on straights without noise, KF",
        "error with theta = 3.3e-4 to the best",
    ),
    parameters={"k": "3", "N": "5", "θ": "3.3e-4", "spans": "0 to 858, 0 to 200 and 300 to 400 s"},
    open_questions=["The track; what counts as the end of a transient; no number is printed but θ."],
    assumptions=[
        f"Transients are those of a corner at {SPEED:g} m/s, taken at once and without noise; excursions "
        "those of whole drives without noise.",
        f"A transient ends when the error stays below {NEAR:g} m.",
    ],
)
