"""F, H and R that change at every step: an irregular clock, and a sensor that turns."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from benchmarks.harness import Contest, Row, Run, worst_step
from benchmarks.peers import kalman, ufir
from benchmarks.streams import columns, drive, model_of
from ufirext import Model, kinematic

Step = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""F, Q, z, R, H of one step."""


def _stream(steps: int) -> list[Step]:
    rng = np.random.default_rng(6)
    zs = columns(drive(2, steps))
    dts, angles, variances = (
        rng.uniform(0.05, 0.15, steps),
        rng.uniform(0, 0.2, steps),
        rng.uniform(0.5, 2, steps),
    )
    base = model_of(4)
    stream = []
    for z, dt, angle, variance in zip(zs, dts, angles, variances, strict=True):
        model = kinematic(1, 2, dt, q=0.5)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        stream.append((model.F.copy(), model.Q.copy(), turn @ z, variance * np.eye(2), turn @ base.H))
    return stream


def _per_call(f: Any, step: Step) -> object:
    F, _, z, R, H = step
    f.predict(F=F)
    f.update(z, R, H)
    return f.x


def _assigned(f: Any, step: Step) -> object:
    f.F, _, z, f.R, f.H = step
    f.predict()
    f.update(z)
    return f.x


def _per_call_with_Q(f: Any, step: Step) -> object:
    F, Q, z, R, H = step
    f.predict(F=F, Q=Q)
    f.update(z, R, H)
    return f.x


def _assigned_with_Q(f: Any, step: Step) -> object:
    f.F, f.Q, z, f.R, f.H = step
    f.predict()
    f.update(z)
    return f.x


def _clock_per_call(f: Any, step: Step) -> object:
    F, _, z, _, _ = step
    f.predict(F=F)
    f.update(z)
    return f.x


def _clock_assigned(f: Any, step: Step) -> object:
    f.F, _, z, _, _ = step
    f.predict()
    f.update(z)
    return f.x


def _contest(one: Callable[[Any, Step], object], whole: bool, horizon: int, steps: int) -> Contest:
    model = model_of(4)
    stream = _stream(steps + horizon + 8)
    warm_up, timed = stream[:-steps], stream[-steps:]

    def side(make: Callable[[Model], Any]) -> Callable[[], Run]:
        def prepare() -> Run:
            f = make(model)
            for step in warm_up:
                one(f, step)

            def run() -> object:
                x = f.x
                for step in timed:
                    x = one(f, step)
                return x

            def walk() -> Iterator[object]:
                for step in timed:
                    yield one(f, step)

            return run if whole else walk

        return prepare

    return Contest(side(ufir(horizon)), side(kalman), steps)


FILTERPY = "filterpy KalmanFilter"

ROWS = [
    *(
        Row(
            f"varying/{name}-N{n}",
            f"{work} + read x",
            FILTERPY,
            1.3,
            partial(_contest, one, True, n),
        )
        for name, work, one in (
            ("calls", "F, R, H by argument", _per_call),
            ("attributes", "F, R, H by attribute", _assigned),
            ("clock-calls", "F by argument", _clock_per_call),
            ("clock-attributes", "F by attribute", _clock_assigned),
            ("calls-Q", "F, Q, R, H by argument", _per_call_with_Q),
            ("attributes-Q", "F, Q, R, H by attribute", _assigned_with_Q),
        )
        for n in (10, 500)
    ),
    # Bounded, in figures: the slowest step takes at most as long as three of the peer's slowest.
    *(
        Row(
            f"varying/worst-N{n}",
            "slowest step (of 99.9 %)",
            FILTERPY,
            1 / 3,
            partial(_contest, _per_call, False, n),
            timer=worst_step,
        )
        for n in (10, 500)
    ),
]
