"""Random plants as control.StateSpace, simulated signals, and filters run over them sample by sample."""

from __future__ import annotations

import control as ct
import numpy as np
from hypothesis import assume
from hypothesis import strategies as st

from tests.strategies import KINDS, random_model, seeds
from ufirext.gains import observability_index

# A cart: position measured, force in, disturbed by another force.
CART = ct.ss([[1.0, 0.1], [0.0, 0.98]], [[0.005], [0.1]], [[1.0, 0.0]], 0.0, dt=0.1)


@st.composite
def plants(draw, kinds=KINDS, feedthrough=True, max_x=4, max_z=2):
    """(plant, shortest horizon, rng): observable, with one or two inputs, D != 0 or not."""
    n = draw(st.integers(1, max_x))
    m = draw(st.integers(1, min(n, max_z)))
    seed = draw(seeds)
    model = random_model(seed, n, m, draw(st.sampled_from(kinds)))
    shortest = observability_index(model)
    assume(shortest is not None)
    rng = np.random.default_rng(seed + 1)
    inputs = draw(st.integers(1, 2))
    D = rng.normal(size=(m, inputs)) if feedthrough and draw(st.booleans()) else np.zeros((m, inputs))
    return ct.ss(model.F, rng.normal(size=(n, inputs)), model.H, D, dt=True), shortest, rng


def signals(plant, steps, rng, *, noise=0.1, x0=None):
    """(X, Y, U), one column a step, of the plant with random inputs and noises."""
    x = rng.normal(size=plant.nstates) if x0 is None else np.asarray(x0, dtype=float)
    U = rng.normal(size=(plant.ninputs, steps))
    X, Y = np.empty((plant.nstates, steps)), np.empty((plant.noutputs, steps))
    for k in range(steps):
        X[:, k] = x
        Y[:, k] = plant.C @ x + plant.D @ U[:, k] + noise * rng.normal(size=plant.noutputs)
        x = plant.A @ x + plant.B @ U[:, k] + noise * rng.normal(size=plant.nstates)
    return X, Y, U


def estimates(est, Y, U, X0=0.0, **options):
    """What an estimator makes of signals, (outputs, steps)."""
    times = np.arange(Y.shape[1]) * float(est.dt)
    return ct.input_output_response(est, times, np.vstack([Y, U]), X0, squeeze=False, **options).outputs


def stream(filter, plant, Y, U, form, read=lambda f: f.x):  # noqa: A002
    """The estimates of a filter with filterpy's verbs, before (predictor) or after each measurement."""
    columns = []
    for k in range(Y.shape[1]):
        if k:
            filter.predict(U[:, k - 1])
        if form == "predictor":
            columns.append(np.array(read(filter)).ravel())
        filter.update(Y[:, k] - plant.D @ U[:, k])
        if form == "filter":
            columns.append(np.array(read(filter)).ravel())
    return np.array(columns).T


def configured(filter, plant):  # noqa: A002
    """The filter with the matrices of the plant."""
    filter.F, filter.B, filter.H = plant.A, plant.B, plant.C
    return filter


def rounding(est, Y, U):
    """What one rounding of every product makes of the estimates, at most."""
    return np.abs(est.K).max() * np.abs(Y).max() + np.abs(np.hstack([est.C, est.D])).max() * np.abs(U).max()
