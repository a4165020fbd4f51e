"""A long series in parts: one worker and two, and what cutting costs."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.harness import Contest, MissingPeerError, Row, Run, wall_clock
from benchmarks.peers import peer
from benchmarks.streams import MODELS, drive, model_of
from ufirext import filter_series

HORIZON = 300
# Rows of the series for each of the benchmark's steps: four million with its 20 000.
ROWS_A_STEP = 200


def _series(states: int, steps: int) -> np.ndarray:
    return drive(MODELS[states][1], max(ROWS_A_STEP * steps, 4 * HORIZON))


def _serial(states: int, zs: np.ndarray) -> Callable[[], Run]:
    def prepare() -> Run:
        x = np.ones((len(zs), states))  # written to, so that fresh pages of memory cost neither side

        def run() -> object:
            filter_series(model_of(states), zs, HORIZON, out=x)
            return x[-1]

        return run

    return prepare


def _parted(states: int, zs: np.ndarray, workers: int) -> Callable[[], Run]:
    """Threads of Dask; the products let go of the interpreter."""
    dask = peer("dask", "'ufirext[distributed]'")
    lazily = peer("ufirext.distributed").filter_series
    chunks = max(len(zs) // 8, 2 * HORIZON)

    def prepare() -> Run:
        x = np.ones((len(zs), states))
        estimate = lazily(model_of(states), zs, HORIZON, chunks=chunks)

        def run() -> object:
            with dask.config.set(scheduler="threads", num_workers=workers):
                estimate.x.store(x, lock=False)
            return x[-1]

        return run

    return prepare


def _two_threads(states: int, steps: int) -> Contest:
    zs = _series(states, steps)
    return Contest(_parted(states, zs, 2), _parted(states, zs, 1), len(zs))


def _cutting(states: int, steps: int) -> Contest:
    zs = _series(states, steps)
    return Contest(_parted(states, zs, 1), _serial(states, zs), len(zs))


def _on_gpu(states: int, steps: int) -> Contest:
    """A series on the GPU against copying as many bytes there as go in and come out."""
    torch = peer("torch")
    if not torch.cuda.is_available():
        raise MissingPeerError("no GPU that torch can use")
    zs = torch.tensor(_series(states, steps), device="cuda")
    model = model_of(states)

    def ours() -> Run:
        filter_series(model, zs[: 4 * HORIZON], HORIZON)

        def run() -> object:
            x = filter_series(model, zs, HORIZON).x
            torch.cuda.synchronize()
            return x[-1].cpu().numpy()

        return run

    def copying() -> Run:
        source = torch.zeros((len(zs), zs.shape[1] + states), dtype=torch.float64, device="cuda")
        torch.cuda.synchronize()

        def run() -> object:
            copy = source.clone()
            torch.cuda.synchronize()
            return copy[-1].cpu().numpy()

        return run

    return Contest(ours, copying, len(zs))


SERIES = f"{ROWS_A_STEP} rows a step (N={HORIZON})"

ROWS = [
    Row("parts/2-threads-K2", SERIES + " in 8 parts on Dask, 2 workers", "1 worker", 1.5,
        partial(_two_threads, 2), timer=wall_clock, stretch=True),
    Row("parts/cutting-K2", SERIES + " in 8 parts on Dask, 1 worker", "filter_series", 0.33,
        partial(_cutting, 2), timer=wall_clock),
    Row("parts/cuda-K2", SERIES + ", torch on a GPU", "copying it on the GPU", 0.1,
        partial(_on_gpu, 2), timer=wall_clock, stretch=True),
]  # fmt: skip
