"""A plant with dead time is the plant, later."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.control.plants import CART, plants, signals
from ufirext.control import create_ufir_iosystem, with_dead_time


@settings(max_examples=40)
@given(plants(), st.integers(0, 3), st.integers(0, 3))
def test_its_response_is_the_shifted_one(drawn, inputs, outputs):
    plant, _, rng = drawn
    late = with_dead_time(plant, inputs, outputs)
    U, times = rng.normal(size=(plant.ninputs, 20)), np.arange(20)
    now = ct.input_output_response(plant, times, U, squeeze=False).outputs
    then = ct.input_output_response(late, times, U, squeeze=False).outputs
    shift = inputs + outputs
    np.testing.assert_allclose(then[:, shift:], now[:, : 20 - shift], atol=1e-12 * max(1, np.abs(now).max()))
    assert not then[:, :shift].any()
    assert late.nstates == plant.nstates + inputs * plant.ninputs + outputs * plant.noutputs


def test_names_and_disturbances_are_kept():
    plant = ct.ss(
        CART.A, np.hstack([CART.B, CART.B]), CART.C, 0, dt=0.1, inputs=["force", "gust"], outputs=["position"]
    )
    late = with_dead_time(plant, 2, 1, disturbance_indices=["gust"], name="late")
    assert (late.input_labels, late.output_labels, late.name) == (["force", "gust"], ["position"], "late")
    assert late.state_labels == ["x[0]", "x[1]", "force[k-1]", "force[k-2]", "position[k-1]"]
    pulse = np.zeros((2, 8))
    pulse[:, 0] = 1.0
    states = ct.input_output_response(late, np.arange(8) * 0.1, pulse * [[1], [0]]).states
    assert not states[:2, :3].any()
    assert states[:2, 3].any()
    states = ct.input_output_response(late, np.arange(8) * 0.1, pulse * [[0], [1]]).states
    assert states[:2, 1].any()


@pytest.mark.parametrize(("inputs", "outputs"), [(0, 2), (3, 0), (2, 2)])
def test_ufir_estimates_the_present_state_of_a_plant_with_dead_time(inputs, outputs):
    late = with_dead_time(CART, inputs, outputs)
    X, Y, U = signals(late, 40, np.random.default_rng(0), noise=0.0)
    est = create_ufir_iosystem(late, 10)
    found = ct.input_output_response(est, np.arange(40) * 0.1, np.vstack([Y, U])).outputs
    np.testing.assert_allclose(found[:, 10:], X[:, 10:], atol=1e-9)


def test_a_late_estimate_is_a_fresh_one_predicted_at_the_price_of_a_longer_window():
    """d late measurements of the window only tell what was in the delay line before it."""
    late = with_dead_time(CART, output_delay=3)
    _, Y, U = signals(CART, 50, np.random.default_rng(1))
    times = np.arange(50) * 0.1
    fresh = ct.input_output_response(create_ufir_iosystem(CART, 9), times, np.vstack([Y, U])).outputs
    arriving = np.hstack([np.zeros((1, 3)), Y[:, :-3]])
    est = create_ufir_iosystem(late, 9 + 3)
    found = ct.input_output_response(est, times, np.vstack([arriving, U])).outputs
    moved = fresh[:, :-3]
    for step in range(3):
        moved = CART.A @ moved + CART.B @ U[:, step : step + 47]
    np.testing.assert_allclose(found[:2, 15:], moved[:, 12:], atol=1e-9)
