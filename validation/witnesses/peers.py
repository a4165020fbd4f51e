"""The same data through filterpy, simdkalman, python-control's moving-horizon estimator and scipy."""

from __future__ import annotations

import math
import warnings
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ufirext import DelayKalmanFilter, FMSFilterSmoother, Model, UFIRFilter, kinematic
from validation.claims import AtMost, Claim, absolute
from validation.figures import BLUE, GREEN, INK, ORANGE, PURPLE, RED, new_figure
from validation.item import CannotRun, Item, Outcome, Table
from validation.papers import BEYOND
from validation.study import Study

__all__ = ["ITEM"]

Array = NDArray[np.float64]

MODEL = kinematic(1, 1, 1.0, q=0.1, r=1.0)
HORIZON, LAG, SETTLING, P0 = 6, 4, 20, 100.0
SHOWN = 40
"""Steps in the picture."""
FILTERPY = "DelayKalmanFilter = filterpy's KalmanFilter"
SIMD = "DelayKalmanFilter = simdkalman's filter"
SAVGOL = "UFIRFilter = scipy's Savitzky-Golay end point"
CONTROL = "FMSFilterSmoother = python-control's moving-horizon estimator"
LAGGED = "RMSE of the lagged position: FMS smoother / filterpy's FixedLagSmoother"


def data(rng: np.random.Generator, steps: int) -> tuple[Array, Array]:
    """True states (steps, 2) and measurements (steps,) of a car on a straight road."""
    w = rng.multivariate_normal(np.zeros(2), MODEL.Q, steps)
    x = np.zeros((steps, 2))
    for n in range(1, steps):
        x[n] = MODEL.F @ x[n - 1] + w[n]
    return x, x[:, 0] + rng.normal(0.0, math.sqrt(MODEL.R[0, 0]), steps)


def track(f: Any, zs: Array) -> tuple[Array, float]:
    """States (steps, 2) of a filter with filterpy's verbs, and seconds a step."""
    f.F, f.H, f.Q, f.R, f.P = MODEL.F, MODEL.H, MODEL.Q, MODEL.R, P0 * np.eye(2)
    found = np.empty((len(zs), 2))
    start = perf_counter()
    for n, z in enumerate(zs):
        f.predict()
        f.update(z)
        found[n] = np.ravel(f.x)
    return found, (perf_counter() - start) / len(zs)


def moving_horizon(zs: Array, model: Model, horizon: int, count: int) -> tuple[Array, float]:
    """The newest states of the last `count` windows by python-control, without arrival cost; seconds each."""
    import control
    from control import optimal

    root = np.linalg.cholesky(model.Q)
    plant = control.ss(model.F, root, model.H, np.zeros((1, 2)), dt=1.0)
    cost = optimal.gaussian_likelihood_cost(plant, np.eye(2), model.R)
    problem = optimal.OptimalEstimationProblem(
        plant,
        np.arange(horizon, dtype=float),
        cost,
        disturbance_indices=[0, 1],
        minimize_kwargs={"options": {"ftol": 1e-13, "maxiter": 500}},
    )
    windows = [zs[n - horizon : n] for n in range(len(zs) - count + 1, len(zs) + 1)]
    start = perf_counter()
    with warnings.catch_warnings():
        # SLSQP complains where it cannot get still closer; the claim is about how close it is.
        warnings.filterwarnings("ignore", message="unable to solve optimal control problem")
        found = [
            problem.compute_estimate(window[None, :], np.zeros((0, horizon)), print_summary=False)
            for window in windows
        ]
    return np.array([estimate.states[:, -1] for estimate in found]), (perf_counter() - start) / count


def batch(zs: Array) -> tuple[Array, Array, float]:
    """Filtered and smoothed states by simdkalman, and seconds a step."""
    try:
        import simdkalman
    except ImportError:
        raise CannotRun("simdkalman is not installed: pip install 'ufirext[validation]'") from None
    peer = simdkalman.KalmanFilter(MODEL.F, MODEL.Q, MODEL.H, MODEL.R[0, 0])
    prior = MODEL.F @ (P0 * np.eye(2)) @ MODEL.F.T + MODEL.Q
    start = perf_counter()
    found = peer.compute(zs, 0, initial_value=np.zeros(2), initial_covariance=prior, filtered=True)
    seconds = (perf_counter() - start) / len(zs)
    return np.array(found.filtered.states.mean), np.array(found.smoothed.states.mean), seconds


def run(study: Study) -> Outcome:
    """One series, everybody; the moving-horizon estimator gets its end only, for it takes its time."""
    steps, windows = study.choose(1000, 10_000), study.choose(3, 20)
    x, zs = data(study.rng("series"), steps)
    found = _tracked(zs)
    study.watch(0.3)
    control = moving_horizon(zs, MODEL, HORIZON, windows)
    rms = {name: _rmse(states[:, 0] - x[:, 0]) for name, (states, _) in found.items()}
    lagged = {name: _rmse(states - x[: len(states), 0]) for name, states in _all_lagged(zs).items()}

    claim = partial(Claim, "beyond", ITEM.id)
    ours, peer = found["DelayKalmanFilter"][0], found["filterpy KalmanFilter"][0]
    simd, fms = found["simdkalman filter"][0], found["FMSFilterSmoother"][0]
    straight = found["UFIRFilter"][0][HORIZON - 1 :, 0]
    ratio = lagged["FMS smoother"] / lagged["filterpy FixedLagSmoother"]
    claims = [
        claim(FILTERPY, 0.0, _apart(ours, peer), absolute(1e-10), unit="m"),
        claim(SIMD, 0.0, _apart(ours, simd), absolute(1e-9), unit="m"),
        claim(SAVGOL, 0.0, _apart(straight, end_point(zs)), absolute(1e-9), unit="m"),
        claim(CONTROL, 0.0, _apart(fms[-windows:], control[0]), absolute(1e-4), unit="m"),
        claim(LAGGED, AtMost(1.0, "ours is better"), ratio, absolute(0.0)),
    ]
    last = {name: states[-SHOWN:] for name, (states, _) in found.items()}
    note = (
        "The moving-horizon estimator minimises the same sum of squares over the same window, by search, all "
        "anew each step; the minimum-variance window has its solution in closed form."
    )
    picture = partial(draw, x[-SHOWN:], zs[-SHOWN:], last, control[0])
    return Outcome(claims, [_table(rms, found, control[1]), _lag_table(lagged)], picture, notes=[note])


