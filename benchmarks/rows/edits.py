"""Streams in which the client has a hand: filterpy's IMM, a corrected x, known inputs, matrices it holds."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from benchmarks.harness import Contest, Row, Run
from benchmarks.peers import kalman, peer, ufir
from benchmarks.rows.streaming import stepped
from benchmarks.streams import columns, drive, model_of
from ufirext import Model

HORIZON = 10


def _imm(steps: int) -> Contest:
    """Two constant-velocity models, the second twenty times livelier, mixed at every step."""
    estimator = peer("filterpy.kalman", "filterpy").IMMEstimator
    calm = model_of(4)
    lively = calm.replace(Q=20.0 * calm.Q)
    zs = columns(drive(2, steps + HORIZON + 8))

    def side(make: Callable[[Model], Any]) -> Callable[[], Run]:
        def prepare() -> Run:
            bank = estimator([make(calm), make(lively)], [0.5, 0.5], np.array([[0.97, 0.03], [0.03, 0.97]]))
            return _imm_loop(bank, zs[:-steps], zs[-steps:])

        return prepare

    return Contest(side(ufir(HORIZON)), side(kalman), steps)


def _imm_loop(bank: Any, warm_up: list[np.ndarray], zs: list[np.ndarray]) -> Run:
    def run(zs: list[np.ndarray] = zs) -> object:
        for z in zs:
            bank.predict()
            bank.update(z)
        return bank.x

    run(warm_up)
    return run


def _assign(f: Any, nudge: np.ndarray) -> None:
    f.x = f.x + nudge


def _in_place(f: Any, nudge: np.ndarray) -> None:
    f.x[0] += nudge[0]


def _edited(edit: Callable[[Any, np.ndarray], None], steps: int) -> Contest:
    model = model_of(4)
    zs = columns(drive(2, steps + HORIZON + 8))
    nudges = columns(1e-3 * np.random.default_rng(1).standard_normal((len(zs), 4)))
    stream = list(zip(zs, nudges, strict=True))

    def side(make: Callable[[Model], Any]) -> Callable[[], Run]:
        def prepare() -> Run:
            f = make(model)

            def run(stream: list[tuple[np.ndarray, np.ndarray]] = stream[-steps:]) -> object:
                for z, nudge in stream:
                    f.predict()
                    f.update(z)
                    edit(f, nudge)
                return f.x

            run(stream[:-steps])
            return run

        return prepare

    return Contest(side(ufir(HORIZON)), side(kalman), steps)


def _driven(steps: int) -> Contest:
    base = model_of(4)
    model = base.replace(B=np.array([[0.005, 0], [0.1, 0], [0, 0.005], [0, 0.1]]))
    zs = columns(drive(2, steps + HORIZON + 8))
    us = columns(0.1 * np.random.default_rng(2).standard_normal((len(zs), 2)))
    stream = list(zip(zs, us, strict=True))

    def side(make: Callable[[Model], Any]) -> Callable[[], Run]:
        def prepare() -> Run:
            f = make(model)

            def run(stream: list[tuple[np.ndarray, np.ndarray]] = stream[-steps:]) -> object:
                x = f.x
                for z, u in stream:
                    f.predict(u)
                    f.update(z)
                    x = f.x
                return x

            run(stream[:-steps])
            return run

        return prepare

    return Contest(side(ufir(HORIZON)), side(kalman), steps)


def _held(steps: int) -> Contest:
    """The client keeps the arrays of F, H, Q and R, and may edit them at any time."""
    model = model_of(4)
    zs = columns(drive(2, steps + HORIZON + 8))
    given = {name: getattr(model, name).copy() for name in ("F", "H", "Q", "R")}

    def side(make: Callable[[Model], Any]) -> Callable[[], Run]:
        def prepare() -> Run:
            f = make(model)
            for name, array in given.items():
                setattr(f, name, array)
            stepped(f, zs[:-steps])()
            return stepped(f, zs[-steps:])

        return prepare

    return Contest(side(ufir(HORIZON)), side(kalman), steps)


FILTERPY = "filterpy KalmanFilter"
EDIT = "predict + update(z) + edit x"

ROWS = [
    Row("edits/imm", "filterpy IMM of two, one step", "IMM of two KalmanFilter", 1, _imm),
    Row("edits/assign", f"{EDIT} (f.x = ..)", FILTERPY, 1, partial(_edited, _assign)),
    Row("edits/in-place", f"{EDIT} (f.x[0] += ..)", FILTERPY, 1, partial(_edited, _in_place)),
    Row("edits/input", "predict(u) + update(z) + read x", FILTERPY, 1, _driven),
    Row("edits/held", "predict + update(z) + read x, F, H, Q, R held", FILTERPY, 3, _held),
]
