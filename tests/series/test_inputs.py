"""Known inputs in whole series."""

from __future__ import annotations

import numpy as np
import pytest

from tests.engines.streams import MODELS
from tests.series.test_filter_series import assert_same
from ufirext import Model, filter_series


def driven(model, steps, seed=0, count=2, noise=1.0):
    """Series, their inputs, and the states: every state is pushed."""
    rng = np.random.default_rng(seed)
    us = rng.normal(size=(count, steps, model.dim_u))
    x, zs, states = np.zeros((count, model.dim_x)), [], []
    for step in range(steps):
        x = x @ model.F.T + us[:, step] @ model.B.T
        zs.append(x @ model.H.T + noise * rng.normal(size=(count, model.dim_z)))
        states.append(x)
    return np.stack(zs, axis=1), us, np.stack(states, axis=1)


@pytest.mark.parametrize("lag", [0, 2])
@pytest.mark.parametrize("horizon", [4, 30])
@pytest.mark.parametrize("name", sorted(MODELS))
def test_a_driven_series_is_the_stream(name, horizon, lag):
    model = MODELS[name]
    model = model.replace(B=np.eye(model.dim_x)[:, :2])
    zs, us, _ = driven(model, 70)
    for noise in (None, (model.Q, model.R)):
        options = {"us": us, "lag": lag, "noise": noise}
        assert_same(
            filter_series(model, zs, horizon, **options),
            filter_series(model, zs, horizon, engine="stepwise", **options),
            tolerance=1e-11,
        )


@pytest.mark.parametrize("radius", [0.9, 1.0, 1.05, 1.3])
def test_noise_free_driven_series_give_the_states(radius):
    model = Model([[radius, 0.2], [0.0, 0.8]], [[1.0, 0.0]], B=[[0.3], [1.0]])
    zs, us, states = driven(model, 150, noise=0.0)
    x = filter_series(model, zs, 60, us=us).x
    assert np.abs(x - states)[:, 1:].max() < 1e-12 * np.abs(states).max()


def test_one_series_of_inputs_serves_all():
    model = Model([[1.0, 0.1], [0.0, 1.0]], [[1.0, 0.0]], B=[0.0, 1.0])
    zs, us, _ = driven(model, 80)
    both = filter_series(model, zs, 20, us=us[0]).x
    one = filter_series(model, zs[0], 20, us=us[0, :, 0]).x
    np.testing.assert_allclose(both[0], one, rtol=0, atol=1e-12)


def test_holes_and_a_prior_beside_inputs():
    model = Model([[1.0, 0.1], [0.0, 1.0]], [[1.0, 0.0]], B=[0.0, 1.0])
    zs, us, _ = driven(model, 60)
    zs[1, 20:30] = np.nan
    options = {"us": us, "prior": ([1.0, 2.0], 4.0)}
    assert_same(
        filter_series(model, zs, 10, **options), filter_series(model, zs, 10, engine="stepwise", **options)
    )
