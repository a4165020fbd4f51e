"""
Which filter? A table of measured errors
========================================

One plant, one axis of constant velocity, and nine ways in which the world can disagree with the
model. Every filter sees the same measurements. Nothing is tuned to a scenario: each filter is
given the Q and R of the first row of the table, in the rows "Q too small" and "Q too large" ones
that are wrong by a factor of a hundred.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import matplotlib.pyplot as plt
import numpy as np
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray

from ufirext import (
    DelayHInfinityFilter,
    DelayKalmanFilter,
    FMSFilterSmoother,
    TimeStamped,
    UFIRFilter,
    best_horizon,
    kinematic,
)

RUNS, STEPS, SETTLED = 8, 150, 30  # errors are counted from step SETTLED on
MODEL = kinematic(order=1, dim=1, dt=1.0, q=0.01, r=4.0)
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Scenario:
    """How the world differs from the model."""

    name: str
    told: float = 1.0  # the filters' Q, as a factor on the true one
    push: float = 0.0  # m/s, added to the speed at step 80
    outliers: float = 0.0  # share of measurements with ten times the noise
    gate: float = np.inf  # standard deviations of the innovation beyond which one is left out
    noise: float = 1.0  # true standard deviation of the measurements, as a factor
    channel: TimeStamped = field(default_factory=lambda: TimeStamped(0))


SCENARIOS = (
    Scenario("as the model says"),
    Scenario("Q too small, 1/100", told=0.01),
    Scenario("Q too large, x 100", told=100.0),
    Scenario("pushed once by 3 m/s", push=3.0),
    Scenario("noise twice as large", noise=2.0),
    Scenario("outliers, 5 %", outliers=0.05),
    Scenario("the same, gated", outliers=0.05, gate=4.0),
    Scenario("lost, 30 %", channel=TimeStamped(0, loss=0.3)),
    Scenario("late by 0 to 4 steps", channel=TimeStamped(4)),
)


def filters(told: float) -> dict[str, object]:
    """The candidates, all with the same Q and R."""
    model = MODEL.replace(Q=told * MODEL.Q)
    made = {
        "Kalman": KalmanFilter(2, 1),
        "UFIR auto": UFIRFilter(2, 1),
        "UFIR adaptive": UFIRFilter(2, 1, horizon="adaptive"),
        "FMS": FMSFilterSmoother(2, 1, horizon=best_horizon(model)),
        "delay Kalman": DelayKalmanFilter(2, 1, max_delay=4),
        "delay H∞": DelayHInfinityFilter(2, 1, theta=0.1, max_delay=4, on_violation="clip"),
    }
    for f in made.values():
        f.F, f.H, f.Q, f.R = model.F, model.H, model.Q, model.R
        f.P *= 100.0
    return made


def simulated(scenario: Scenario, rng: np.random.Generator) -> tuple[Array, list]:
    """True positions, and what arrives at each step."""
    state, truth = np.zeros(2), np.empty(STEPS)
    for n, w in enumerate(rng.multivariate_normal(np.zeros(2), MODEL.Q, size=STEPS)):
        state = MODEL.F @ state + w
        state[1] += scenario.push * (n == 80)
        truth[n] = state[0]
    sigma = np.where(rng.random(STEPS) < scenario.outliers, 10.0, scenario.noise) * np.sqrt(
        MODEL.R[0, 0]
    )
    zs = truth + sigma * rng.standard_normal(STEPS)
    return truth, scenario.channel.sample(rng, zs[:, None])


def believable(f: object, z: Array, gate: float) -> bool:
    """Whether a measurement is where the filter expects it, within `gate` standard deviations."""
    innovation = z - f.H @ f.x.ravel()
    spread = f.H @ f.P @ f.H.T + f.R
    return bool(innovation @ np.linalg.solve(spread, innovation) <= gate**2)


def errors(f: object, truth: Array, arrivals: list, gate: float = np.inf) -> Array:
    """Errors of the position; filterpy's filter takes a late measurement as new."""
    takes_late = not isinstance(f, KalmanFilter)
    found = []
    for position, packets in zip(truth, arrivals, strict=True):
        f.predict()
        for packet in packets:
            if np.isinf(gate) or believable(f, packet.z, gate):
                f.update(packet.z, delay=packet.delay) if takes_late else f.update(packet.z)
        found.append(f.x[0, 0] - position)
    return np.array(found[SETTLED:])


def measured(scenarios=SCENARIOS, runs: int = RUNS) -> dict[str, dict[str, tuple[float, float]]]:
    """RMSE and its standard error over the runs, by scenario and filter."""
    table = {}
    for scenario in scenarios:
        squares: dict[str, list[float]] = {}
        for rng in np.random.default_rng(0).spawn(runs):
            truth, arrivals = simulated(scenario, rng)
            for name, f in filters(scenario.told).items():
                squares.setdefault(name, []).append(
                    float(np.mean(errors(f, truth, arrivals, scenario.gate) ** 2))
                )
        table[scenario.name] = {
            name: (
                np.sqrt(np.mean(of)),
                np.std(of, ddof=1) / np.sqrt(runs) / 2 / np.sqrt(np.mean(of)),
            )
            for name, of in squares.items()
        }
    return table


def markdown(table: dict[str, dict[str, tuple[float, float]]]) -> str:
    """The table, a row for each scenario."""
    names = list(next(iter(table.values())))
    lines = ["| RMSE, m | " + " | ".join(names) + " |", "|---|" + "--:|" * len(names)]
    for scenario, row in table.items():
        lines.append(
            f"| {scenario} | "
            + " | ".join(f"{rmse:.2f} ± {error:.2f}" for rmse, error in row.values())
            + " |"
        )
    return "\n".join(lines)


# %%
# The table
# ---------
# Root mean square errors of the position in metres, with standard errors over the runs. The page
# on choosing a filter has the same table and says what follows from it.

if __name__ == "__main__":
    table = measured()
    print(markdown(table))

# %%
# As a picture
# ------------
# Relative to the Kalman filter with the right model in a world that is as the model says.

if __name__ == "__main__":
    plt.style.use("seaborn-v0_8-colorblind")
    unit = table["as the model says"]["Kalman"][0]
    names = list(table["as the model says"])
    figure, axes = plt.subplots(figsize=(7, 6.5), layout="constrained")
    for marker, name in zip("osD^v*", names, strict=True):
        place = np.arange(len(SCENARIOS)) + 0.11 * (names.index(name) - 2.5)
        axes.plot(
            [table[s.name][name][0] / unit for s in SCENARIOS],
            place,
            marker,
            markersize=6,
            label=name,
        )
    axes.set_yticks(range(len(SCENARIOS)), [s.name for s in SCENARIOS])
    axes.set(
        xscale="log",
        xlabel="RMSE, relative to the Kalman filter in the world of its model",
    )
    axes.set_xticks([1, 1.5, 2, 3], ["1", "1.5", "2", "3"])
    axes.minorticks_off()
    axes.grid(axis="x", linewidth=0.4)
    axes.invert_yaxis()
    figure.legend(loc="outside lower center", ncols=2)
    plt.show()
