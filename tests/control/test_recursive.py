"""The Kalman and H-infinity systems are python-control's estimator, and the filters with delays."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.control.plants import CART, configured, estimates, plants, signals
from ufirext import DelayHInfinityFilter, DelayKalmanFilter, ThetaTooLarge
from ufirext.control import create_delay_kalman_iosystem, create_hinfinity_iosystem, with_dead_time

QN, RN = [[0.4]], [[0.05]]
P0 = np.array([[2.0, 0.3], [0.3, 1.0]])


def with_age(est, Y, U, ages, X0):
    times = np.arange(Y.shape[1]) * float(est.dt)
    return ct.input_output_response(est, times, np.vstack([Y, U, ages]), X0, squeeze=False).outputs


def late(Y, delay):
    """What arrives: the measurement `delay` steps ago, zeros before the first."""
    return np.hstack([np.zeros((len(Y), delay)), Y[:, : Y.shape[1] - delay]])


@given(plants(feedthrough=False), st.booleans())
@settings(max_examples=30)
def test_without_delay_it_is_create_estimator_iosystem(drawn, correct):
    plant, _, rng = drawn
    q = rng.normal(size=(plant.ninputs, plant.ninputs))
    noise = q @ q.T, np.diag(rng.uniform(0.1, 1.0, plant.noutputs))
    P = np.diag(rng.uniform(0.5, 2.0, plant.nstates))
    theirs = ct.create_estimator_iosystem(plant, *noise, P)
    ours = create_delay_kalman_iosystem(plant, *noise, P)
    assert ours.state_labels == theirs.state_labels
    assert ours.input_labels == theirs.input_labels
    assert ours.output_labels == theirs.output_labels
    _, Y, U = signals(plant, 25, rng)
    x0 = rng.normal(size=plant.nstates)
    start = ours.initial_state(x0)
    np.testing.assert_array_equal(start, np.concatenate([x0, P.reshape(-1)]))
    options = {"params": {"correct": correct}}
    found, wanted = (estimates(est, Y, U, start, **options) for est in (ours, theirs))
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9 * max(1.0, np.abs(wanted).max()))


@pytest.mark.parametrize("form", ["predictor", "filter"])
@pytest.mark.parametrize("delay", [0, 1, 4])
def test_with_a_delay_it_is_the_augmented_filter(form, delay):
    _, Y, U = signals(CART, 50, np.random.default_rng(0))
    est = create_delay_kalman_iosystem(CART, QN, RN, P0, delay=delay, form=form)
    found = estimates(est, late(Y, delay), U, est.initial_state([1.0, -1.0]))
    f = configured(DelayKalmanFilter(2, 1, 1, max_delay=delay, method="augmented"), CART)
    f.Q, f.R, f.x, f.P = 0.4 * CART.B @ CART.B.T, RN, [1.0, -1.0], P0
    wanted = []
    for k in range(50):
        if k:
            f.predict(U[:, k - 1])
        before = f.x.ravel().copy()
        if k >= delay:
            f.update(Y[:, k - delay], delay=delay)
        wanted.append(before if form == "predictor" else f.x.ravel().copy())
    np.testing.assert_allclose(found, np.array(wanted).T, atol=1e-12)


def test_stamped_measurements_may_come_late_out_of_order_or_never():
    _, Y, U = signals(CART, 50, np.random.default_rng(1))
    ages = np.random.default_rng(2).integers(-1, 4, 50)
    ages = np.minimum(ages, np.arange(50))
    arriving = np.array([[Y[0, k - max(ages[k], 0)] for k in range(50)]])
    est = create_delay_kalman_iosystem(CART, QN, RN, P0, delay=3, stamped=True, form="filter")
    found = with_age(est, arriving, U, ages, est.initial_state())
    f = configured(DelayKalmanFilter(2, 1, 1, max_delay=3, method="augmented"), CART)
    f.Q, f.R, f.P = 0.4 * CART.B @ CART.B.T, RN, P0
    wanted = []
    for k in range(50):
        if k:
            f.predict(U[:, k - 1])
        if ages[k] >= 0:
            f.update(arriving[:, k], delay=int(ages[k]))
        wanted.append(f.x.ravel().copy())
    np.testing.assert_allclose(found, np.array(wanted).T, atol=1e-12)


def test_a_delayed_measurement_and_a_plant_with_that_dead_time_are_the_same():
    _, Y, U = signals(CART, 40, np.random.default_rng(3))
    est = create_delay_kalman_iosystem(CART, QN, RN, P0, delay=2)
    plant = with_dead_time(CART, output_delay=2)
    other = create_delay_kalman_iosystem(plant, QN, RN)
    arrived = late(Y, 2)
    found = estimates(est, arrived, U, est.initial_state([0, 0], P0))
    start = other.initial_state(np.zeros(4), np.pad(P0, (0, 2)))
    np.testing.assert_allclose(found, estimates(other, arrived, U, start)[:2], atol=1e-9)


def test_nan_components_are_missing():
    plant = ct.ss(CART.A, CART.B, np.eye(2), 0, dt=0.1)
    R = np.diag([0.05, 0.5])
    est = create_delay_kalman_iosystem(plant, QN, R, P0)
    state = est.initial_state([1.0, 0.0])
    half = est.dynamics(0, state, np.array([1.2, np.nan, 0.3]))
    alone = create_delay_kalman_iosystem(CART, QN, RN, P0).dynamics(0, state, np.array([1.2, 0.3]))
    np.testing.assert_allclose(half, alone, atol=1e-14)
    nothing = est.dynamics(0, state, np.array([np.nan, np.nan, 0.3]))
    np.testing.assert_allclose(nothing[:2], CART.A @ [1.0, 0.0] + CART.B @ [0.3])


@pytest.mark.parametrize(("form", "bounded"), [("predictor", "prior"), ("filter", "posterior")])
@pytest.mark.parametrize("delay", [0, 2])
@pytest.mark.parametrize("theta", ["auto", 0.0, 0.05])
def test_the_hinfinity_system_is_the_filter_of_its_form(form, bounded, delay, theta):
    _, Y, U = signals(CART, 40, np.random.default_rng(4))
    S = np.diag([1.0, 0.1])
    options = {"theta": theta, "S": S}
    est = create_hinfinity_iosystem(CART, QN, RN, P0, delay=delay, stamped=True, form=form, **options)
    ages = np.where(np.arange(40) >= delay, delay, -1)
    found = with_age(est, late(Y, delay), U, ages, est.initial_state([1.0, -1.0]))
    f = configured(DelayHInfinityFilter(2, 1, 1, max_delay=delay, form=bounded, **options), CART)
    f.Q, f.R, f.x, f.P = 0.4 * CART.B @ CART.B.T, RN, [1.0, -1.0], P0
    wanted = []
    for k in range(40):
        if k:
            f.predict(U[:, k - 1])
        before = f.x.ravel().copy()
        if k >= delay:
            f.update(Y[:, k - delay], delay=delay)
        else:
            f.update(None)
        wanted.append(before if form == "predictor" else f.x.ravel().copy())
    np.testing.assert_allclose(found, np.array(wanted).T, atol=1e-11)


def test_theta_zero_is_the_kalman_system_and_theta_auto_is_another():
    _, Y, U = signals(CART, 40, np.random.default_rng(5))
    kalman = create_delay_kalman_iosystem(CART, QN, RN, P0)
    start = kalman.initial_state()
    wanted = estimates(kalman, Y, U, start)
    zero = estimates(create_hinfinity_iosystem(CART, QN, RN, P0, theta=0.0), Y, U, start)
    auto = estimates(create_hinfinity_iosystem(CART, QN, RN, P0), Y, U, start)
    np.testing.assert_allclose(zero, wanted, atol=1e-12)
    assert np.abs(auto - wanted).max() > 1e-3


@pytest.mark.parametrize("form", ["predictor", "filter"])
def test_the_bound_holds_for_its_own_output(form):
    theta, rng = 0.2, np.random.default_rng(6)
    est = create_hinfinity_iosystem(CART, QN, RN, P0, theta=theta, form=form)
    e0, steps = rng.normal(size=2), 60
    w, v = rng.normal(size=steps), 0.3 * np.sin(0.2 * np.arange(steps))
    x, X, Y = e0, [], []
    for k in range(steps):
        X.append(x)
        Y.append(CART.C @ x + v[k])
        x = CART.A @ x + CART.B[:, 0] * w[k]
    found = estimates(est, np.array(Y).T, np.zeros((1, steps)), est.initial_state([0.0, 0.0]))
    energy = e0 @ np.linalg.solve(P0, e0) + w @ w / 0.4 + v @ v / 0.05
    assert theta * ((np.array(X).T - found) ** 2).sum() < energy


def test_theta_beyond_its_limit_is_refused_in_the_simulation_with_its_step():
    _, Y, U = signals(CART, 20, np.random.default_rng(7))
    est = create_hinfinity_iosystem(CART, QN, RN, 0.001 * P0, theta=20.0)
    with pytest.raises(ThetaTooLarge) as caught:
        estimates(est, Y, U, est.initial_state())
    assert caught.value.step > 0
    assert caught.value.theta == 20.0 > caught.value.theta_max


def test_the_default_start_is_the_steady_state():
    est = create_delay_kalman_iosystem(CART, QN, RN)
    _, P, _ = ct.dlqe(CART, QN, RN)
    np.testing.assert_allclose(est.initial_state()[2:].reshape(2, 2), P, atol=1e-12)
    blind = ct.ss(np.diag([1.1, 0.5]), [[1.0], [1.0]], [[0.0, 1.0]], 0, dt=True)
    with pytest.raises(ct.ControlArgument, match="give P0"):
        create_delay_kalman_iosystem(blind, QN, RN).initial_state()


def test_they_close_loops_as_python_controls_estimator_does():
    K = ct.dlqr(CART, np.eye(2), [[1.0]])[0]
    times, target = np.arange(80) * 0.1, np.vstack([np.ones(80), np.zeros((2, 80))])
    outputs = []
    for est in (
        ct.create_estimator_iosystem(CART, np.array(QN), np.array(RN)),
        create_delay_kalman_iosystem(CART, QN, RN),
        create_hinfinity_iosystem(CART, QN, RN, theta=0.0),
    ):
        _, loop = ct.create_statefbk_iosystem(CART, K, estimator=est)
        start = np.concatenate([[0.5, 0.0, 0.0, 0.0], P0.reshape(-1)])
        outputs.append(ct.input_output_response(loop, times, target, start).outputs)
    np.testing.assert_allclose(outputs[1], outputs[0], atol=1e-10)
    np.testing.assert_allclose(outputs[2], outputs[0], atol=1e-10)


@pytest.mark.parametrize("create", [create_delay_kalman_iosystem, create_hinfinity_iosystem])
def test_feedthrough_is_no_obstacle_to_a_predictor(create):
    direct = ct.ss(CART.A, CART.B, CART.C, [[0.7]], dt=0.1)
    _, Y, U = signals(CART, 30, np.random.default_rng(8))
    est, plain = create(direct, QN, RN, P0), create(CART, QN, RN, P0)
    start = est.initial_state()
    np.testing.assert_allclose(
        estimates(est, Y + 0.7 * U, U, start), estimates(plain, Y, U, start), atol=1e-12
    )
    with pytest.raises(NotImplementedError, match="algebraic loop"):
        create(direct, QN, RN, P0, form="filter")
    assert create(direct, QN, RN, P0, form="filter", feedthrough=True).form == "filter"
