"""LTI streams: predict, update(z), read x, with a full window (the warm-up is not timed)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from benchmarks.harness import Contest, Row, Run
from benchmarks.peers import kalman, peer, ufir
from benchmarks.streams import MODELS, columns, drive, model_of
from ufirext import Model

TARGETS = {(2, 10): 14, (2, 100): 14, (2, 500): 11, (4, 10): 11, (4, 100): 11, (4, 500): 8.5} | {
    (9, 10): 10,
    (9, 100): 10,
    (9, 500): 6,
}


def stepped(f: Any, zs: list[np.ndarray]) -> Run:
    """The loop everybody writes."""

    def run() -> object:
        x = f.x
        for z in zs:
            f.predict()
            f.update(z)
            x = f.x
        return x

    return run


def unread(f: Any, zs: list[np.ndarray]) -> Run:
    """The same loop, x read once at the end."""

    def run() -> object:
        for z in zs:
            f.predict()
            f.update(z)
        return f.x

    return run


Loop = Callable[[Any, list[np.ndarray]], Run]


def _contest(states: int, horizon: int, steps: int, *, loop: Loop = stepped) -> Contest:
    model = model_of(states)
    zs = columns(drive(MODELS[states][1], steps + horizon + 8))
    warm_up, timed = zs[:-steps], zs[-steps:]

    def side(make: Callable[[Model], Any]) -> Callable[[], Run]:
        def prepare() -> Run:
            f = make(model)
            stepped(f, warm_up)()
            return loop(f, timed)

        return prepare

    return Contest(side(ufir(horizon)), side(kalman), steps)


def _against_cpp(states: int, horizon: int, steps: int) -> Contest:
    cpp = peer("kalman", "fast-kalman")
    model = model_of(states)
    zs = drive(MODELS[states][1], steps + horizon + 8).tolist()  # it takes lists of floats, fastest

    def prepare() -> Run:
        matrices = {name: getattr(model, name).ravel().tolist() for name in "FQHR"}
        f = cpp.LinearKalmanFilter(
            states, model.dim_z, x=[0.0] * states, P=(100.0 * np.eye(states)).ravel().tolist(), **matrices
        )

        def run(zs: list[list[float]] = zs[-steps:]) -> object:
            x = f.x
            for z in zs:
                f.update(z)  # predicts and corrects
                x = f.x
            return x

        run(zs[:-steps])
        return run

    return Contest(_contest(states, horizon, steps).ours, prepare, steps)


STEP = "predict + update(z) + read x"
FILTERPY = "filterpy KalmanFilter"

ROWS = [
    *(
        Row(f"lti/K{k}-N{n}", STEP, FILTERPY, target, partial(_contest, k, n))
        for (k, n), target in TARGETS.items()
    ),
    *(
        Row(
            f"lti/unread-K{k}-N{n}",
            "predict + update(z), x not read",
            FILTERPY,
            40,
            partial(_contest, k, n, loop=unread),
        )
        for k, n in ((2, 10), (4, 10), (9, 500))
    ),
    *(
        Row(
            f"lti/cpp-K{k}-N{n}",
            STEP,
            "fast-kalman (C++) update",
            1,
            partial(_against_cpp, k, n),
            stretch=True,
        )
        for k, n in ((2, 10), (4, 10), (4, 100))
    ),
]
