"""Kalman filters for late data: the papers' two, the exact recursion and the augmented state."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ufirext import DelayKalmanFilter, Model, TimeStamped
from validation.claims import AtLeast, Claim, Interval, absolute, printed, sampling
from validation.figures import GREEN, INK, ORANGE, RED, SKY, new_figure
from validation.item import Item, Outcome, Table
from validation.linear import Recursion, recursion
from validation.papers import BEYOND
from validation.scores import ratio, rmse
from validation.study import Study
from validation.vehicle import SIGMA_V

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["ITEM", "true_covariance"]

Array = NDArray[np.float64]

AXIS = Model([[1.0, 1.0], [0.0, 1.0]], [[1.0, 0.0]], 4.0 * np.array([[0.5, 0.5], [0.5, 1.0]]), SIGMA_V**2)
DELAYS = (1, 3, 10)
METHODS = ("white", "correlated", "exact")
STEPS, WARM = 400, 200
# Position RMSE, m, of the steady filter, from an earlier and independent computation.
KNOWN = {
    ("white", 1): 5.14, ("white", 3): 12.61, ("white", 10): 66.2,
    ("correlated", 1): 5.13, ("correlated", 3): 11.80, ("correlated", 10): 63.8,
    ("exact", 1): 5.13, ("exact", 3): 11.41, ("exact", 10): 45.45,
}  # fmt: skip


def gains(method: str, k: int) -> tuple[Recursion, float]:
    """The filter, and the standard deviation of the position that its own P claims."""
    f = DelayKalmanFilter(2, 1, max_delay=k, method=method)
    delays = [None if step < k else k for step in range(STEPS)]
    found = recursion(f, AXIS, delays, TimeStamped(k).effective(AXIS, k).H)
    return found, math.sqrt(f.P[0, 0])


def augmented(k: int) -> float:
    """The standard deviation of the position by the filter of the augmented state: the optimum."""
    f = DelayKalmanFilter(2, 1, max_delay=k, method="augmented")
    f.F, f.H, f.Q, f.R = AXIS.F, AXIS.H, AXIS.Q, AXIS.R
    for step in range(WARM):
        f.predict()
        f.update(None if step < k else np.zeros(1), delay=k if step >= k else 0)
    return math.sqrt(f.P[0, 0])


def true_covariance(found: Recursion, k: int) -> Array:
    """Error covariance of x^ = F x^ + K (z - Hb F x^) with ANY gain, data k steps late, by algebra.

    The error and the last k process noises are one linear system: e <- (I - K Hb)(F e + w) - K vb with
    vb = v - sum of G_i w_{n-i}; its covariance follows step by step.
    """
    n = AXIS.dim_x
    row = TimeStamped(k).effective(AXIS, k)
    size = n * (k + 1)
    shift = np.zeros((size, size))
    shift[2 * n :, n : size - n] = np.eye(size - 2 * n)
    C = np.zeros((size, size))
    noises = np.hstack(row.G)
    for K in found.K[k:]:
        kept = np.eye(n) - K @ row.H
        A = shift.copy()
        A[:n, :n] = kept @ AXIS.F
        # The noises of the past, a step older than in C; the newest enters below.
        A[:n, n : size - n] = K @ noises[:, n:]
        B = np.zeros((size, n))
        B[:n], B[n : 2 * n] = kept + K @ noises[:, :n], np.eye(n)
        C = A @ C @ A.T + B @ AXIS.Q @ B.T
        C[:n, :n] += K @ AXIS.R @ K.T
    return np.asarray(C[:n, :n])


def simulate(rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """True states (count, STEPS, 2) and the noise (count, STEPS, 1) that each arrival brings."""
    values, vectors = np.linalg.eigh(AXIS.Q)
    w = rng.standard_normal((count, STEPS, 2)) * np.sqrt(values) @ vectors.T
    states = np.empty_like(w)
    x = np.zeros((count, 2))
    for step in range(STEPS):
        x = x @ AXIS.F.T + w[:, step]
        states[:, step] = x
    return states, SIGMA_V * rng.standard_normal((count, STEPS, 1))


def errors(method: str, k: int, states: Array, noise: Array) -> Array:
    """Mean squared position errors of the runs, once the filter is steady."""
    zs = np.full_like(noise, np.nan)
    zs[:, k:] = states[:, : STEPS - k, :1] + noise[:, k:]
    estimates = gains(method, k)[0].track(zs)
    return np.asarray(((estimates - states)[:, WARM:, 0] ** 2).mean(axis=1))


def run(study: Study) -> Outcome:
    """Simulate the model, and hold the errors against theory and against what the filters claim."""
    batches = study.runs(simulate, study.choose(8, 40), 100)
    states, noise = (np.concatenate(parts) for parts in zip(*batches, strict=True))
    found = {(m, k): errors(m, k, states, noise) for m in METHODS for k in DELAYS}
    believed = {(m, k): gains(m, k)[1] for m in METHODS for k in DELAYS}
    theory = {(m, k): math.sqrt(true_covariance(gains(m, k)[0], k)[0, 0]) for m in METHODS for k in DELAYS}
    optimum = {k: augmented(k) for k in DELAYS}
    claims = []
    for (method, k), known in KNOWN.items():
        score = rmse(found[method, k])
        digits = printed(1 if known > 20 and method != "exact" else 2)
        name = f"RMSE, {method}, k = {k}"
        claims.append(
            Claim("beyond", ITEM.id, name, known, score.value, digits + sampling(3), score.error, unit="m")
        )
        value, error = score.value / theory[method, k], score.error / theory[method, k]
        name = f"drawn to theory, {method}, k = {k}"
        claims.append(Claim("beyond", ITEM.id, name, 1.0, value, sampling(3), error))
    claims += _about_beliefs(found, believed, theory, optimum)
    rows: list[list[str | float]] = [
        [f"{method}, k = {k}", str(rmse(found[method, k])), theory[method, k], believed[method, k]]
        for method in METHODS
        for k in DELAYS
    ]
    rows += [[f"augmented, k = {k}", "", optimum[k], optimum[k]] for k in DELAYS]
    columns = ("filter", "RMSE, m, drawn", "theory", "by its own P")
    title = f"Position of one axis, {len(states)} runs of {STEPS - WARM} steps"
    return Outcome(
        claims,
        [Table(title, columns, rows)],
        partial(draw, found, believed, optimum),
        [
            "A late datum carries the process noises since it was made, and so does the error of the filter. "
            "Who takes the two for independent (white) or sees the newest noise only (correlated) weighs the "
            "datum wrongly, and believes in a P that is not its error covariance.",
        ],
    )


def _about_beliefs(
    found: dict[tuple[str, int], Array], believed: dict[tuple[str, int], float],
    theory: dict[tuple[str, int], float], optimum: dict[int, float],
) -> list[Claim]:  # fmt: skip
    honest = max((abs(believed["exact", k] / theory["exact", k] - 1.0) for k in DELAYS), default=0.0)
    loss = max(theory["exact", k] / optimum[k] for k in DELAYS)
    gap = ratio(found["white", 10], found["exact", 10])
    pessimist = believed["white", 10] / theory["white", 10]
    wide = AtLeast(1.2, "too large at k = 10")
    return [
        Claim("beyond", ITEM.id, "exact: its P to its error, largest deviation", 0.0, honest, absolute(1e-6)),
        Claim("beyond", ITEM.id, "exact to augmented, worst k", Interval(1.0, 1.002), loss, absolute(1e-9)),
        Claim(
            "beyond",
            ITEM.id,
            "white to exact, k = 10",
            AtLeast(1.3, "worse"),
            gap.value,
            sampling(2),
            gap.error,
        ),
        Claim("beyond", ITEM.id, "white: its P to its error, k = 10", wide, pessimist, absolute(0.0)),
    ]


def draw(
    found: dict[tuple[str, int], Array], believed: dict[tuple[str, int], float], optimum: dict[int, float]
) -> Figure:
    """True errors as bars, what P claims as marks."""
    figure = new_figure(8.5, 4.5)
    panels = figure.subplots(1, len(DELAYS))
    colours = {"white": RED, "correlated": ORANGE, "exact": GREEN}
    for axes, k in zip(panels, DELAYS, strict=True):
        for place, method in enumerate(METHODS):
            look: Any = {"color": colours[method], "alpha": 0.8}
            axes.bar(place, rmse(found[method, k]).value, width=0.7, **look)
            axes.plot(
                place,
                believed[method, k],
                marker="D",
                color=INK,
                ls="",
                label="its own P" if not place else None,
            )
        axes.axhline(optimum[k], color=SKY, ls="--", label="augmented: the optimum")
        axes.set_xticks(range(len(METHODS)), METHODS, rotation=20)
        axes.set(title=f"k = {k}")
        axes.grid(axis="x", visible=False)
    panels[0].set_ylabel("position error, m")
    panels[0].set_ylim(0, 8)
    panels[0].legend(loc="upper right")
    return figure


ITEM = Item(
    id="beyond-late-kalman",
    paper=BEYOND,
    title="The exact Kalman filter for late data beside the papers' two",
    run=run,
    claims=(
        *(f"{what}, {m}, k = {k}" for m, k in KNOWN for what in ("RMSE", "drawn to theory")),
        "exact: its P to its error, largest deviation",
        "exact to augmented, worst k",
        "white to exact, k = 10",
        "white: its P to its error, k = 10",
    ),
    parameters={"model": "one axis of S0's vehicle, Q and R of S0", "k": "1, 3, 10, constant"},
    assumptions=[
        "Tracks drawn from the model; noise new at every arrival; the filters are steady when scored."
    ],
)
