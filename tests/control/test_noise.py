"""The error as a linear system of the noises: its norms are the covariances that the gains promise."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.control.plants import CART, estimates, plants
from ufirext import Model, ufir_gain
from ufirext.control import create_fms_iosystem, create_ufir_iosystem, fms, norm, ufir, with_dead_time

FORMS = ("predictor", "filter")


def noises(plant, rng):
    q = rng.normal(size=(plant.ninputs, plant.ninputs))
    return q @ q.T, np.diag(rng.uniform(0.1, 1.0, plant.noutputs))


@given(plants(), st.integers(1, 10), st.sampled_from(FORMS), st.integers(0, 2))
def test_the_squared_norm_of_the_scaled_error_channel_is_the_trace_of_P(drawn, extra, form, lag):
    plant, shortest, rng = drawn
    horizon = shortest + extra + lag
    QN, RN = noises(plant, rng)
    try:
        est = create_fms_iosystem(plant, QN, RN, horizon, lag, form=form, feedthrough=True)
    except ValueError:
        return
    trace = np.trace(fms(plant, QN, RN, horizon, lag, form=form)[1])
    assert ct.norm(est.error_system(QN, RN)) ** 2 == pytest.approx(trace, rel=1e-9)


@given(plants(), st.integers(1, 10), st.sampled_from(FORMS))
def test_for_measurement_noise_alone_it_is_the_trace_of_the_noise_power_gain(drawn, extra, form):
    plant, shortest, _ = drawn
    est = create_ufir_iosystem(plant, shortest + extra, form=form, feedthrough=True)
    error = est.error_system()
    alone = error[:, [f"v[{i}]" for i in range(plant.noutputs)]]
    npg = ufir(plant, shortest + extra, form=form)[1]
    assert ct.norm(alone) ** 2 == pytest.approx(np.trace(npg), rel=1e-9)
    assert np.trace(est.noise_power_gain) == pytest.approx(np.trace(npg), rel=1e-12)


@given(plants(feedthrough=False), st.integers(1, 10))
def test_the_covariance_of_ufir_is_the_exact_one_of_its_gain(drawn, extra):
    plant, shortest, rng = drawn
    QN, RN = noises(plant, rng)
    est = create_ufir_iosystem(plant, shortest + extra, RN, form="filter")
    exact = ufir_gain(Model(plant.A, plant.C, plant.B @ QN @ plant.B.T, RN), shortest + extra).P
    np.testing.assert_allclose(est.covariance(QN, RN), exact, rtol=0, atol=1e-9 * np.abs(exact).max())


@pytest.mark.parametrize("form", FORMS)
def test_the_error_channel_gives_the_error_of_every_run(form):
    plant = ct.ss([[0.9, 0.3], [-0.2, 1.05]], [[1.0], [0.5]], [[1.0, 0.2]], [[0.4]], dt=True)
    rng, steps, horizon = np.random.default_rng(5), 60, 7
    est = create_ufir_iosystem(plant, horizon, form=form, feedthrough=True, G=np.eye(2))
    w, v, U = rng.normal(size=(2, steps)), rng.normal(size=(1, steps)), rng.normal(size=(1, steps))
    x, X, Y = np.zeros(2), [], []
    for k in range(steps):
        X.append(x)
        Y.append(plant.C @ x + plant.D @ U[:, k] + v[:, k])
        x = plant.A @ x + plant.B @ U[:, k] + w[:, k]
    error = np.array(X).T - estimates(est, np.array(Y).T, U)
    channel = ct.input_output_response(est.error_system(), np.arange(steps), np.vstack([w, v])).outputs
    np.testing.assert_allclose(channel[:, horizon:], error[:, horizon:], atol=1e-11)


def test_the_covariance_is_that_of_many_runs():
    QN, RN, horizon, runs = [[0.4]], [[0.05]], 6, 3000
    est = create_ufir_iosystem(CART, horizon, G=CART.B)
    rng = np.random.default_rng(6)
    w = rng.normal(size=(runs, horizon)) * 0.4**0.5
    v = rng.normal(size=(runs, horizon)) * 0.05**0.5
    x, past = np.zeros((runs, 2)), []
    for k in range(horizon):
        past.append(x @ CART.C.T + v[:, k : k + 1])
        x = x @ CART.A.T + w[:, k : k + 1] * CART.B.T
    error = x - np.hstack(past) @ est.K.T
    P, ours = np.cov(error.T), est.covariance(QN, RN)
    bound = 5 * np.sqrt(2 / runs) * np.sqrt(np.outer(np.diag(ours), np.diag(ours)))
    assert (np.abs(P - ours) < bound).all()


def test_minimum_variance_beats_ufir_and_the_steady_kalman_filter_bounds_both():
    QN, RN = [[0.4]], [[0.05]]
    _, P, _ = ct.dlqe(CART, QN, RN)
    best, plain = (
        ct.norm(e) ** 2
        for e in (
            create_fms_iosystem(CART, QN, RN, 8).error_system(QN, RN),
            create_ufir_iosystem(CART, 8).error_system(QN, RN),
        )
    )
    assert np.trace(P) < best < plain


@pytest.mark.parametrize("unit", [1e-12, 1.0, 1e12])
def test_the_h2_norm_of_a_slow_mode_beside_a_fast_one_does_not_depend_on_units(unit):
    """y_n = 0.999 y_{n-1} + w_n has the power 1 / (1 - 0.999^2), in whatever unit its state is."""
    loop = ct.ss(np.diag([0.999, 0.0]), np.diag([unit, 1.0]), [[1.0 / unit, 0.0]], np.zeros((1, 2)), dt=True)
    assert norm(loop) ** 2 == pytest.approx(1.0 / (1.0 - 0.999**2), rel=1e-9)


@settings(max_examples=20)
@given(plants(max_x=3), st.integers(1, 8), st.sampled_from(FORMS))
def test_the_hinfinity_norm_of_the_error_is_the_highest_of_a_fine_grid(drawn, extra, form):
    plant, shortest, rng = drawn
    est = create_ufir_iosystem(plant, shortest + extra, form=form, feedthrough=True)
    error = est.error_system(*noises(plant, rng))
    z = np.exp(1j * np.linspace(0, np.pi, 1001))
    peak = max(
        np.linalg.norm(error.C @ np.linalg.solve(p * np.eye(error.nstates) - error.A, error.B) + error.D, 2)
        for p in z
    )
    found = norm(error, "inf")
    assert peak * (1 - 1e-12) <= found <= peak * (1 + 1e-3)


def test_the_hinfinity_norm_bounds_the_error_of_every_disturbance():
    """Energy gain of 200 steps is below the norm, and close to it for a sinusoid at the peak."""
    error = create_ufir_iosystem(CART, 8).error_system()
    gain, steps = norm(error, "inf"), 400
    rng = np.random.default_rng(7)
    for d in (rng.normal(size=(2, steps)), np.sin(np.outer([0.05, 0.31], np.arange(steps)))):
        e = ct.input_output_response(error, np.arange(steps) * 0.1, d).outputs
        assert np.linalg.norm(e) <= gain * np.linalg.norm(d)


def test_the_hinfinity_norm_of_a_closed_loop_and_of_an_unstable_system():
    est = create_ufir_iosystem(CART, 8)
    K = ct.dlqr(CART, np.eye(2), [[1.0]])[0]
    loop = ct.create_statefbk_iosystem(CART, K, estimator=est)[1]["y[0]", "ud[0]"]
    peak = np.abs(loop(np.exp(1j * np.linspace(0, np.pi, 20001)))).max()
    assert norm(loop, "inf") == pytest.approx(peak, rel=1e-6)
    assert norm(ct.ss(1.0, 1.0, 1.0, 0.0, dt=True), "inf") == np.inf
    assert norm(ct.ss(0.5, 1.0, 1.0, 0.0, dt=True), "inf") == pytest.approx(2.0, rel=1e-12)
    with pytest.raises(ct.ControlArgument, match="discrete-time"):
        norm(ct.ss(-1.0, 1.0, 1.0, 0.0), "inf")


def test_the_hinfinity_norm_uses_slycot_where_it_is_installed(monkeypatch):
    asked = []
    monkeypatch.setattr(ct.exception, "slycot_check", lambda: True)
    monkeypatch.setattr(ct, "norm", lambda sys, p, tol: asked.append((p, tol)) or 3.0)
    assert norm(ct.ss(0.5, 1.0, 1.0, 0.0, dt=True), "inf", tol=1e-5) == 3.0
    assert asked == [("inf", 1e-5)]


@given(plants(kinds=("stable", "singular"), max_x=4))
@settings(max_examples=30)
def test_the_h2_norm_is_that_of_python_control_where_it_has_one(drawn):
    plant, _, _ = drawn
    shrunk = ct.ss(0.5 * plant.A, plant.B, plant.C, plant.D, dt=True)
    taps = [shrunk.D, *(shrunk.C @ np.linalg.matrix_power(shrunk.A, k) @ shrunk.B for k in range(400))]
    assert norm(shrunk) == pytest.approx(np.sqrt((np.array(taps) ** 2).sum()), rel=1e-9)


def test_the_h2_norm_of_a_loop_that_holds_a_signal_twice_is_finite():
    late = with_dead_time(CART, input_delay=4)
    K = ct.dlqr(late, np.eye(6), [[1.0]])[0]
    loop = ct.create_statefbk_iosystem(late, K, estimator=create_ufir_iosystem(late, 17))[1][:, "ud[0]"]
    taps, state = [loop.D], loop.B
    for _ in range(2000):
        taps.append(loop.C @ state)
        state = loop.A @ state
    assert norm(loop) == pytest.approx(np.sqrt((np.array(taps) ** 2).sum()), rel=1e-9)
    with pytest.raises(ct.ControlArgument, match="p=1 not supported"):
        norm(loop, 1)
