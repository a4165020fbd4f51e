"""The linear systems are the filters: same outputs as UFIRFilter and FMSFilterSmoother, sample by sample."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.control.plants import CART, configured, estimates, plants, rounding, signals, stream
from ufirext import FMSFilterSmoother, UFIRFilter
from ufirext.control import create_fms_iosystem, create_ufir_iosystem

FORMS = ("predictor", "filter")
spare = st.integers(2, 12)


@pytest.mark.parametrize("form", FORMS)
def test_on_a_cart_the_system_is_the_filter_to_twelve_digits(form):
    rng = np.random.default_rng(3)
    X, Y, U = signals(CART, 80, rng)
    est = create_ufir_iosystem(CART, 9, form=form)
    f = configured(UFIRFilter(2, 1, 1, horizon=9), CART)
    found, wanted = estimates(est, Y, U), stream(f, CART, Y, U, form)
    np.testing.assert_allclose(found[:, 9:], wanted[:, 9:], rtol=0, atol=1e-12)
    assert np.abs(found[:, 9:] - X[:, 9:]).max() > 1e-3


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("lag", [0, 1, 4])
def test_on_a_cart_the_system_is_the_smoother_to_twelve_digits(form, lag):
    _, Y, U = signals(CART, 60, np.random.default_rng(4))
    QN, RN = [[0.3]], [[0.02]]
    est = create_fms_iosystem(CART, QN, RN, 11, lag, form=form)
    # In predictor form y[k] is not there yet: x[k - lag] is lag - 1 steps before the last measurement.
    behind = lag - 1 if form == "predictor" else lag
    f = configured(FMSFilterSmoother(2, 1, 1, horizon=11, lag=max(behind, 0)), CART)
    f.Q, f.R = 0.3 * CART.B @ CART.B.T, RN
    found, wanted = estimates(est, Y, U), stream(f, CART, Y, U, form, lambda f: f.x_lag if lag else f.x)
    np.testing.assert_allclose(found[:, 12:], wanted[:, 12:], rtol=0, atol=1e-12)


@given(plants(), spare, st.sampled_from(FORMS))
def test_every_plant_has_the_stream_of_ufir(drawn, extra, form):
    plant, shortest, rng = drawn
    horizon = shortest + extra
    _, Y, U = signals(plant, 3 * horizon, rng)
    est = create_ufir_iosystem(plant, horizon, form=form, feedthrough=True)
    f = configured(UFIRFilter(plant.nstates, plant.noutputs, plant.ninputs, horizon=horizon), plant)
    gap = estimates(est, Y, U)[:, horizon:] - stream(f, plant, Y, U, form)[:, horizon:]
    assert np.abs(gap).max() <= 1e-11 * rounding(est, Y, U)


@given(plants(), spare, st.sampled_from(FORMS))
def test_every_plant_has_the_stream_of_minimum_variance(drawn, extra, form):
    plant, shortest, rng = drawn
    horizon = shortest + extra
    _, Y, U = signals(plant, 3 * horizon, rng)
    q = rng.normal(size=(plant.ninputs, plant.ninputs))
    QN, RN = q @ q.T, np.diag(rng.uniform(0.1, 1.0, plant.noutputs))
    est = create_fms_iosystem(plant, QN, RN, horizon, form=form, feedthrough=True)
    f = configured(FMSFilterSmoother(plant.nstates, plant.noutputs, plant.ninputs, horizon=horizon), plant)
    f.Q, f.R = plant.B @ QN @ plant.B.T, RN
    gap = estimates(est, Y, U)[:, horizon:] - stream(f, plant, Y, U, form)[:, horizon:]
    assert np.abs(gap).max() <= 1e-11 * rounding(est, Y, U)


@given(plants(), spare, st.sampled_from(FORMS), st.integers(0, 3))
def test_without_noise_every_estimate_of_a_full_window_is_the_state(drawn, extra, form, lag):
    plant, shortest, rng = drawn
    horizon = shortest + extra + lag
    X, Y, U = signals(plant, 2 * horizon, rng, noise=0.0)
    try:
        est = create_ufir_iosystem(plant, horizon, form=form, lag=lag, feedthrough=True)
    except ValueError:  # a singular A forgets the state that the lag asks for
        assert abs(np.linalg.det(plant.A)) < 1e-6
        return
    found = estimates(est, Y, U)[:, horizon:]
    size = rounding(est, Y, U)
    assert np.abs(found - X[:, horizon - lag : 2 * horizon - lag]).max() <= 1e-10 * size


@given(plants(), spare)
def test_a_predictor_is_the_filter_one_step_earlier_moved_on(drawn, extra):
    plant, shortest, rng = drawn
    horizon = shortest + extra
    _, Y, U = signals(plant, 2 * horizon, rng)
    late = estimates(create_ufir_iosystem(plant, horizon), Y, U)
    fresh = estimates(create_ufir_iosystem(plant, horizon, form="filter", feedthrough=True), Y, U)
    moved = plant.A @ fresh[:, :-1] + plant.B @ U[:, :-1]
    size = max(1.0, np.abs(moved).max())
    np.testing.assert_allclose(late[:, horizon + 1 :], moved[:, horizon:], rtol=0, atol=1e-10 * size)


def test_a_horizon_of_one_is_a_static_gain_in_filter_form():
    import control as ct

    plant = ct.ss(0.5 * np.eye(2), np.eye(2), [[1.0, 1.0], [0.0, 2.0]], np.zeros((2, 2)), dt=True)
    est = create_ufir_iosystem(plant, 1, form="filter")
    assert est.nstates == 0
    np.testing.assert_allclose(est.D, np.hstack([np.linalg.inv(plant.C), np.zeros((2, 2))]), atol=1e-14)
