"""The same packets to several filters, over and over, and how far each ends up from the truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from .._arrays import Array
from ..horizon import best_horizon
from ..model import Model, kinematic
from .simulate import Arrivals, Drive, Link, transmit

__all__ = ["CONTENDERS", "SCENARIOS", "Contender", "Score", "Trial", "compare", "estimate", "tuned_density"]

SETTLING = 20
"""Steps at the start that are not scored: every filter is still finding the speed."""

SCENARIOS = {
    "all on time": Link(),
    "30 % lost": Link(loss=0.3),
    "10 % lost, 40 % late": Link(loss=0.1, late=0.4, longest=3),
}

LATEST = max(link.longest for link in SCENARIOS.values())
DENSITIES = (1e-6, 1e6)
"""Where the search for the right Q ends, m^2/s^3."""
ENOUGH = 1.5
"""Best horizons of least squares that make the minimum variance as small as it gets, to 0.1 %."""


@dataclass(frozen=True)
class Contender:
    """One filter and what its user does with late packets.

    Attributes
    ----------
    name : str
    horizon : int or str or None
        Of a filter with a window. "auto" comes from the model the filter is told.
    scale : float or None
        Factor on the right Q; None: the filter is told neither Q nor R and keeps its defaults.
    late : {"delay", "as new", "dropped"}
        What happens to a late packet: update(z, delay=d); update(z) as if on time; nothing.
    kind : {"filterpy", "ufir", "fms", "kalman", "hinf"}
        filterpy's KalmanFilter, UFIRFilter, FMSFilterSmoother, DelayKalmanFilter, DelayHInfinityFilter.
    """

    name: str
    horizon: int | str | None
    scale: float | None = 1.0
    late: Literal["delay", "as new", "dropped"] = "delay"
    kind: Literal["filterpy", "ufir", "fms", "kalman", "hinf"] | None = None

    @property
    def made(self) -> str:
        """The kind of filter; filterpy's where nothing is said and there is no window."""
        return self.kind or ("filterpy" if self.horizon is None else "ufir")


CONTENDERS = (
    Contender("Kalman, right Q, R", None, late="as new"),
    Contender("Kalman, right Q, R, late dropped", None, late="dropped"),
    Contender("Kalman, Q x 100 (or R / 100)", None, 100.0, late="as new"),
    Contender("Kalman, Q x 10 (or R / 10)", None, 10.0, late="as new"),
    Contender("Kalman, Q / 10 (or R x 10)", None, 0.1, late="as new"),
    Contender("Kalman, Q / 100 (or R x 100)", None, 0.01, late="as new"),
    Contender("UFIR auto, right Q, R", "auto"),
    Contender("UFIR auto, Q x 100 (or R / 100)", "auto", 100.0),
    Contender("UFIR auto, Q / 100 (or R x 100)", "auto", 0.01),
    Contender("UFIR adaptive, no Q, no R", "adaptive", None),
    Contender("FMS, right Q, R", "auto", kind="fms"),
    Contender("FMS, Q / 100 (or R x 100)", "auto", 0.01, kind="fms"),
    Contender("Delay Kalman, right Q, R", None, kind="kalman"),
    Contender("Delay Kalman, Q / 100 (or R x 100)", None, 0.01, kind="kalman"),
    Contender("H-infinity, right Q, R", None, kind="hinf"),
    Contender("H-infinity, Q / 100 (or R x 100)", None, 0.01, kind="hinf"),
)


@dataclass(frozen=True)
class Trial:
    """One run: the truth, what was measured of it at each step, and the steps' models.

    Attributes
    ----------
    drive : Drive
    measured : ndarray, (n, 2)
        m.
    models : sequence of Model, (n,)
        models[i] leads from step i - 1 to step i.
    """

    drive: Drive
    measured: Array
    models: Sequence[Model]


@dataclass(frozen=True)
class Score:
    """Root-mean-square position error of one contender in one scenario.

    Attributes
    ----------
    rmse : float
        Mean over the runs, m.
    error : float
        Standard error of that mean, m; NaN for a single run.
    """

    rmse: float
    error: float


def models(seconds: Array, q: float, r: float) -> list[Model]:
    """Constant-velocity models between stamps, equal steps sharing one model."""
    steps = np.diff(seconds, prepend=seconds[0] - float(np.median(np.diff(seconds)))).round(6)
    cache = {dt: kinematic(1, 2, dt, q=q, r=r) for dt in np.unique(steps).tolist()}
    return [cache[dt] for dt in steps.tolist()]


def build(contender: Contender, trial: Trial) -> Any:
    """The contender's filter at the trial's first measurement, at rest."""
    model = trial.models[0]
    told = model if contender.scale is None else model.replace(Q=contender.scale * model.Q)
    f = _filter(contender, told)
    f.F, f.H = model.F.copy(), model.H.copy()
    if contender.scale is not None:
        f.Q, f.R = told.Q.copy(), model.R.copy()
    f.P = np.diag([model.R[0, 0], 100.0, model.R[1, 1], 100.0])
    f.x = (model.H.T @ trial.measured[0]).reshape(4, 1)
    return f


