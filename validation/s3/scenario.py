"""What Figures 1 to 4 share: one shape of acceleration, three panels, and what the text says of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from validation.claims import AtLeast, AtMost, Claim, absolute, sampling
from validation.figures import BLUE, INK, ORANGE, RED, new_figure
from validation.item import Outcome
from validation.s3.cells import bias, noise_deviation, spread
from validation.s3.simulation import ESTIMATORS, SHAPES, errors, estimates, simulate
from validation.s3.tracking import RUNS, STEPS, M
from validation.study import Study

__all__ = ["JUMP_CLAIMS", "OPEN", "SLOW_CLAIMS", "Scenario", "runner"]

Array = NDArray[np.float64]

SMOOTHER, FMS, KALMAN = ESTIMATORS
COLOURS = {SMOOTHER: ORANGE, FMS: BLUE, KALMAN: RED}
SETTLED = 0.01
"""Fraction of its peak below which an error counts as gone."""
ROUNDING = 1e-9
"""m; positions reach 1e4 m, so that a deadbeat error leaves about 1e-11."""

FORGETS = "steps until the FMS filter has forgotten a jump"
SLOWER = "steps until 1 % of the peak error: Kalman filter / FMS filter"
SMALLER = "RMS bias after a jump: FMS filter / Kalman filter"
AFTER = "RMS error in the 30 steps after a jump: FMS filter / Kalman filter"
BIAS = "mean |bias| of the position: FMS filter / Kalman filter"
OVERALL = "RMS error of all steps: FMS filter / Kalman filter"
SMOOTH = "RMS error: FMS smoother / FMS filter, against exact covariances"
VISIBLE = "error of the acceleration (FMS filter) / amplitude"

JUMP_CLAIMS = (FORGETS, SLOWER, SMALLER, AFTER, SMOOTH, VISIBLE)
SLOW_CLAIMS = (BIAS, OVERALL, SMOOTH, VISIBLE)

OPEN = (
    "Amplitude and times of the acceleration.",
    "The scales of the axes: our text of the paper has no pictures.",
)

NOT_BETTER = (
    "The bias is smaller with the finite window, as the paper says, but both biases are below the noise, of "
    "which the Kalman filter lets through less: exact covariances and biases together predict the ratio."
)
PANELS = (
    "Above: root mean square over 30 runs; middle: one of the runs; below: the acceleration, estimated and "
    "true. The smoother's error is drawn at the step when it is known, 5 steps late."
)
MODEST = (
    "The paper calls the FMS filter's error remarkably smaller where the acceleration jumps. The peaks are "
    "the same, for both filters first have to see the jump; what differs is how soon it is forgotten."
)


@dataclass(frozen=True)
class Scenario:
    """One replicate of a figure: 30 runs.

    Attributes
    ----------
    square, square_after : ndarray, (estimators,)
        Mean square error of the position over all steps, and over the 2 M steps after a jump.
    acceleration : float
        Mean square error of the FMS filter's acceleration.
    """

    square: Array
    square_after: Array
    acceleration: float


def replicate(rng: np.random.Generator, shape: str, acceleration: Array, jumps: tuple[int, ...]) -> Scenario:
    """30 runs of 800 steps with one acceleration."""
    x, z = simulate(rng, acceleration, RUNS)
    found = estimates(z)
    position = errors(x, found).by
    square = np.array([(position[e] ** 2).mean() for e in ESTIMATORS])
    after = np.array([(position[e][_after(jumps)] ** 2).mean() for e in ESTIMATORS]) if jumps else square
    return Scenario(square, after, float(np.nanmean((found[FMS][:, 2] - x[:, 2]) ** 2)))


def runner(item: str, shape: str, jumps: tuple[int, ...] = ()) -> Callable[[Study], Outcome]:
    """`Item.run` of the figure with this shape; `jumps` are the steps where the acceleration jumps."""
    return partial(_run, item, shape, jumps)


def _run(item: str, shape: str, jumps: tuple[int, ...], study: Study) -> Outcome:
    acceleration = SHAPES[shape].acceleration(study.rng("acceleration"))
    found = study.runs(replicate, study.choose(10, 100), shape, acceleration, jumps)
    alone = {name: e[:, 0] for name, e in bias(acceleration).by.items()}
    claim = partial(Claim, "s3", item)
    claims = [_smoother(claim, found, alone), _acceleration(claim, found, SHAPES[shape].amplitude)]
    if jumps:
        claims += _jump_claims(claim, found, alone, jumps)
    else:
        claims += _slow_claims(claim, found, alone)
    picture = partial(draw, study.seed("picture"), acceleration, jumps)
    return Outcome(claims, figure=picture, notes=[PANELS, *([MODEST] if jumps else [])])


def _jump_claims(
    claim: Callable[..., Claim], found: list[Scenario], alone: dict[str, Array], jumps: tuple[int, ...]
) -> list[Claim]:
    last = jumps[-1]
    gone = {name: _settling(alone[name], last, ROUNDING) for name in (FMS, KALMAN)}
    near = {name: _settling(alone[name], last, SETTLED * np.abs(alone[name]).max()) for name in (FMS, KALMAN)}
    smaller = _rms(alone[FMS][_after(jumps)]) / _rms(alone[KALMAN][_after(jumps)])
    ratio, error = _ratio([s.square_after for s in found])
    return [
        claim(FORGETS, M, gone[FMS], absolute(0.0)),
        claim(SLOWER, AtLeast(1.0, "FMS converges much faster"), near[KALMAN] / near[FMS], absolute(0.0)),
        claim(SMALLER, AtMost(1.0, "FMS smaller"), smaller, absolute(0.0)),
        claim(AFTER, AtMost(1.0, "FMS outperforms"), ratio, sampling(3), error),
    ]


def _slow_claims(claim: Callable[..., Claim], found: list[Scenario], alone: dict[str, Array]) -> list[Claim]:
    ratio, error = _ratio([s.square for s in found])
    smaller = float(np.abs(alone[FMS]).mean() / np.abs(alone[KALMAN]).mean())
    rest = noise_deviation()
    forecast = [math.hypot(rest[name], _rms(alone[name])) for name in (FMS, KALMAN)]
    return [
        claim(BIAS, AtMost(1.0, "FMS outperforms"), smaller, absolute(0.0)),
        claim(
            OVERALL,
            AtMost(1.0, "FMS outperforms"),
            ratio,
            sampling(3),
            error,
            because=NOT_BETTER,
            expected=forecast[0] / forecast[1],
        ),
    ]


def _smoother(claim: Callable[..., Claim], found: list[Scenario], alone: dict[str, Array]) -> Claim:
    """The lagged state is known better: ours against the exact covariances and the biases."""
    index = [ESTIMATORS.index(name) for name in (SMOOTHER, FMS)]
    mean, error = spread(np.sqrt([s.square[index[0]] / s.square[index[1]] for s in found]))
    rest = noise_deviation()
    theory = [math.hypot(rest[name], _rms(alone[name])) for name in (SMOOTHER, FMS)]
    return claim(SMOOTH, theory[0] / theory[1], float(mean), sampling(3), float(error))


def _acceleration(claim: Callable[..., Claim], found: list[Scenario], amplitude: float) -> Claim:
    mean, error = spread(np.sqrt([s.acceleration for s in found]) / amplitude)
    return claim(VISIBLE, AtMost(1.0, "estimates the acceleration"), float(mean), sampling(3), float(error))


def _ratio(squares: list[Array]) -> tuple[float, float]:
    """RMS of FMS filter over Kalman filter, over the replicates, and its standard error."""
    f, k = ESTIMATORS.index(FMS), ESTIMATORS.index(KALMAN)
    mean, error = spread(np.sqrt([square[f] / square[k] for square in squares]))
    return float(mean), float(error)


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))


def _after(jumps: tuple[int, ...]) -> list[int]:
    """Rows of the errors, which begin at step M, of the 2 M steps after each jump."""
    return [jump + step - M for jump in jumps for step in range(1, 2 * M + 1)]


def _settling(error: Array, jump: int, limit: float) -> int:
    """Steps after a jump from which on the error stays below the limit."""
    above = np.flatnonzero(np.abs(error[jump - M :]) > limit)
    return int(above[-1]) + 1 if above.size else 0


def draw(seed: np.random.SeedSequence, acceleration: Array, jumps: tuple[int, ...]) -> Figure:
    """The paper's three panels, with a close-up of the last jump where there is one."""
    x, z = simulate(np.random.default_rng(seed), acceleration, RUNS)
    found = estimates(z)
    figure = new_figure(9.0, 8.0)
    panels = figure.subplots(3, 1 + bool(jumps), sharex="col", width_ratios=[2.2, 1][: 1 + bool(jumps)])
    panels = panels.reshape(3, -1)
    for column in panels.T:
        _draw_column(column, x, found, acceleration)
    for axes, label in zip(
        panels[:, 0],
        ("RMS position error, m", "position error of one run, m", "acceleration of this run, m/s²"),
        strict=True,
    ):
        axes.set_ylabel(label)
    for axes in panels[2]:
        axes.set_xlabel("time step i (2 s)")
    if jumps:
        for axes in panels[:, 1]:
            axes.set_xlim(jumps[-1] - 10, jumps[-1] + 40)
        panels[0, 1].set_title("close-up", loc="left", fontsize=10)
    for row in (0, 2):
        handles, labels = panels[row, 0].get_legend_handles_labels()
        panels[row, 0].legend(handles, labels, loc="lower left", bbox_to_anchor=(0, 1), ncols=4, borderpad=0)
    return figure


def _draw_column(column: Array, x: Array, found: dict[str, Array], acceleration: Array) -> None:
    upper, middle, lower = column
    lower.plot(acceleration, color=INK, linestyle=":", linewidth=1.5, label="unknown part")
    lower.plot(x[:, 2, 0], color=INK, linewidth=1.2, label="true")
    for name, error in errors(x, found).by.items():
        look = {"color": COLOURS[name], "label": name, "linewidth": 0.9}
        look |= {"linestyle": "--"} if name == KALMAN else {}
        steps = np.arange(M, STEPS)
        upper.plot(steps, np.sqrt((error**2).mean(axis=1)), **look)
        middle.plot(steps, error[:, 0], **look)
        if name != SMOOTHER:
            lower.plot(steps, found[name][M:, 2, 0], **look)
    upper.set_ylim(bottom=0.0)
