"""The demo's picture, table and page."""

from __future__ import annotations

import base64
import csv
import html
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .._arrays import Array
from .compare import CONTENDERS, SCENARIOS, SETTLING, Contender, Score, Trial, estimate
from .simulate import Arrivals, transmit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["REPORT", "Exhibit", "exhibit", "picture", "score_limits", "write_report"]

Scores = Mapping[str, Mapping[str, Score]]

REPORT = ("report.html", "picture.png", "table.csv", "table.md")
LATE = "10 % lost, 40 % late"
SHOWN, CLOSE_UP = 60, 24
"""Steps in the errors over time, and in the map, taken from their middle."""

# Okabe and Ito's palette, told apart by colour-blind readers too.
BLACK, ORANGE, SKY, BLUE = "#000000", "#E69F00", "#56B4E9", "#0072B2"
RED, GREEN = "#D55E00", "#009E73"
LINES = {
    "Kalman, right Q, R": (RED, "--", "KalmanFilter, late packets as new"),
    "Kalman, right Q, R, late dropped": (ORANGE, "-.", "KalmanFilter, late packets dropped"),
    "UFIR auto, right Q, R": (BLUE, "-", "UFIRFilter, update(z, delay=d)"),
    "Delay Kalman, right Q, R": (GREEN, ":", "DelayKalmanFilter, update(z, delay=d)"),
}


@dataclass(frozen=True)
class Exhibit:
    """One trial with late packets, and what the filters of LINES made of it."""

    trial: Trial
    arrivals: Arrivals
    estimates: dict[str, Array]


def exhibit(trial: Trial, rng: np.random.Generator) -> Exhibit:
    """Run the filters that the picture shows."""
    arrivals = transmit(rng, len(trial.drive), SCENARIOS[LATE])
    shown: dict[str, Contender] = {c.name: c for c in CONTENDERS if c.name in LINES}
    return Exhibit(trial, arrivals, {name: estimate(c, trial, arrivals) for name, c in shown.items()})