def _filter(contender: Contender, told: Model) -> Any:
    if contender.made == "filterpy":
        from filterpy.kalman import KalmanFilter

        return KalmanFilter(4, 2)
    if contender.made == "ufir":
        from ..filters.ufir import UFIRFilter

        return UFIRFilter(4, 2, horizon=contender.horizon)  # type: ignore[arg-type]
    if contender.made == "fms":
        from ..filters.fms import FMSFilterSmoother

        return FMSFilterSmoother(4, 2, horizon=math.ceil(ENOUGH * best_horizon(told)))
    if contender.made == "kalman":
        from ..filters.kalman import DelayKalmanFilter

        return DelayKalmanFilter(4, 2, max_delay=LATEST)
    from ..filters.hinfinity import DelayHInfinityFilter

    return DelayHInfinityFilter(4, 2, max_delay=LATEST, S=told.H.T @ told.H)


def estimate(contender: Contender, trial: Trial, arrivals: Arrivals) -> Array:
    """Estimated positions (n, 2), m, after the packets of each step."""
    f = build(contender, trial)
    steady = all(model is trial.models[0] for model in trial.models)
    scale = contender.scale
    positions = np.empty_like(trial.measured)
    for step, packets in enumerate(arrivals):
        if steady:
            f.predict()
        else:
            model = trial.models[step]
            f.predict(F=model.F, Q=None if scale is None else scale * model.Q)
        _feed(f, contender, trial.measured, packets)
        positions[step] = f.x[::2, 0]
    return positions


def _feed(f: Any, contender: Contender, measured: Array, packets: list[tuple[int, int]]) -> None:
    used = [p for p in packets if p[1] == 0 or contender.late != "dropped"]
    for origin, delay in used:
        z = measured[origin].reshape(2, 1)
        if contender.late == "delay" and delay:
            f.update(z, delay=delay)
        else:
            f.update(z)
    if not used:
        f.update(None)


def rmse(positions: Array, truth: Array) -> float:
    """Root of the mean squared distance after the first SETTLING steps, m."""
    squared = ((positions - truth)[SETTLING:] ** 2).sum(axis=1)
    return float(np.sqrt(np.nanmean(squared)))


def tuned_density(trial_of: Callable[[float], Trial], around: float = 1.0) -> float:
    """The noise density q, m^2/s^3, of the constant-velocity Kalman filter of least error on a trial.

    It looks at the truth, which nobody has outside a simulation: the best that a constant Q can do. The
    search goes on until both sides of the best are known for two decades, or to `DENSITIES` times `around`.
    """
    contender = CONTENDERS[0]

    def error(exponent: float) -> float:
        trial = trial_of(around * 10.0**exponent)
        arrivals = transmit(np.random.default_rng(0), len(trial.drive), Link())
        return rmse(estimate(contender, trial, arrivals), trial.drive.position)

    lowest, highest = (math.log10(edge) for edge in DENSITIES)
    low, high, found = -2.0, 3.0, dict[float, float]()
    while True:
        for exponent in np.arange(low, high + 0.01, 0.5).tolist():
            if exponent not in found:
                found[exponent] = error(exponent)
        best = min(found, key=found.__getitem__)
        wider = max(min(low, best - 2.0), lowest), min(max(high, best + 2.0), highest)
        if wider == (low, high):
            break
        low, high = wider
    near = np.clip(best + np.arange(-0.4, 0.41, 0.1), lowest, highest)
    return float(around * 10.0 ** min(near.tolist(), key=error))


def compare(
    trial: Callable[[np.random.Generator], Trial],
    rng: np.random.Generator,
    runs: int,
    tick: Callable[[], None] = lambda: None,
) -> dict[str, dict[str, Score]]:
    """Scores by contender and scenario over independent runs, every contender on the same packets.

    Parameters
    ----------
    trial : callable
        Draws one trial.
    rng : numpy.random.Generator
    runs : int
    tick : callable, optional
        Called after each scenario of each run.
    """
    found: dict[str, dict[str, list[float]]] = {c.name: {} for c in CONTENDERS}
    for _ in range(runs):
        drawn = trial(rng)
        for scenario, link in SCENARIOS.items():
            arrivals = transmit(rng, len(drawn.drive), link)
            for contender in CONTENDERS:
                if contender.late == "dropped" and not link.late:
                    continue
                value = rmse(estimate(contender, drawn, arrivals), drawn.drive.position)
                found[contender.name].setdefault(scenario, []).append(value)
            tick()
    return {
        name: {scenario: _score(values) for scenario, values in scenarios.items()}
        for name, scenarios in found.items()
    }


def _score(values: list[float]) -> Score:
    error = float(np.std(values, ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else math.nan
    return Score(float(np.mean(values)), error)
