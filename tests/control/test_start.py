"""The register's initial state from a known x0: right from the first output on."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.control.plants import CART, estimates, plants, signals
from ufirext.control import create_fms_iosystem, create_ufir_iosystem, with_dead_time

FORMS = ("predictor", "filter")


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("lag", [0, 3])
def test_the_first_outputs_are_right_for_any_inputs(form, lag):
    x0 = [2.0, -1.0]
    X, Y, U = signals(CART, 30, np.random.default_rng(0), noise=0.0, x0=x0)
    est = create_ufir_iosystem(CART, 9, form=form, lag=lag)
    found = estimates(est, Y, U, est.initial_state(x0))
    np.testing.assert_allclose(found[:, lag:], X[:, : 30 - lag], atol=1e-11)
    cold = estimates(est, Y, U)
    assert np.abs(cold[:, :8] - X[:, :8]).max() > 0.1


@given(plants(max_x=3), st.integers(1, 6), st.sampled_from(FORMS))
def test_every_state_a_plant_can_be_in_starts_the_register(drawn, extra, form):
    plant, shortest, rng = drawn
    horizon = shortest + extra
    x0 = signals(plant, 2 * horizon, rng, noise=0.0)[0][:, -1]
    assume(np.abs(x0).max() > 1e-3)
    X, Y, U = signals(plant, horizon, rng, noise=0.0, x0=x0)
    est = create_ufir_iosystem(plant, horizon, form=form, feedthrough=True)
    found = estimates(est, Y, U, est.initial_state(x0))
    scale = max(1.0, np.abs(X).max(), np.abs(est.C).max() * np.abs(est.initial_state(x0)).max(initial=0.0))
    np.testing.assert_allclose(found, X, atol=1e-8 * scale)


def test_a_plant_with_dead_time_starts_with_its_delay_lines_filled():
    late = with_dead_time(CART, input_delay=2, output_delay=1)
    est = create_fms_iosystem(late, [[1.0]], [[0.1]], 10)
    x0 = signals(late, 12, np.random.default_rng(1), noise=0.0)[0][:, -1]
    X, Y, U = signals(late, 20, np.random.default_rng(2), noise=0.0, x0=x0)
    np.testing.assert_allclose(estimates(est, Y, U, est.initial_state(x0)), X, atol=1e-10)


def test_a_state_that_no_past_leads_to_is_refused():
    late = with_dead_time(ct.ss(1.0, 1.0, 1.0, 0.0, dt=True), output_delay=1)
    est = create_ufir_iosystem(late, 4, control_indices=[])
    with pytest.raises(ValueError, match="delay line"):
        est.initial_state([1.0, 0.0])
    np.testing.assert_allclose(est.C @ est.initial_state([1.0, 1.0]), [1.0, 1.0])


def test_a_past_beyond_double_precision_is_refused():
    decaying = ct.ss(np.diag([0.3, 1.0]), np.zeros((2, 1)), [[1.0, 1.0]], 0.0, dt=True)
    est = create_ufir_iosystem(decaying, 60)
    with pytest.raises(ValueError, match="x0 must be"):
        est.initial_state([1.0, 1.0])


def test_x0_of_another_length_is_refused():
    with pytest.raises(ct.ControlDimension, match="x0"):
        create_ufir_iosystem(CART, 5).initial_state([1.0])


def test_zero_starts_from_an_empty_register():
    est = create_ufir_iosystem(CART, 5)
    np.testing.assert_array_equal(est.initial_state([0.0, 0.0]), np.zeros(10))