def picture(shown: Exhibit, scores: Scores, title: str) -> Figure:
    """Track and errors over the busiest minute, and every score with its standard error."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 11), layout="constrained")
    figure.suptitle(title, fontsize=14)
    grid = figure.add_gridspec(2, 1, height_ratios=(1, 1.1))
    upper = figure.add_subfigure(grid[0])
    lower = figure.add_subfigure(grid[1])
    left, right = upper.subplots(1, 2, width_ratios=(1, 1.15))
    window = _busiest(shown.trial.drive.position)
    middle = (window.start + window.stop) // 2
    close_up = slice(middle - CLOSE_UP // 2, middle + CLOSE_UP // 2)
    _draw_track(left, shown, close_up)
    _draw_errors(right, shown, window)
    right.axvspan(*shown.trial.drive.seconds[[close_up.start, close_up.stop - 1]], color=BLACK, alpha=0.06)
    _draw_scores(lower.subplots(), scores)
    return figure


def _busiest(position: Array) -> slice:
    """The stretch that covers most ground in both directions: driving and turning, not waiting."""
    size = min(SHOWN, len(position) - SETTLING)
    starts = range(SETTLING, len(position) - size + 1)
    finite = np.nan_to_num(position)
    ground = [np.linalg.det(np.cov(finite[s : s + size].T)) for s in starts]
    first = starts[int(np.argmax(ground))]
    return slice(first, first + size)


def _draw_track(axes: Axes, shown: Exhibit, window: slice) -> None:
    steps = range(*window.indices(len(shown.trial.drive)))
    packets = [shown.trial.measured[origin] for step in steps for origin, _ in shown.arrivals[step]]
    axes.plot(*shown.trial.drive.position[window].T, ".-", color=BLACK, lw=4, ms=9, alpha=0.3, label="truth")
    axes.plot(*np.array(packets).T, ".", color=SKY, ms=7, label="packets received")
    for name, positions in shown.estimates.items():
        colour, _, label = LINES[name]
        if colour in (ORANGE, GREEN):
            continue  # close to one of the others most of the time; the errors beside show it
        axes.plot(*positions[window].T, "o", color=colour, ms=4.5, label=label)
        for step in steps:
            pair = np.array([shown.trial.drive.position[step], positions[step]])
            axes.plot(*pair.T, color=colour, lw=1.0, alpha=0.7)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(
        xlabel="east, m", ylabel="north, m", title=f"{LATE}: {len(steps)} steps; thin lines lead to the truth"
    )
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8.5, loc="best")


def _draw_errors(axes: Axes, shown: Exhibit, window: slice) -> None:
    drive = shown.trial.drive
    for name, positions in shown.estimates.items():
        colour, style, label = LINES[name]
        errors = np.linalg.norm(positions - drive.position, axis=1)
        root = math.sqrt(float(np.nanmean(errors[SETTLING:] ** 2)))
        text = f"{label} (RMSE of the whole track {root:.1f} m)"
        axes.plot(drive.seconds[window], errors[window], style, color=colour, lw=1.6, label=text)
    axes.set(
        xlabel="time, s",
        ylabel="position error, m",
        title="Error over time (grey: the steps of the map)",
        ylim=(0, None),
    )
    axes.grid(alpha=0.3)
    low, high = axes.get_ylim()
    axes.set_ylim(low, 1.25 * high)  # room for the legend
    axes.legend(fontsize=8.5, loc="upper left")


def _draw_scores(axes: Axes, scores: Scores) -> None:
    names = list(scores)
    marks = zip(SCENARIOS, "os^", (BLACK, ORANGE, BLUE), strict=True)
    for scenario, mark, colour in marks:
        rows = [(i, scores[name][scenario]) for i, name in enumerate(names) if scenario in scores[name]]
        axes.errorbar(
            [score.rmse for _, score in rows],
            [-i for i, _ in rows],
            xerr=[0.0 if math.isnan(score.error) else score.error for _, score in rows],
            fmt=mark,
            color=colour,
            ms=7,
            capsize=3,
            label=scenario,
        )
    axes.set_yticks([-i for i in range(len(names))], names, fontsize=9.5)
    axes.set(xlabel="RMSE of the position, m (bars: one standard error)", xlim=score_limits(scores))
    axes.grid(alpha=0.3)
    axes.legend(fontsize=9, title="packets", loc="upper left", bbox_to_anchor=(1.0, 1.0))


def score_limits(scores: Scores) -> tuple[float, float]:
    """Limits of the axis of scores: from 0, unless they lie too close together to be told apart there."""
    every = [score for row in scores.values() for score in row.values()]
    spans = [(score.rmse, 0.0 if math.isnan(score.error) else score.error) for score in every]
    low, high = min(mean - error for mean, error in spans), max(mean + error for mean, error in spans)
    margin = 0.05 * (high - low) or 0.05 * high or 1.0
    return (low - margin if low > high - low else 0.0), high + margin


def write_report(
    folder: Path, figure: Figure, scores: Scores, title: str, notes: list[str], runs: int
) -> dict[str, Path]:
    """Write report.html (self-contained), picture.png, table.csv and table.md; their paths by name."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = {name: folder / name for name in REPORT}
    figure.savefig(paths["picture.png"], dpi=100)
    with paths["table.csv"].open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["filter", "packets", "rmse_m", "standard_error_m", "runs"])
        for name, scenarios in scores.items():
            for scenario, score in scenarios.items():
                writer.writerow([name, scenario, f"{score.rmse:.6f}", f"{score.error:.6f}", runs])
    paths["table.md"].write_text(_markdown(scores), encoding="utf-8")
    image = base64.b64encode(paths["picture.png"].read_bytes()).decode("ascii")
    paths["report.html"].write_text(_page(title, notes, scores, runs, image), encoding="utf-8")
    return paths


def _page(title: str, notes: list[str], scores: Scores, runs: int, image: str) -> str:
    head = "".join(f"<th>{html.escape(scenario)}</th>" for scenario in SCENARIOS)
    body = "".join(
        f"<tr><td>{html.escape(name)}</td>{''.join(f'<td>{cell(row.get(s))}</td>' for s in SCENARIOS)}</tr>\n"
        for name, row in scores.items()
    )
    items = "".join(f"<li>{html.escape(note)}</li>\n" for note in notes)
    return f"""<!doctype html>
<html lang="en"><meta charset="utf-8"><title>{html.escape(title)}</title>
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; max-width: 70rem; margin: 2rem auto; padding: 0 1rem }}
table {{ border-collapse: collapse }} td, th {{ padding: .3rem .8rem; border-bottom: 1px solid #bbb }}
td + td, th + th {{ text-align: right }} img {{ max-width: 100% }}
</style>
<h1>{html.escape(title)}</h1>
<p>Root-mean-square error of the position in metres, runs: {runs}, mean ± one standard error.</p>
<table><tr><th></th>{head}</tr>
{body}</table>
<ul>
{items}</ul>
<img alt="Track, errors and scores" src="data:image/png;base64,{image}">
</html>
"""


def _markdown(scores: Scores) -> str:
    rows = [["RMSE of the position, m", *SCENARIOS], ["---", *("--:" for _ in SCENARIOS)]]
    rows += [[name, *(cell(row.get(s)) for s in SCENARIOS)] for name, row in scores.items()]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def cell(score: Score | None) -> str:
    """One cell of the table: the mean and its standard error."""
    if score is None:
        return ""
    return f"{score.rmse:.2f}" if math.isnan(score.error) else f"{score.rmse:.2f} ± {score.error:.2f}"
