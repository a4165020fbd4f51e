"""LTI streams whose window is not full of equal rows: losses, weights, late rows."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from benchmarks.harness import Contest, Row, Run
from benchmarks.peers import kalman, ufir
from benchmarks.streams import MODELS, columns, drive, model_of
from ufirext import Model
from ufirext.demo.simulate import Link, transmit

Loop = Callable[[Any, int, int], object]
"""Drives a filter over the steps first..last of a stream and returns x."""


def _contest(states: int, horizon: int, steps: int, ours: Loop, peer: Loop) -> Contest:
    model = model_of(states)
    warm = horizon + 8

    def side(make: Callable[[Model], Any], loop: Loop) -> Callable[[], Run]:
        def prepare() -> Run:
            f = make(model)
            loop(f, 0, warm)
            return lambda: loop(f, warm, warm + steps)

        return prepare

    return Contest(side(ufir(horizon), ours), side(kalman, peer), steps)


def _stream(states: int, horizon: int, steps: int) -> list[np.ndarray]:
    return columns(drive(MODELS[states][1], steps + horizon + 8))


def missing(states: int, horizon: int, steps: int) -> Contest:
    """Every measurement is lost with probability 0.3; both sides see update(None)."""
    lost = np.random.default_rng(3).random(steps + horizon + 8) < 0.3
    zs = [None if gone else z for z, gone in zip(_stream(states, horizon, steps), lost, strict=True)]

    def loop(f: Any, first: int, last: int) -> object:
        x = f.x
        for z in zs[first:last]:
            f.predict()
            f.update(z)
            x = f.x
        return x

    return _contest(states, horizon, steps, loop, loop)


def weighted(states: int, horizon: int, steps: int) -> Contest:
    """Every measurement comes with a variance of its own, update(z, R=R)."""
    zs = _stream(states, horizon, steps)
    axes = MODELS[states][1]
    weights = [r * np.eye(axes) for r in np.random.default_rng(4).uniform(0.25, 4.0, len(zs))]
    stream = list(zip(zs, weights, strict=True))

    def loop(f: Any, first: int, last: int) -> object:
        x = f.x
        for z, R in stream[first:last]:
            f.predict()
            f.update(z, R)
            x = f.x
        return x

    return _contest(states, horizon, steps, loop, loop)


def delayed(states: int, horizon: int, steps: int) -> Contest:
    """Three packets in ten are one to three steps late; KalmanFilter takes them as if on time."""
    zs = _stream(states, horizon, steps)
    arrivals = transmit(np.random.default_rng(5), len(zs), Link(late=0.3, longest=3))
    stream = [[(zs[origin], delay) for origin, delay in packets] for packets in arrivals]

    def ours(f: Any, first: int, last: int) -> object:
        x = f.x
        for packets in stream[first:last]:
            f.predict()
            for z, delay in packets:
                f.update(z, delay=delay)
            x = f.x
        return x

    def peer(f: Any, first: int, last: int) -> object:
        x = f.x
        for packets in stream[first:last]:
            f.predict()
            for z, _ in packets:
                f.update(z)
            x = f.x
        return x

    return _contest(states, horizon, steps, ours, peer)


CASES = {
    "missing": (missing, "30 % missing + read x"),
    "weighted": (weighted, "update(z, R) per call + read x"),
    "delayed": (delayed, "30 % late rows + read x"),
}

ROWS = [
    Row(
        f"holes/{name}-K{k}-N{n}",
        work,
        "filterpy KalmanFilter",
        target,
        partial(case, k, n),
    )
    for name, (case, work) in CASES.items()
    for k, n, target in ((2, 10, 3.0), (4, 10, 3.0), (4, 100, 3.0), (9, 500, 1.5))
]
