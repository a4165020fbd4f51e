"""Many tracks in lock step: a tick of a fleet against vectorised and single Kalman filters, and on a GPU."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from benchmarks.harness import MILLISECONDS, Contest, MissingPeerError, Row, Run, wall_clock
from benchmarks.peers import kalman, peer
from benchmarks.streams import MODELS, SEED, model_of
from ufirext import Fleet

HORIZON = 10
# Tracks for each of the benchmark's steps: a million with its 20 000.
TRACKS_A_STEP = 50
TICKS = 3


def _measured(states: int, tracks: int, lost: float = 0.0) -> list[np.ndarray]:
    """Ticks of straight tracks, enough to fill the windows and a few more."""
    rng = np.random.default_rng(SEED)
    axes = MODELS[states][1]
    start, speed = rng.normal(size=(2, tracks, axes))
    frames = []
    for tick in range(HORIZON + TICKS + 2):
        z = start + 0.1 * tick * speed + rng.standard_normal((tracks, axes))
        z[rng.random(tracks) < lost] = np.nan
        frames.append(z)
    return frames


def _fleet(states: int, frames: list[Any]) -> Callable[[], Run]:
    """A warm fleet, and the last ticks."""

    def prepare() -> Run:
        fleet = Fleet(model_of(states), HORIZON, len(frames[0]))
        for z in frames[:-TICKS]:
            fleet.step(z)

        def run() -> object:
            for z in frames[-TICKS:]:
                X = fleet.step(z)
            return X[np.argmax(fleet.ready)]

        return run

    return prepare


def _simdkalman(states: int, frames: list[np.ndarray], update: str) -> Callable[[], Run]:
    """The same ticks with its vectorised steps, each track with a covariance of its own."""
    steps = peer("simdkalman.primitives", "simdkalman")
    model = model_of(states)

    def prepare() -> Run:
        tracks = len(frames[0])
        state = [np.zeros((tracks, states, 1)), np.tile(100.0 * np.eye(states), (tracks, 1, 1))]
        columns = [z[..., None] for z in frames]

        def tick(z: np.ndarray) -> None:
            prior = steps.predict(*state, model.F, model.Q)
            state[:] = getattr(steps, update)(*prior, model.H, model.R, z)[:2]

        tick(columns[0])

        def run() -> object:
            for z in columns[-TICKS:]:
                tick(z)
            return state[0][0]

        return run

    return prepare


def _against_simdkalman(states: int, lost: float, steps: int) -> Contest:
    # Nine states have covariances of a gigabyte at a million tracks.
    tracks = (TRACKS_A_STEP if states < 9 else 5) * steps
    frames = _measured(states, tracks, lost)
    update = "update_with_nan_check" if lost else "update"
    return Contest(_fleet(states, frames), _simdkalman(states, frames, update), tracks * TICKS)


def _tick(states: int, lost: float, steps: int) -> Contest:
    return Contest(_fleet(states, _measured(states, TRACKS_A_STEP * steps, lost)), None, TICKS)


def _against_filterpy(states: int, steps: int) -> Contest:
    """As many tracks on both sides, each Kalman filter an object of its own."""
    frames = _measured(states, max(2, steps // TICKS))

    def prepare() -> Run:
        filters = [kalman(model_of(states)) for _ in frames[0]]
        columns = [z[..., None] for z in frames[-TICKS:]]

        def run() -> object:
            for z in columns:
                for f, one in zip(filters, z, strict=True):
                    f.predict()
                    f.update(one)
            return filters[0].x

        return run

    return Contest(_fleet(states, frames), prepare, len(frames[0]) * TICKS)


def _growth(states: int, steps: int) -> Contest:
    """Time of a track in a large fleet against one in a small fleet."""
    small, large = _measured(states, steps), _measured(states, TRACKS_A_STEP * steps)
    repeated = TRACKS_A_STEP

    def prepare_small() -> Run:
        runs = _fleet(states, small)()

        def run() -> object:
            for _ in range(repeated):
                estimate = runs()
            return estimate

        return run

    return Contest(_fleet(states, large), prepare_small, len(large[0]) * TICKS)


def _on_gpu(states: int, steps: int) -> Contest:
    """A tick on the GPU against copying the window there, the least any tick must read."""
    torch = peer("torch")
    if not torch.cuda.is_available():
        raise MissingPeerError("no GPU that torch can use")
    tracks = TRACKS_A_STEP * steps
    frames = [torch.tensor(z, device="cuda") for z in _measured(states, tracks)]

    def ours() -> Run:
        fleet = Fleet(model_of(states), HORIZON, tracks)
        for z in frames[:-TICKS]:
            fleet.step(z)
        torch.cuda.synchronize()

        def run() -> object:
            for z in frames[-TICKS:]:
                X = fleet.step(z)
            torch.cuda.synchronize()
            return X[0].cpu().numpy()

        return run

    def copying() -> Run:
        window = torch.zeros((HORIZON, *frames[0].shape), dtype=torch.float64, device="cuda")
        torch.cuda.synchronize()

        def run() -> object:
            for _ in range(TICKS):
                copy = window.clone()
            torch.cuda.synchronize()
            return copy[0, 0].cpu().numpy()

        return run

    return Contest(ours, copying, tracks * TICKS)


MANY = f"one tick of {TRACKS_A_STEP} tracks a step (N=10)"

ROWS = [
    Row(
        "fleet/1Hz-K4", MANY + ", 1e6 of 20 000 steps", "a second", 1000, partial(_tick, 4, 0.0),
        metric=MILLISECONDS,
    ),
    Row(
        "fleet/1Hz-K4-lost", MANY + ", 10 % lost", "a second", 1000, partial(_tick, 4, 0.1),
        metric=MILLISECONDS,
    ),
    *(
        Row(f"fleet/simd-K{k}", work, "simdkalman, vectorised", 30, partial(_against_simdkalman, k, 0.0))
        for k, work in ((2, MANY), (4, MANY), (9, MANY.replace("50", "5")))
    ),
    Row("fleet/simd-K4-lost", MANY + ", 10 % lost", "simdkalman, vectorised, NaN checked", 3,
        partial(_against_simdkalman, 4, 0.1)),
    Row("fleet/filterpy-K4", "one tick of a track", "filterpy KalmanFilter, one a track", 100,
        partial(_against_filterpy, 4)),
    Row("fleet/growth-S-K4", "a track among 50 times as many", "a track of a small fleet", 0.5,
        partial(_growth, 4)),
    Row("fleet/cuda-K4", MANY + ", torch on a GPU", "copying the window on the GPU", 0.2,
        partial(_on_gpu, 4), timer=wall_clock, stretch=True),
]  # fmt: skip
