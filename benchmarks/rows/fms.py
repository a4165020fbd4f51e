"""The minimum-variance filter-smoother against filterpy's fixed-lag smoother."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from benchmarks.harness import Contest, Row, Run
from benchmarks.peers import configured, peer
from benchmarks.streams import columns, drive, model_of
from ufirext import Model


def _fms(model: Model, horizon: int) -> Any:
    from ufirext import FMSFilterSmoother

    return configured(FMSFilterSmoother(model.dim_x, model.dim_z, horizon=horizon, lag=horizon - 1), model)


def _stepped(f: Any, warm_up: list[np.ndarray], zs: list[np.ndarray]) -> Run:
    def run(zs: list[np.ndarray] = zs) -> object:
        x = f.x
        for z in zs:
            f.predict()
            f.update(z)
            x = f.x
        return x

    run(warm_up)
    return run


def _smoother(model: Model, horizon: int, warm_up: list[np.ndarray], zs: list[np.ndarray]) -> Run:
    f = configured(
        peer("filterpy.kalman", "filterpy").FixedLagSmoother(model.dim_x, model.dim_z, N=horizon), model
    )

    def run(zs: list[np.ndarray] = zs) -> object:
        for z in zs:
            f.smooth(z)
        return f.x

    run(warm_up)
    return run


def _against_smoother(horizon: int, steps: int) -> Contest:
    model = model_of(2)
    zs = columns(drive(1, steps + 3 * horizon))
    warm_up, timed = zs[:-steps], zs[-steps:]
    return Contest(
        lambda: _stepped(_fms(model, horizon), warm_up, timed),
        lambda: _smoother(model, horizon, warm_up, timed),
        steps,
    )


ROWS = [
    Row(
        f"fms/{n}",
        f"FMS predict + update(z) + read x, N = {n}",
        "filterpy FixedLagSmoother",
        goal,
        partial(_against_smoother, n),
    )
    for n, goal in ((10, 40), (100, 140))
]
