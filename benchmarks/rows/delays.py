"""The delay filters on streams without delays, against filterpy's own classes."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

from benchmarks.harness import Contest, Row, Run
from benchmarks.peers import configured, kalman, peer
from benchmarks.rows.streaming import stepped
from benchmarks.streams import MODELS, columns, drive, model_of
from ufirext import Model

# The covariances of both sides have settled after this many steps.
WARM_UP = 400
THETA = 1e-4


def _kalman(model: Model, **options: Any) -> Any:
    from ufirext import DelayKalmanFilter

    return configured(DelayKalmanFilter(model.dim_x, model.dim_z, **options), model)


def _robust(model: Model) -> Any:
    from ufirext import DelayHInfinityFilter

    return configured(DelayHInfinityFilter(model.dim_x, model.dim_z, theta=THETA), model)


def _filterpys_robust(model: Model) -> Any:
    cls = peer("filterpy.hinfinity", "filterpy").HInfinityFilter
    with warnings.catch_warnings():
        # Its author warns against it; here only its cost counts.
        warnings.simplefilter("ignore", DeprecationWarning)
        f = cls(model.dim_x, model.dim_z, 0, gamma=THETA)
    f.F, f.H, f.W, f.V = (a.copy() for a in (model.F, model.H, model.Q, model.R))
    return f


def _contest(
    ours: Callable[[Model], Any], theirs: Callable[[Model], Any], states: int, steps: int
) -> Contest:
    model = model_of(states)
    zs = columns(drive(MODELS[states][1], steps + WARM_UP))

    def side(make: Callable[[Model], Any]) -> Callable[[], Run]:
        def prepare() -> Run:
            f = make(model)
            stepped(f, zs[:-steps])()
            return stepped(f, zs[-steps:])

        return prepare

    return Contest(side(ours), side(theirs), steps)


STEP = "predict + update(z) + read x, no delay, K={}"

ROWS = [
    row
    for n in sorted(MODELS)
    for row in (
        Row(
            f"delays/kalman-K{n}",
            STEP.format(n),
            "filterpy KalmanFilter",
            2,
            partial(_contest, _kalman, kalman, n),
        ),
        Row(
            f"delays/late-allowed-K{n}",
            STEP.format(n) + ", max_delay=3",
            "filterpy KalmanFilter",
            2,
            partial(_contest, partial(_kalman, max_delay=3), kalman, n),
        ),
        Row(
            f"delays/hinfinity-K{n}",
            STEP.format(n),
            "filterpy HInfinityFilter",
            2,
            partial(_contest, _robust, _filterpys_robust, n),
        ),
    )
]
