"""Table 2: "mean of RMS estimation errors", in the metric that gives its numbers and in true RMS."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from validation.claims import AtMost, Claim, absolute, printed, sampling
from validation.figures import BLUE, INK, ORANGE, RED, new_figure
from validation.item import Item, Outcome, Table
from validation.papers import S3
from validation.s3.cells import noise_deviation, replicate, spread
from validation.s3.simulation import ESTIMATORS, SHAPES, at_once, estimates, simulate, streamed
from validation.s3.tracking import RUNS, M
from validation.study import Study

__all__ = ["ITEM"]

Array = NDArray[np.float64]

REPORTED = {
    "FMS smoother": dict(zip(SHAPES, (0.0062, 0.0060, 0.0059, 0.0059), strict=True)),
    "FMS filter": dict(zip(SHAPES, (0.0477, 0.0441, 0.0408, 0.0445), strict=True)),
    "Kalman filter": dict(zip(SHAPES, (0.0505, 0.0456, 0.0415, 0.0481), strict=True)),
}
NOT_RMS = (
    "The table's numbers are not root-mean-square errors: no predictor of these measurements has position "
    "errors as small. They are the time average of |mean over the 30 runs of the error|, smaller by about "
    "sqrt(2 / (30 pi)). The true RMS follows from the exact error covariance and the bias that the "
    "acceleration leaves."
)
NO_GAIN = (
    "At accelerations this small the Kalman filter, the optimum without acceleration, loses no more by its "
    "longer settling than the finite window loses by forgetting: in true RMS the two are equal within 1 %."
)
BIG = (1.0, 2.0)
STREAMED = "filters one step at a time against the gains, relative"
AT_ONCE = "filter_series against the gains, relative"
FITTED = "amplitude fitted"


def _cell(shape: str, estimator: str) -> str:
    return f"{shape}, {estimator}" + (f" ({FITTED})" if estimator == "FMS filter" else "")


def _rms(shape: str, estimator: str) -> str:
    return f"as RMS: {shape}, {estimator}"


def run(study: Study) -> Outcome:
    """Many Table 2s: their mean is ours, their spread the chance that the paper's single one had."""
    count = study.choose(16, 400)
    cells = np.array(study.runs(replicate, count, tuple(SHAPES)))
    mean, chance = cells.mean(axis=0), cells.std(axis=0, ddof=1)
    rest = noise_deviation()
    claims = []
    for s, shape in enumerate(SHAPES):
        for e, estimator in enumerate(ESTIMATORS):
            printed_value = REPORTED[estimator][shape]
            one_more = math.sqrt(1 + 1 / count)
            claims.append(
                _claim(_cell(shape, estimator), printed_value, mean[s, e, 0], chance[s, e, 0] * one_more)
            )
            claims.append(_rms_claim(shape, estimator, printed_value, cells[:, s, e], rest[estimator]))
        claims.append(_ratio_claim(shape, cells[:, s], rest))
    big = {a: np.array(study.runs(replicate, count, ("step",), a))[:, 0] for a in BIG}
    claims += [_big_claim(amplitude, found) for amplitude, found in big.items()]
    claims += _other_ways(study)
    return Outcome(
        claims,
        [_both_metrics(mean), _larger(big)],
        partial(draw, mean, chance),
        notes=[
            "Dots: the metric of the table, with two standard deviations of a single table of 30 runs; "
            "crosses: what the paper prints. The FMS filter's row fixed the four amplitudes, the other eight "
            "numbers follow."
        ],
    )


def _claim(name: str, reported: float, ours: float, chance: float) -> Claim:
    return Claim(
        "s3", ITEM.id, name, reported, float(ours), printed(4) + sampling(2), float(chance), unit="m"
    )


def _rms_claim(shape: str, estimator: str, reported: float, cells: Array, rest: float) -> Claim:
    """The same cell as RMS; expected is sqrt(exact noise variance + mean square of the bias)."""
    square, error = spread(cells[:, 1])
    ours = math.sqrt(square)
    expected = math.sqrt(rest**2 + cells[:, 2].mean())
    return Claim(
        "s3",
        ITEM.id,
        _rms(shape, estimator),
        reported,
        ours,
        printed(4) + sampling(3),
        float(error) / (2 * ours),
        because=NOT_RMS,
        expected=expected,
        unit="m",
    )


def _ratio_claim(shape: str, cells: Array, rest: dict[str, float]) -> Claim:
    """FMS filter against Kalman filter, RMS over RMS, on common noise."""
    f, k = ESTIMATORS.index("FMS filter"), ESTIMATORS.index("Kalman filter")
    ratios = np.sqrt(cells[:, f, 1] / cells[:, k, 1])
    mean, error = spread(ratios)
    forecast = [math.sqrt(rest[ESTIMATORS[e]] ** 2 + cells[:, e, 2].mean()) for e in (f, k)]
    return Claim(
        "s3",
        ITEM.id,
        f"RMS of FMS filter / Kalman filter, {shape}",
        AtMost(1.0, "FMS outperforms"),
        float(mean),
        absolute(0.0) + sampling(3),
        float(error),
        because=NO_GAIN,
        expected=forecast[0] / forecast[1],
    )


