"""Everything python-control does with systems works: loops stay linear, simulate, plot and have norms."""

from __future__ import annotations

import control as ct
import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.control.plants import CART, estimates, plants, signals
from ufirext.control import create_fms_iosystem, create_ufir_iosystem, with_dead_time

mpl.use("Agg")

FEEDBACK = ct.dlqr(CART, np.diag([10.0, 1.0]), [[1.0]])[0]


def closed(est, plant=CART, K=FEEDBACK):
    return ct.create_statefbk_iosystem(plant, K, estimator=est)[1]


@pytest.mark.parametrize("form", ["predictor", "filter"])
def test_state_feedback_over_the_estimator_stays_linear_and_keeps_its_poles(form):
    est = create_ufir_iosystem(CART, 8, form=form)
    loop = closed(est)
    assert isinstance(loop, ct.StateSpace)
    poles = loop.poles()
    wanted = np.linalg.eigvals(CART.A - CART.B @ FEEDBACK)
    largest = poles[np.argsort(-np.abs(poles))]
    np.testing.assert_allclose(np.sort_complex(largest[:2]), np.sort_complex(wanted), atol=1e-9)
    # The others lie at 0, as far as the eigenvalues of a nilpotent part can be computed.
    assert np.abs(largest[2:]).max() < np.finfo(float).eps ** (1 / est.nstates) * 2


@given(plants(feedthrough=False, max_x=3), st.integers(1, 5))
def test_the_characteristic_polynomial_separates(drawn, extra):
    plant, shortest, rng = drawn
    K = rng.normal(size=(plant.ninputs, plant.nstates))
    est = create_ufir_iosystem(plant, shortest + extra)
    loop = closed(est, plant, K)
    # det(zI - loop) = det(zI - A + BK) z^(cells), compared where nothing is ill conditioned: far outside.
    radius = 3.0 * max(1.0, np.abs(np.linalg.eigvals(loop.A)).max())
    for angle in (0.3, 1.7, 3.0):
        z = radius * np.exp(1j * angle)
        whole = np.linalg.slogdet(np.eye(loop.nstates) - loop.A / z)
        feedback = np.linalg.slogdet(np.eye(plant.nstates) - (plant.A - plant.B @ K) / z)
        assert abs(whole[0] * np.exp(whole[1]) - feedback[0] * np.exp(feedback[1])) < 1e-8


def test_a_loop_without_noise_follows_state_feedback_exactly():
    est = create_ufir_iosystem(CART, 8)
    x0 = np.array([1.0, -0.5])
    loop, times = closed(est), np.arange(60) * 0.1
    start = np.concatenate([x0, est.initial_state(x0)])
    response = ct.input_output_response(loop, times, np.zeros((3, 60)), start)
    x, wanted = x0, []
    for _ in times:
        wanted.append(x)
        x = (CART.A - CART.B @ FEEDBACK) @ x
    np.testing.assert_allclose(response.states[:2], np.array(wanted).T, atol=1e-12)


def test_interconnect_by_signal_names_is_the_loop_of_create_statefbk_iosystem():
    est = create_ufir_iosystem(CART, 8, name="est")
    plant = ct.ss(CART, name="cart")
    feedback = ct.ss([], [], [], -FEEDBACK, dt=0.1, inputs=est.output_labels, outputs="u_fb", name="K")
    total = ct.summing_junction(["r", "u_fb"], "u[0]", name="sum")
    loop = ct.interconnect([plant, est, feedback, total], inputs="r", outputs="y[0]")
    assert isinstance(loop, ct.StateSpace)
    statefbk = closed(est)
    omega = np.array([0.1, 1.0, 10.0])
    same = ct.frequency_response(statefbk["y[0]", "ud[0]"], omega).complex
    np.testing.assert_allclose(ct.frequency_response(loop, omega).complex, same, rtol=1e-9)


def test_noise_reaches_the_loop_as_it_reaches_the_error():
    """With u = -K xhat the plant is driven by B K e: the variance of x follows from the error channel."""
    est = create_fms_iosystem(CART, [[0.4]], [[0.05]], 12, name="est")
    noisy = ct.ss(
        CART.A,
        np.hstack([CART.B, CART.B, np.zeros((2, 1))]),
        np.vstack([CART.C, np.eye(2)]),
        np.array([[0, 0, 1], [0, 0, 0], [0, 0, 0]]),
        dt=0.1,
        inputs=["u[0]", "w", "v"],
        outputs=["y[0]", "position", "speed"],
        name="cart",
    )
    feedback = ct.ss([], [], [], -FEEDBACK, dt=0.1, inputs=est.output_labels, outputs="u[0]", name="K")
    loop = ct.interconnect([noisy, est, feedback], inputs=["w", "v"], outputs=["position", "speed"])
    scaled = loop * ct.ss([], [], [], np.diag([0.4**0.5, 0.05**0.5]), dt=0.1)
    error = est.error_system([[0.4]], [[0.05]])
    direct = ct.ss(
        np.block([[CART.A - CART.B @ FEEDBACK, CART.B @ FEEDBACK @ error.C], [np.zeros((24, 2)), error.A]]),
        np.vstack([np.hstack([CART.B * 0.4**0.5, np.zeros((2, 1))]) + CART.B @ FEEDBACK @ error.D, error.B]),
        np.hstack([np.eye(2), np.zeros((2, 24))]),
        0,
        dt=0.1,
    )
    assert ct.norm(scaled) == pytest.approx(ct.norm(direct), rel=1e-9)


