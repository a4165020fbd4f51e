"""A certificate for each gain that the suite uses."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from ufirext import (
    Certificate,
    FMSGain,
    Gain,
    MinimumVarianceGain,
    Model,
    certify,
    minimum_variance_gain,
    ufir_gain,
)
from validation.claims import AtLeast, AtMost, Claim, absolute
from validation.figures import BLUE, GREEN, ORANGE, RED, new_figure
from validation.item import Item, Outcome, Table
from validation.papers import BEYOND
from validation.s3 import tracking
from validation.study import Study
from validation.vehicle import HORIZON, vehicle

__all__ = ["ITEM"]

LIMIT = 1e-8
"""What a certificate allows for each of its four figures."""
SOLVER = 1e-6
"""What convex solvers attain."""
FIGURES = {"feasibility": BLUE, "gap": ORANGE, "stationarity": GREEN, "duality": RED}


class Used(NamedTuple):
    """A gain, where the suite uses it, and the model it is certified for."""

    name: str
    where: str
    gain: Callable[[], Gain | FMSGain | MinimumVarianceGain]
    model: Model


CAR, SLOW, TARGET = vehicle(), vehicle(0.2, 0.25), tracking.model()
LATE = CAR.replace(H=0.8 * CAR.H + 0.2 * CAR.H @ np.linalg.inv(CAR.F))
"""The averaged measurement of a car whose data are late with probability 0.2."""


def _used() -> list[Used]:
    fms = [
        Used("FMS, M = 15, d = 5", "S3, all", tracking.gain, TARGET),
        Used("FMS, M = 15, d = 1", "S3, errata", partial(tracking.gain, 15, 1), TARGET),
        Used("FMS, M = 15, d = 0", "S3, errata", partial(tracking.gain, 15, 0), TARGET),
    ]
    horizons = (HORIZON, 6, 7, 8)
    cars = [Used(f"UFIR, N = {n}", "S0, S1, S2", partial(ufir_gain, CAR, n), CAR) for n in horizons]
    return [
        *fms,
        *cars,
        Used("UFIR, N = 5, S1", "S1", partial(ufir_gain, SLOW, HORIZON), SLOW),
        Used("UFIR, N = 5, averaged delay", "S2", partial(ufir_gain, LATE, HORIZON), LATE),
        Used("UFIR smoother, N = 8, lag 4", "beyond", partial(ufir_gain, CAR, 8, 4), CAR),
        Used("Minimum variance, N = 8", "beyond", partial(minimum_variance_gain, CAR, 8), CAR),
    ]


OTHER_CRITERION = "UFIR, N = 8, as if for least variance"


def run(study: Study) -> Outcome:
    """Certify; the figures need no solver, the confirmation does."""
    claim = partial(Claim, "beyond", ITEM.id, tolerance=absolute(0.0))
    claims, found = [], {}
    for used in _used():
        certificate = found[used.name] = certify(used.gain(), used.model)
        claims += [
            claim(used.name, AtMost(LIMIT, "optimal"), _worst(certificate)),
            claim(
                f"{used.name}, {certificate.solver}",
                AtMost(SOLVER, "the same gain"),
                float(np.nanmax([certificate.gain_difference, certificate.literal_difference])),
            ),
        ]
        study.watch(len(found) / len(_used()))
    refused = found[OTHER_CRITERION] = certify(ufir_gain(CAR, 8), CAR, criterion="variance")
    claims.append(claim(OTHER_CRITERION, AtLeast(1e-2, "refused"), _worst(refused)))
    note = (
        "Four figures that need no solver, each zero for the best unbiased gain in exact arithmetic; a gain "
        "whose worst one exceeds 1e-8 (line) is refused. The last one is meant to be: unbiased FIR gains are "
        "the best against measurement noise, not against process noise."
    )
    return Outcome(claims, [_table(found)], partial(draw, _figures(found)), notes=[note])


def _worst(certificate: Certificate) -> float:
    return float(max(getattr(certificate, name) for name in FIGURES))


def _figures(found: dict[str, Certificate]) -> dict[str, list[float]]:
    return {name: [getattr(certificate, figure) for figure in FIGURES] for name, certificate in found.items()}


def _table(found: dict[str, Certificate]) -> Table:
    rows = [
        (name, *(f"{getattr(c, f):.0e}" for f in FIGURES), f"{c.gain_difference:.0e}", c.solver, c.status)
        for name, c in found.items()
    ]
    columns = ("gain", *FIGURES, "difference to the solver's", "solver", "its status")
    return Table("Certificates", columns, rows)


def draw(figures: dict[str, list[float]]) -> Figure:
    """The four figures of every gain, on a logarithmic axis."""
    figure = new_figure(8.5, 5.0)
    axes = figure.subplots()
    rows = np.arange(len(figures))
    for column, (name, colour) in enumerate(FIGURES.items()):
        values = [max(found[column], 1e-18) for found in figures.values()]
        axes.plot(
            values, rows + 0.14 * (column - 1.5), "osD^"[column], color=colour, label=name, markersize=5
        )
    axes.axvline(LIMIT, color=RED, linestyle="--", linewidth=1)
    axes.set_xscale("log")
    axes.set_yticks(rows, list(figures))
    axes.invert_yaxis()
    axes.set_xlabel("relative; 0 in exact arithmetic")
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=4)
    return figure


ITEM = Item(
    id="beyond-certificates",
    paper=BEYOND,
    title="Certificates: each gain used is the best unbiased one",
    run=run,
    claims=(
        *(name for used in _used() for name in (used.name, f"{used.name}, CLARABEL")),
        OTHER_CRITERION,
    ),
    assumptions=[
        "Reported is what theory says: zero, up to rounding for the figures, to the solver's own for it.",
    ],
)