def _big_claim(amplitude: float, found: Array) -> Claim:
    f, k = ESTIMATORS.index("FMS filter"), ESTIMATORS.index("Kalman filter")
    mean, error = spread(np.sqrt(found[:, f, 1] / found[:, k, 1]))
    name = f"RMS of FMS filter / Kalman filter, step of {amplitude:g} m/s²"
    return Claim("s3", ITEM.id, name, AtMost(1.0, "FMS outperforms"), float(mean), sampling(3), float(error))


def _other_ways(study: Study) -> list[Claim]:
    """The filters, and the whole series at once, against the constant gains that the table is made with."""
    rng = study.rng("streamed")
    _, z = simulate(rng, SHAPES["step"].acceleration(rng), 1)
    gains, scale = estimates(z), float(np.abs(z).max())
    ways = {STREAMED: streamed(z[:, 0]), AT_ONCE: at_once(z[:, 0])}
    return [
        Claim("s3", ITEM.id, name, 0.0, _apart(found, gains) / scale, absolute(1e-11))
        for name, found in ways.items()
    ]


def _apart(found: dict[str, Array], gains: dict[str, Array]) -> float:
    return max(float(np.abs(states - gains[name])[M:].max()) for name, states in found.items())


def _both_metrics(mean: Array) -> Table:
    columns = ["estimator"]
    for shape in SHAPES:
        columns += [f"{shape}: paper", "ours", "true RMS"]
    rows: list[list[str | float]] = []
    for e, estimator in enumerate(ESTIMATORS):
        row: list[str | float] = [estimator]
        for s, shape in enumerate(SHAPES):
            printed_value = f"{REPORTED[estimator][shape]:.4f}"
            row += [printed_value, f"{mean[s, e, 0]:.4f}", f"{math.sqrt(mean[s, e, 1]):.4f}"]
        rows.append(row)
    return Table("Table 2 in both metrics, m", columns, rows)


def _larger(big: dict[float, Array]) -> Table:
    rows: list[list[str | float]] = []
    for e, estimator in enumerate(ESTIMATORS):
        rms = [f"{math.sqrt(found[:, e, 1].mean()):.3f}" for found in big.values()]
        rows.append([estimator, *rms])
    columns = ["estimator", *(f"step of {a:g} m/s²" for a in big)]
    return Table("True RMS at larger accelerations, m", columns, rows)


def draw(mean: Array, chance: Array) -> Figure:
    """The table as a picture: filters above, the smoother, ten times smaller, below."""
    figure = new_figure(8.5, 4.2)
    left, right = figure.subplots(1, 2, width_ratios=(1.6, 1))
    colours = {"FMS smoother": ORANGE, "FMS filter": BLUE, "Kalman filter": RED}
    panels = {"FMS smoother": (right, 0.0), "FMS filter": (left, -0.12), "Kalman filter": (left, 0.12)}
    for e, estimator in enumerate(ESTIMATORS):
        axes, offset = panels[estimator]
        at = np.arange(len(SHAPES)) + offset
        axes.errorbar(
            at,
            mean[:, e, 0],
            2 * chance[:, e, 0],
            fmt="o",
            capsize=3,
            color=colours[estimator],
            label=estimator,
        )
        axes.plot(at, list(REPORTED[estimator].values()), "x", color=INK, markersize=8, label=None)
    left.plot([], [], "x", color=INK, label="printed in Table 2")
    for axes in (left, right):
        axes.set_xticks(range(len(SHAPES)), SHAPES)
        axes.legend(loc="upper center", ncols=2)
        axes.set_xlabel("shape of the acceleration")
        axes.margins(x=0.12, y=0.3)
    left.set_ylabel("time average of |mean error of 30 runs|, m")
    return figure


ITEM = Item(
    id="s3-table-2",
    paper=S3,
    title="Table 2: errors of smoother, filter and Kalman filter for four accelerations",
    run=run,
    claims=(
        *(name(s, e) for s in SHAPES for e in ESTIMATORS for name in (_cell, _rms)),
        *(f"RMS of FMS filter / Kalman filter, {shape}" for shape in SHAPES),
        *(f"RMS of FMS filter / Kalman filter, step of {a:g} m/s²" for a in BIG),
        STREAMED,
        AT_ONCE,
    ),
    parameters={
        "T": "2 s",
        "M": "15",
        "d": "5",
        "Q": "diag(0.173², 0.01²)",
        "R": "0.05²",
        "runs": str(RUNS),
        "steps": "800",
    },
    open_questions=[
        "The four accelerations: neither amplitude nor times are printed.",
        "How the metric was computed: it is called RMS and cannot be.",
        "How the Kalman filter starts, and whether the first steps count.",
        "Whether the filters are compared before or after the newest measurement.",
    ],
    assumptions=[
        "The metric is the time average of |mean over the 30 runs of the position's error|: inferred from "
        "the numbers, not documented by the author.",
        "A pulse of 0.185 m/s² and a ramp to 0.175 m/s² over steps 200 to 400, a triangle to 0.134 m/s² over "
        "200 to 600, and straight lines between knots every 80 steps, uniform in ±0.13 m/s²: 4 amplitudes, "
        "fitted to the four cells of the FMS filter.",
        "The acceleration is an unknown increment of the state x_a.",
        "Both filters are the one-step predictors x_{i|i-1}, as equation (3) has it; steps 15 to 799 count.",
        "The Kalman filter starts at the truth with its steady gain.",
    ],
)
