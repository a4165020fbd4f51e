"""Whole recorded series: constant models, many series, models that change from step to step, holes.

Both sides are timed by the sample, so that a slow peer may be given fewer of them: ours always filters ten
times the steps that are asked for, 200 000 by default, and ends each turn with the last state.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from benchmarks.harness import SPEEDUP, Contest, Metric, Row, Run
from benchmarks.peers import kalman, peer
from benchmarks.streams import MODELS, drive, model_of
from ufirext import Model, filter_series, kinematic

# Samples of ours for each step that is asked for.
TIMES = 10
# Series that simdkalman filters side by side.
SERIES = 1000

TIMES_MEMCPY = Metric("x", lambda ours, peer: ours / peer, higher_is_better=False)


def per_sample(run: Run, units: int) -> tuple[float, object]:
    """Processor seconds per sample of a run that returns how many there were, and the estimate."""
    start = time.process_time()
    samples, estimate = run()  # type: ignore[misc]
    return (time.process_time() - start) / samples, estimate


def _measured(states: int, samples: int) -> np.ndarray:
    return drive(MODELS[states][1], samples)


def _ours(model: Model, zs: np.ndarray, horizon: int, **options: Any) -> Callable[[], Run]:
    """filter_series, its plan made beforehand and its result in memory that is there already."""
    out = np.zeros((*zs.shape[:-1], model.dim_x))

    def prepare() -> Run:
        filter_series(model, zs, horizon, out=out, **options)
        return lambda: (
            out[..., 0].size,
            filter_series(model, zs, horizon, out=out, **options).x[..., -1, :].ravel()[-model.dim_x :],
        )

    return prepare


def _filterpy(model: Model, zs: np.ndarray) -> Callable[[], Run]:
    def prepare() -> Run:
        f, columns = kalman(model), list(zs[:, :, None])
        return lambda: (len(zs), f.batch_filter(columns)[0][-1])

    return prepare


def _simdkalman(model: Model, zs: np.ndarray) -> Callable[[], Run]:
    simdkalman = peer("simdkalman")

    def prepare() -> Run:
        f = simdkalman.KalmanFilter(model.F, model.Q, model.H, model.R)
        count = min(SERIES, len(zs) // 10)
        many = zs[: len(zs) // count * count].reshape(count, -1, model.dim_z)

        def run() -> object:
            # Filtered means alone, as ours: no smoothing, no likelihood, no covariances kept.
            result = f.compute(
                many,
                0,
                initial_value=np.zeros(model.dim_x),
                initial_covariance=100.0 * np.eye(model.dim_x),
                filtered=True,
                smoothed=False,
                covariances=False,
                observations=False,
            )
            return many.shape[0] * many.shape[1], result.filtered.states.mean[-1, -1]

        return run

    return prepare


def _statsmodels(
    model: Model, zs: np.ndarray, changing: dict[str, np.ndarray] | None = None
) -> Callable[[], Run]:
    statespace = peer("statsmodels.tsa.statespace.kalman_filter", "statsmodels")

    def prepare() -> Run:
        f = statespace.KalmanFilter(model.dim_z, model.dim_x, k_posdef=model.dim_x)
        f.bind(zs)
        given = {"transition": model.F, "state_cov": model.Q, "design": model.H, "obs_cov": model.R}
        for name, matrix in given.items():
            f[name] = matrix
        for name, matrices in (changing or {}).items():
            f[name] = np.asfortranarray(matrices.transpose(1, 2, 0))
        f["selection"] = np.eye(model.dim_x)
        f.initialize_known(np.zeros(model.dim_x), 100.0 * np.eye(model.dim_x))
        return lambda: (len(zs), f.filter().filtered_state[:, -1])

    return prepare


def _memcpy(model: Model, zs: np.ndarray) -> Callable[[], Run]:
    """As many bytes as are read and written: the measurements and the states."""
    source = np.ones((len(zs), model.dim_z + model.dim_x))
    target = np.zeros_like(source)

    def prepare() -> Run:
        def run() -> object:
            np.copyto(target, source)
            return len(zs), target[-1]

        return run

    return prepare


def _constant(against: str, states: int, horizon: int, steps: int) -> Contest:
    model = model_of(states)
    zs = _measured(states, TIMES * steps)
    few = zs[:steps]
    peers: dict[str, Callable[[], Callable[[], Run]]] = {
        "filterpy": lambda: _filterpy(model, few),
        "simdkalman": lambda: _simdkalman(model, zs),
        "statsmodels": lambda: _statsmodels(model, few),
        "memcpy": lambda: _memcpy(model, zs),
    }
    return Contest(_ours(model, zs, horizon), peers[against](), steps)


def _many(states: int, horizon: int, steps: int) -> Contest:
    """The same number of samples, in a thousand series on both sides."""
    model = model_of(states)
    zs = _measured(states, SERIES * max(2 * horizon, TIMES * steps // SERIES))
    many = zs.reshape(SERIES, -1, model.dim_z)
    return Contest(_ours(model, many, horizon), _simdkalman(model, zs), steps)


def _changing(states: int, horizon: int, steps: int) -> Contest:
    """F, Q, H and R of every step: an irregular clock, a sensor whose scale and noise change."""
    order, axes = MODELS[states]
    rng, samples = np.random.default_rng(6), TIMES * steps
    zs, model = _measured(states, samples), model_of(states)
    clock = {dt: kinematic(order, axes, dt, q=0.5) for dt in np.linspace(0.05, 0.15, 101)}
    ticks = [clock[dt] for dt in rng.choice(list(clock), samples)]
    scale, variance = rng.uniform(0.8, 1.2, (2, samples, 1, 1))
    F, Q = np.array([tick.F for tick in ticks]), np.array([tick.Q for tick in ticks])
    H, R = scale * model.H, variance * model.R
    few = slice(steps)
    changing = {"transition": F[few], "state_cov": Q[few], "design": H[few], "obs_cov": R[few]}
    return Contest(
        _ours(model, scale[:, 0] * zs, horizon, Fs=F, Hs=H, Rs=R),
        _statsmodels(model, scale[few, 0] * zs[few], changing),
        steps,
    )


def _holed(states: int, horizon: int, steps: int) -> Contest:
    """One measurement in ten is missing."""
    model = model_of(states)
    zs = _measured(states, TIMES * steps)
    zs[np.random.default_rng(7).random(len(zs)) < 0.1] = np.nan
    zs[-1] = 0.0
    return Contest(_ours(model, zs, horizon), _statsmodels(model, zs[:steps]), steps)


def _long(times: int, states: int, horizon: int, steps: int) -> Contest:
    model = model_of(states)
    zs = _measured(states, times * steps)
    return Contest(_ours(model, zs, horizon), _memcpy(model, zs), steps)


def _row(
    name: str, work: str, against: str, target: float, setup: Any, metric: Metric = SPEEDUP, **more: Any
) -> Row:
    return Row(f"series/{name}", work, against, target, setup, metric, per_sample, **more)


WORK = "filter_series, a sample of one long series"
PEERS = {
    "filterpy": ("filterpy batch_filter", {2: 2000.0, 4: 900.0, 9: 250.0}),
    "simdkalman": ("simdkalman, 1000 series", {2: 50.0, 4: 40.0, 9: 30.0}),
    "statsmodels": ("statsmodels KalmanFilter", {2: 75.0, 4: 45.0, 9: 40.0}),
}
LIMIT = {2: 10.0, 4: 15.0, 9: 20.0}

ROWS = [
    *(
        _row(f"{name}-K{k}-N{n}", WORK, title, targets[k], partial(_constant, name, k, n))
        for name, (title, targets) in PEERS.items()
        for k in MODELS
        for n in (100, 1000)
    ),
    *(
        _row(
            f"memcpy-K{k}-N{n}",
            f"{WORK}, against the limit",
            "memcpy of the same bytes",
            LIMIT[k],
            partial(_constant, "memcpy", k, n),
            TIMES_MEMCPY,
        )
        for k in MODELS
        for n in (10, 100, 1000)
    ),
    # Growth with T: a tenth and five times the samples of the rows above.
    *(
        _row(
            f"memcpy-K4-N100-T{times}",
            f"{WORK}, {times} times the steps",
            "memcpy of the same bytes",
            LIMIT[4],
            partial(_long, times, 4, 100),
            TIMES_MEMCPY,
        )
        for times in (1, 50)
    ),
    *(
        _row(
            f"many-K{k}-N{n}",
            "filter_series, a sample of 1000 series",
            "simdkalman, 1000 series",
            PEERS["simdkalman"][1][k],
            partial(_many, k, n),
            # Two hundred steps each: half of them are windows of 100 that still grow.
            stretch=n == 100,
        )
        for k in MODELS
        for n in (10, 100)
    ),
    *(
        _row(
            f"changing-K{k}-N{n}",
            "filter_series, F, H, R of every step",
            "statsmodels KalmanFilter",
            2.0 if k == 2 else 1.0,
            partial(_changing, k, n),
        )
        for k in MODELS
        for n in (10, 100, 500)
    ),
    *(
        _row(
            f"holes-K{k}-N100",
            "filter_series, 10 % missing",
            "statsmodels KalmanFilter",
            1.0,
            partial(_holed, k, 100),
        )
        for k in MODELS
    ),
]