def _tracked(zs: Array) -> dict[str, tuple[Array, float]]:
    """States by estimator, and seconds a step."""
    from filterpy.kalman import KalmanFilter

    filtered, smoothed, seconds = batch(zs)
    return {
        "DelayKalmanFilter": track(DelayKalmanFilter(2, 1), zs),
        "filterpy KalmanFilter": track(KalmanFilter(2, 1), zs),
        "UFIRFilter": track(UFIRFilter(2, 1, horizon=HORIZON), zs),
        "FMSFilterSmoother": track(FMSFilterSmoother(2, 1, horizon=HORIZON), zs),
        "simdkalman filter": (filtered, seconds),
        "simdkalman smoother": (smoothed, seconds),
    }


def end_point(zs: Array) -> Array:
    """The straight line through the last HORIZON measurements, at the newest, by scipy."""
    from scipy.signal import savgol_coeffs

    return np.convolve(zs, savgol_coeffs(HORIZON, 1, pos=HORIZON - 1, use="conv"), "valid")


def _all_lagged(zs: Array) -> dict[str, Array]:
    """Positions LAG steps ago by estimator."""
    from filterpy.kalman import FixedLagSmoother

    ours = FMSFilterSmoother(2, 1, horizon=2 * HORIZON, lag=LAG)
    return {
        "FMS smoother": _lagged(ours, zs),
        "filterpy FixedLagSmoother": _fixed_lag(FixedLagSmoother(2, 1, N=LAG), zs),
    }


def _lagged(f: FMSFilterSmoother, zs: Array) -> Array:
    f.F, f.H, f.Q, f.R, f.P = MODEL.F, MODEL.H, MODEL.Q, MODEL.R, P0 * np.eye(2)
    found = np.empty(len(zs))
    for n, z in enumerate(zs):
        f.predict()
        f.update(z)
        found[n] = np.ravel(f.x_lag)[0]
    return found[LAG:]


def _fixed_lag(f: Any, zs: Array) -> Array:
    f.F, f.H, f.Q, f.R, f.P = MODEL.F, MODEL.H, MODEL.Q, MODEL.R, P0 * np.eye(2)
    f.x = np.zeros((2, 1))
    for z in zs:
        f.smooth(z)
    return np.array([np.ravel(state)[0] for state in f.xSmooth])[: len(zs) - LAG]


def _rmse(error: Array) -> float:
    return float(np.sqrt((error[SETTLING:] ** 2).mean()))


def _apart(one: Array, other: Array) -> float:
    return float(np.abs(one - other).max())


def _table(rms: dict[str, float], found: dict[str, tuple[Array, float]], control: float) -> Table:
    rows: list[list[str | float]] = []
    for name, value in rms.items():
        rows.append([name, f"{value:.4f}", f"{1e6 * found[name][1]:.3g}"])
    rows.append(["python-control, moving horizon", "as FMSFilterSmoother", f"{1e6 * control:.3g}"])
    return Table("RMSE of the position and time, same data", ("estimator", "RMSE, m", "µs a step"), rows)


def _lag_table(rms: dict[str, float]) -> Table:
    rows = [(name, f"{value:.4f}") for name, value in rms.items()]
    return Table(f"Position {LAG} steps ago", ("estimator", "RMSE, m"), rows)


def draw(x: Array, zs: Array, found: dict[str, Array], control: Array) -> Figure:
    """Errors of the last steps."""
    figure = new_figure(8.5, 4.2)
    axes = figure.subplots()
    steps = np.arange(len(x)) - len(x) + 1
    axes.plot(steps, zs - x[:, 0], ".", color=INK, label="measurement")
    looks = {
        "DelayKalmanFilter": (BLUE, "-", 1.2),
        "filterpy KalmanFilter": (ORANGE, ":", 2.6),
        "UFIRFilter": (GREEN, "-", 1.2),
        "FMSFilterSmoother": (RED, "-", 1.2),
        "simdkalman smoother": (PURPLE, "--", 1.2),
    }
    for name, (colour, line, width) in looks.items():
        axes.plot(steps, found[name][:, 0] - x[:, 0], line, color=colour, linewidth=width, label=name)
    last = steps[-len(control) :]
    axes.plot(
        last, control[:, 0] - x[-len(control) :, 0], "s", mfc="none", color=RED, label="python-control MHE"
    )
    axes.set_xlabel("step, from the last")
    axes.set_ylabel("position error, m")
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=3)
    return figure


ITEM = Item(
    id="beyond-peers",
    paper=BEYOND,
    title="The same data through four other libraries",
    run=run,
    claims=(FILTERPY, SIMD, SAVGOL, CONTROL, LAGGED),
    parameters={"model": "constant velocity, dt = 1 s, q = 0.1 m²/s³, r = 1 m²", "N": str(HORIZON)},
    assumptions=[
        "All filters start from x = 0, P = 100 I; the moving horizon has no arrival cost.",
        "Times are of one run on this machine, for orientation; the benchmarks measure them properly.",
    ],
)
