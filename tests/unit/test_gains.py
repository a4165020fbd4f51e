"""ufir_gain's surface: arguments, errors, immutability, and windows by hand."""

from __future__ import annotations

import copy
import pickle
from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from ufirext import HorizonError, Model, UnobservableWindow, kinematic, ufir_gain
from ufirext.gains import exact_covariance, least_squares, observability_index
from ufirext.window import Row, Window, model_window, whitener

RAMP = kinematic(1, 1, 1.0)


def test_the_gain_of_a_constant_is_the_mean():
    gain = ufir_gain(kinematic(0, 1, 1.0, q=0.0, r=4.0), 8)
    np.testing.assert_allclose(gain.K, np.full((1, 8), 1 / 8), rtol=1e-14)
    assert gain.P[0, 0] == pytest.approx(4.0 / 8)
    assert gain.G[0, 0] == pytest.approx(1 / 8)


def test_shapes_and_names():
    gain = ufir_gain(kinematic(1, 2, 1.0), np.int64(6), lag=2)
    assert gain.K.shape == (4, 12)
    assert gain.G.shape == gain.P.shape == (4, 4)
    assert (gain.horizon, gain.lag) == (6, 2)
    assert repr(gain).startswith("Gain(dim_x=4, rows=12, horizon=6, lag=2, trace_P=")


def test_a_gain_is_read_only():
    gain = ufir_gain(RAMP, 4)
    for name in ("K", "G", "P"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(gain, name)[0, 0] = 1.0
        with pytest.raises(FrozenInstanceError):
            setattr(gain, name, None)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda g: pickle.loads(pickle.dumps(g))])
@pytest.mark.parametrize("looked", [True, False])
def test_a_copy_knows_its_covariance(copied, looked):
    gain = ufir_gain(RAMP, 5)
    if looked:
        assert gain.P.shape == (2, 2)
    twin = copied(gain)
    np.testing.assert_array_equal(twin.K, gain.K)
    np.testing.assert_array_equal(twin.P, gain.P)


@pytest.mark.parametrize("horizon", [3.0, "3", None, True])
def test_a_horizon_that_is_no_integer_is_refused_with_the_shortest_that_works(horizon):
    with pytest.raises(
        HorizonError, match=r"horizon must be an integer, got .* shortest horizon that works is 2"
    ):
        ufir_gain(RAMP, horizon)


@pytest.mark.parametrize("horizon", [0, -5])
def test_a_horizon_below_one_is_refused_with_the_shortest_that_works(horizon):
    with pytest.raises(
        HorizonError, match=f"at least 1, got {horizon}; the shortest horizon that works is 2"
    ):
        ufir_gain(RAMP, horizon)


def test_a_horizon_too_short_is_refused_with_the_shortest_that_works():
    with pytest.raises(UnobservableWindow, match="a window of 2 steps must determine all 3 states") as caught:
        ufir_gain(kinematic(2, 1, 1.0), 2)
    assert (caught.value.rank, caught.value.shortest) == (2, 3)
    twin = pickle.loads(pickle.dumps(caught.value))
    assert (str(twin), twin.rank, twin.shortest) == (str(caught.value), 2, 3)


@pytest.mark.parametrize("lag", [-1, 5, 2.0])
def test_a_lag_outside_the_window_is_refused(lag):
    with pytest.raises(HorizonError, match="lag must be"):
        ufir_gain(RAMP, 5, lag)


def test_a_lagged_state_that_nobody_saw_is_refused_though_the_newest_is_known():
    """F forgets the second state at once: the newest is 0, the one before it is anybody's guess."""
    model = Model([[0.5, 0.0], [0.0, 0.0]], [[1.0, 0.0]])
    assert ufir_gain(model, 4).K[1].tolist() == [0.0] * 4
    with pytest.raises(UnobservableWindow, match="not the one aimed at: choose a smaller lag"):
        ufir_gain(model, 4, lag=3)


@pytest.mark.parametrize(("order", "nu"), [(0, 1), (1, 2), (2, 3)])
def test_the_observability_index_of_polynomials(order, nu):
    assert observability_index(kinematic(order, 3, 0.1)) == nu


