"""Both readings of Table 2, for any shape of acceleration, with what theory says of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

from validation.s3.simulation import ESTIMATORS, SHAPES, Errors, errors, estimates, simulate
from validation.s3.tracking import RUNS, STEPS, A, C, gain, model

__all__ = ["bias", "noise_deviation", "replicate", "spread"]

Array = NDArray[np.float64]


def replicate(rng: np.random.Generator, shapes: Sequence[str], amplitude: float | None = None) -> Array:
    """One Table 2: (shapes, estimators, 3) with its metric, the mean square, and the mean square bias.

    All shapes have the same noise. The last column is of the estimates without noise: what the acceleration
    alone does.
    """
    cells = []
    noise, drawn = rng.spawn(2)
    start = noise.bit_generator.state
    for name in shapes:
        noise.bit_generator.state = start
        shape = SHAPES[name] if amplitude is None else SHAPES[name]._replace(amplitude=amplitude)
        acceleration = shape.acceleration(drawn)
        x, z = simulate(noise, acceleration, RUNS)
        found = errors(x, estimates(z))
        alone = bias(acceleration).by
        table, rms = found.table_2(), found.rms()
        cells.append([(table[e], rms[e] ** 2, float((alone[e] ** 2).mean())) for e in ESTIMATORS])
    return np.array(cells)


def bias(acceleration: Array) -> Errors:
    """The errors without any noise, (STEPS - M, 1)."""
    x = np.zeros((STEPS, len(A), 1))
    x[0, 2] = acceleration[0]
    for i in range(STEPS - 1):
        x[i + 1] = A @ x[i]
        x[i + 1, 2] += acceleration[i + 1] - acceleration[i]
    return errors(x, estimates((C @ x)[:, 0]))


def noise_deviation() -> dict[str, float]:
    """Standard deviation of the position's error without acceleration: exact covariances, no simulation."""
    P, n, target = gain().P, len(A), model()
    riccati = solve_discrete_are(target.F.T, target.H.T, target.Q, target.R)
    return dict(zip(ESTIMATORS, np.sqrt([P[n, n], P[0, 0], riccati[0, 0]]).tolist(), strict=True))


def spread(values: Array) -> tuple[Array, Array]:
    """Mean over the first axis and its standard error."""
    return values.mean(axis=0), values.std(axis=0, ddof=1) / np.sqrt(len(values))
