"""The cells of S2's tables: their filters on the same runs, and what theta does to H-infinity."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from ufirext import worst_case_gain
from validation.drives import Scene
from validation.linear import Linear
from validation.s2.filters import (
    GAMMAS,
    averaged,
    drawn,
    expectation,
    kalman,
    limits,
    robust,
    robust_squares,
    ufir,
)
from validation.scores import ratio, squares
from validation.study import Study

__all__ = ["FILTERS", "PRINTED", "THETA", "Cells", "cells", "printed_theta", "theta_sweep", "worst_ratio"]

Array = NDArray[np.float64]

FILTERS = ("UFIR", "KF", "H-inf")
THETA = 9.4e-3
PRINTED = {
    1.0: {
        0.2: (10.7920, 10.7646, 15.4474),
        0.5: (9.2526, 8.8149, 9.9992),
        0.8: (9.0603, 8.7766, 9.2172),
    },
    0.5: {
        0.2: (10.7920, 12.0264, math.inf),
        0.5: (9.2526, 10.6299, 62.5527),
        0.8: (9.0603, 10.1256, 13.3570),
    },
}


@dataclass(frozen=True)
class Cells:
    """Mean squared errors of the runs, drawn and expected, for each gamma and filter."""

    beta: float
    scene: Scene
    drawn: dict[float, dict[str, Array]]
    expected: dict[float, dict[str, Array]]
    radius: dict[float, float]


def cells(study: Study, beta: float) -> Cells:
    """Every filter of the table on the same runs."""
    scene = drawn(study, study.choose(16, 200))
    trackers: dict[float, dict[str, Linear]] = {
        g: dict(zip(FILTERS, (ufir(g, beta), kalman(g, beta), robust(g, THETA, beta)), strict=True))
        for g in GAMMAS
    }
    found = {g: {n: squares(t.track(scene.zs), scene.truth) for n, t in trackers[g].items()} for g in GAMMAS}
    expected = {g: {n: expectation(t, scene.truth) for n, t in trackers[g].items()} for g in GAMMAS}
    return Cells(beta, scene, found, expected, {g: robust(g, THETA, beta).radius for g in GAMMAS})


def printed_theta(gamma: float, found: Cells) -> float:
    """The theta with which the papers' H-infinity errs as much more than the KF as printed."""
    values = dict(zip(FILTERS, PRINTED[found.beta][gamma], strict=True))
    wanted, last = values["H-inf"] / values["KF"], limits(gamma, found.beta)[1]
    if not math.isfinite(wanted):
        return brentq(
            lambda theta: robust(gamma, theta, found.beta).radius - 1.0, 1e-4, 0.98 * last, rtol=1e-2
        )
    at = drawn_ratio(found, gamma)
    return brentq(lambda theta: min(at(theta), 1e3) - wanted, 0.0, 0.98 * last, rtol=1e-2)


def drawn_ratio(found: Cells, gamma: float, form: str = "mixed") -> partial[float]:
    """theta -> RMSE of an H-infinity filter in units of the KF's."""
    return partial(_drawn_ratio, found, gamma, form)


def _drawn_ratio(found: Cells, gamma: float, form: str, theta: float) -> float:
    return ratio(robust_squares(found.scene, gamma, theta, found.beta, form), found.drawn[gamma]["KF"]).value


def theta_sweep(gamma: float, found: Cells) -> dict[str, Array]:
    """Errors and spectral radii over theta, up to the limit of the a-posteriori filter."""
    prior, posterior = limits(gamma, found.beta)
    thetas = posterior * np.linspace(0.0, 1.0, 21)[:-1]
    radius = [robust(gamma, theta, found.beta).radius for theta in thetas]
    columns = {"theta": thetas, "radius": np.array(radius), "limits": np.array([prior, posterior])}
    for form in ("mixed", "posterior"):
        at = drawn_ratio(found, gamma, form)
        columns[form] = np.array([at(theta) for theta in thetas])
    return columns


def worst_ratio(gamma: float, beta: float) -> str:
    """The exact worst case of the papers' filter at THETA: a filter with a guarantee has at most 1."""
    believed = averaged(gamma, beta)
    gains = robust(gamma, THETA, beta).K[1:101]
    worst = worst_case_gain(
        list(gains), believed.F, believed.H, believed.Q, believed.R, np.eye(4), theta=THETA
    )
    return f"{worst.gain:.3g}"