def test_an_unseen_mode_that_is_outgrown_stays_unknown():
    """The ratio of the modes falls below every tolerance; the offset of x_2 is unknown all the same."""
    model = Model([[1.15, 0.0], [1.0, 1.0]], [[1.0, 0.0]])
    assert observability_index(model) is None
    with pytest.raises(UnobservableWindow, match="no horizon determines it"):
        ufir_gain(model, 190)
    assert not model_window(model, 190).determined()


def test_an_unseen_mode_that_decays_stays_unknown():
    model = Model([[1.0, 0.0], [0.4, 0.7]], [[1.0, 0.0]])
    assert observability_index(model) is None
    assert not model_window(model, 190).determined()


def test_changing_transitions_may_forget_one_direction_after_the_other():
    """x_2 is annihilated by the first transition, x_3 by the second: only then is the newest state known."""
    first, second = np.diag([1.0, 0.0, 1.0]), np.diag([1.0, 1.0, 0.0])
    H, R = np.array([[1.0, 0.0, 0.0]]), np.eye(1)
    for transitions, known in (([first, first], False), ([first, second], True), ([second, first], True)):
        window = Window(transitions, [np.zeros((3, 3))] * 2, [H] * 3, [R] * 3, [0, 1, 2], aim=2)
        assert window.determined() is known


def test_rows_are_weighted_by_their_noise():
    """Two rows of one constant: the mean weighted by 1/R, and the variance that goes with it."""
    one = np.eye(1)
    window = Window([one], [0 * one], [one, one], [one, 4 * one], [0, 1], aim=1)
    K = least_squares(window)
    np.testing.assert_allclose(K, [[0.8, 0.2]], rtol=1e-14)
    assert exact_covariance(window, K)[0, 0] == pytest.approx(0.8)


def test_correlated_noise_is_whitened():
    R = np.array([[2.0, 1.0], [1.0, 1.0]])
    np.testing.assert_allclose(whitener(R) @ R @ whitener(R).T, np.eye(2), atol=1e-14)


@pytest.mark.parametrize("R", [np.zeros((2, 2)), np.diag([1.0, 0.0]), np.ones((2, 2)), np.zeros((1, 1))])
def test_a_singular_noise_covariance_still_gives_weights(R):
    W = whitener(R)
    assert np.isfinite(W).all()
    assert np.linalg.matrix_rank(W) == len(R)


def test_a_perfect_measurement_wins():
    model = Model(np.eye(2), np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), R=np.diag([1.0, 0.0, 1.0]))
    gain = ufir_gain(model, 1)
    np.testing.assert_allclose(gain.K[0], [0.0, 1.0, 0.0], atol=1e-11)
    assert gain.P[0, 0] <= 1e-11


def test_the_information_of_a_row_is_its_squared_signal_to_noise():
    row = Row(0, 0, np.array([[2.0, 0.0]]), np.array([[4.0]]), np.zeros(1))
    assert row.information == pytest.approx(1.0)


def test_a_window_may_aim_beyond_its_rows_and_before_its_end():
    window = model_window(RAMP, 4)
    ahead = Window([RAMP.F] * 6, [RAMP.Q] * 6, window.H, window.R, window.origins, aim=6)
    np.testing.assert_allclose(
        least_squares(ahead), np.linalg.matrix_power(RAMP.F, 3) @ ufir_gain(RAMP, 4).K, atol=1e-13
    )
    np.testing.assert_allclose(
        least_squares(model_window(RAMP, 4, lag=3)), ufir_gain(RAMP, 4, lag=3).K, atol=1e-14
    )


def test_a_chain_of_delays_forgets_what_a_single_component_left_unknown():
    """Rows with holes in a delay-augmented plant: the oldest copies stay unknown, F drops them at once."""
    F = np.array([[1.0, -0.13, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]])
    H = np.array([[-0.54, 0.36, 1.3, 0.95], [-0.7, -1.27, -0.62, 0.04]])
    rows = [H[1:], H[1:], H]
    window = Window([F] * 3, [np.eye(4)] * 3, rows, [np.eye(len(r)) for r in rows], [0, 2, 3], aim=3)
    assert window.rank == 3
    assert window.determined()
    x = np.array([1.0, 2.0, -3.0, 4.0])
    Z = np.concatenate([H[1:] @ x, H[1:] @ F @ F @ x, H @ F @ F @ F @ x])
    np.testing.assert_allclose(least_squares(window) @ Z, F @ F @ F @ x, atol=1e-10)