def test_bode_nyquist_and_singular_values_of_estimator_and_loop_are_drawn():
    import matplotlib.pyplot as plt

    est = create_ufir_iosystem(CART, 8)
    for system in (est, closed(est)["y[0]", "ud[0]"]):
        ct.bode_plot(system)
        ct.singular_values_plot(system)
    ct.nyquist_plot(closed(est)["y[0]", "ud[0]"])
    plt.close("all")


def test_a_filter_of_a_plant_with_feedthrough_is_a_loop_that_python_control_refuses():
    plant = ct.ss(CART.A, CART.B, CART.C, [[0.5]], dt=0.1)
    with pytest.raises(NotImplementedError, match="algebraic loop"):
        create_ufir_iosystem(plant, 8, form="filter")
    with pytest.raises(NotImplementedError, match="algebraic loop"):
        create_fms_iosystem(plant, [[1]], [[1]], 8, form="filter")
    est = create_ufir_iosystem(plant, 8, form="filter", feedthrough=True)
    with pytest.raises(RuntimeError, match="algebraic loop"):
        closed(est, plant)
    X, Y, U = signals(plant, 30, np.random.default_rng(0), noise=0.0)
    np.testing.assert_allclose(estimates(est, Y, U)[:, 8:], X[:, 8:], atol=1e-11)
    assert isinstance(closed(create_ufir_iosystem(plant, 8), plant), ct.StateSpace)


def test_dead_time_in_input_and_output_is_closed_around():
    late = with_dead_time(CART, input_delay=3, output_delay=2)
    K, *_ = ct.dlqr(late, np.diag([10.0, 1.0, 0, 0, 0, 0, 0]), [[1.0]])
    est = create_ufir_iosystem(late, 14)
    loop = closed(est, late, K)
    times, start = np.arange(300) * 0.1, np.zeros(loop.nstates)
    start[0] = 1.0
    response = ct.input_output_response(loop, times, np.zeros((8, 300)), start)
    assert np.abs(response.states[:7, -1]).max() < 1e-3
    assert np.abs(np.linalg.eigvals(late.A)).min() == 0.0


def test_integral_action_over_the_estimator():
    gain = ct.dlqr(CART, np.diag([10.0, 1.0, 1.0]), [[1.0]], integral_action=CART.C)[0]
    est = create_ufir_iosystem(CART, 8)
    _, loop = ct.create_statefbk_iosystem(CART, gain, integral_action=CART.C, estimator=est)
    assert np.abs(loop.poles()).max() < 1.0
    times = np.arange(400) * 0.1
    target = np.vstack([np.ones(400), np.zeros((2, 400))])
    response = ct.input_output_response(loop, times, target)
    assert response.outputs[0, -1] == pytest.approx(1.0, abs=1e-3)


def test_the_systems_copy_rename_and_pickle():
    import copy
    import pickle

    est = create_ufir_iosystem(CART, 5, name="est")
    for twin in (copy.deepcopy(est), est.copy(name="twin"), ct.ss(est, name="third")):
        np.testing.assert_array_equal(twin.C, est.C)
        assert twin.input_labels == est.input_labels
    assert est.name == "est"
    with pytest.raises((AttributeError, pickle.PicklingError)):  # no StateSpace of python-control does
        pickle.dumps(est)


def test_the_disturbances_stay_inputs_of_the_closed_loop():
    blown = ct.ss(CART.A, np.hstack([CART.B, CART.B]), CART.C, 0, dt=0.1, inputs=["force", "gust"])
    est = create_ufir_iosystem(blown, 8, disturbance_indices=["gust"])
    _, loop = ct.create_statefbk_iosystem(blown, FEEDBACK, estimator=est, control_indices=["force"])
    assert loop.input_labels == ["xd[0]", "xd[1]", "ud[0]", "gust"]
    np.testing.assert_allclose(
        ct.dcgain(loop["y[0]", "gust"]),
        # In the end force = -K xhat, and xhat is off by what a constant gust makes of it.
        static_gain(est),
        rtol=1e-8,
    )


def static_gain(est):
    """Position per constant gust: x = A x + B (w - K (x - e)),  e = error for that gust."""
    e = ct.dcgain(est.error_system()[:, "w[0]"]).reshape(2, 1)
    x = np.linalg.solve(np.eye(2) - CART.A + CART.B @ FEEDBACK, CART.B + CART.B @ FEEDBACK @ e)
    return x[0, 0]


def test_the_frequency_response_of_minimum_variance_goes_to_that_of_kalman():
    QN, RN, omega = [[0.4]], [[0.05]], np.geomspace(0.05, 31.0, 60)
    L, *_ = ct.dlqe(CART, QN, RN)
    kalman = ct.ss(CART.A - L @ CART.C, np.hstack([L, CART.B]), np.eye(2), 0, dt=0.1)
    wanted = ct.frequency_response(kalman, omega).complex
    gaps = []
    for horizon in (10, 20, 40, 80, 160):
        found = ct.frequency_response(create_fms_iosystem(CART, QN, RN, horizon), omega).complex
        gaps.append(np.abs(found - wanted).max())
    assert gaps == sorted(gaps, reverse=True)
    assert gaps[-1] < 1e-7
