"""From a StateSpace to every filter class and back."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest
from hypothesis import given

from tests.control.plants import CART, plants
from ufirext import DelayHInfinityFilter, DelayKalmanFilter, FMSFilterSmoother, UFIRFilter, discretise
from ufirext.control import create_fms_iosystem, to_statespace

OPTIONS = {
    UFIRFilter: {"horizon": 9},
    FMSFilterSmoother: {"horizon": 9, "lag": 2},
    DelayKalmanFilter: {"max_delay": 2, "method": "augmented"},
    DelayHInfinityFilter: {"theta": 0.01},
}
every = pytest.mark.parametrize("kind", OPTIONS)
CONTINUOUS = ct.ss([[0, 1], [0, -0.2]], [[0], [1]], [[1, 0]], 0, inputs=["force"], outputs=["position"])


@every
def test_matrices_noises_and_options_arrive(kind):
    f = kind.from_statespace(CART, [[0.5]], [[0.02]], **OPTIONS[kind])
    assert type(f) is kind
    np.testing.assert_array_equal(f.F, CART.A)
    np.testing.assert_array_equal(f.B, CART.B)
    np.testing.assert_array_equal(f.H, CART.C)
    np.testing.assert_allclose(f.Q, 0.5 * CART.B @ CART.B.T)
    np.testing.assert_array_equal(f.R, [[0.02]])
    f.predict(1.0)
    f.update(0.3)
    assert np.isfinite(f.x).all()


@every
def test_a_continuous_system_is_discretised_with_its_noise_where_dt_is_given(kind):
    f = kind.from_statespace(CONTINUOUS, [[0.5]], [[0.02]], dt=0.25, **OPTIONS[kind])
    sampled = ct.c2d(CONTINUOUS, 0.25)
    F, Q = discretise(CONTINUOUS.A, CONTINUOUS.B, [[0.5]], 0.25)
    np.testing.assert_allclose(f.F, F, atol=1e-14)
    np.testing.assert_allclose(f.F, sampled.A, atol=1e-14)
    np.testing.assert_allclose(f.B, sampled.B, atol=1e-14)
    np.testing.assert_allclose(f.Q, Q, atol=1e-14)
    assert np.linalg.matrix_rank(f.Q) == 2  # the noise of a step reaches every state, Q = G QN G' would not


@every
def test_a_continuous_system_without_dt_is_refused_with_the_call(kind):
    name = kind.__name__
    with pytest.raises(
        ct.ControlArgument, match=rf"pass dt.*{name}\.from_statespace\(sys, QN, RN, dt=\.\.\.\)"
    ):
        kind.from_statespace(CONTINUOUS, [[0.5]], [[0.02]], **OPTIONS[kind])


def test_disturbance_inputs_become_G():
    plant = ct.ss(CART.A, np.hstack([CART.B, np.eye(2)]), CART.C, np.zeros((1, 3)), dt=0.1)
    Q = np.array([[0.2, 0.05], [0.05, 0.1]])
    f = UFIRFilter.from_statespace(plant, Q, [[1.0]], disturbance_indices=2, horizon=6)
    np.testing.assert_array_equal(f.B, CART.B)
    np.testing.assert_allclose(f.Q, Q)
    silent = UFIRFilter.from_statespace(plant, Q, [[1.0]], control_indices=[], G=np.eye(2), horizon=6)
    assert silent.B is None
    half = ct.ss(CONTINUOUS.A, CONTINUOUS.B, np.eye(2), np.zeros((2, 1)))
    picked = UFIRFilter.from_statespace(half, C=[[1.0, 0.0]], dt=0.1, horizon=6)
    np.testing.assert_array_equal(picked.H, [[1.0, 0.0]])


def test_what_does_not_fit_is_refused():
    with pytest.raises(NotImplementedError, match=r"nonzero 'D' matrix.*update\(y - D @ u\)"):
        UFIRFilter.from_statespace(ct.ss(CART.A, CART.B, CART.C, 1.0, dt=0.1), horizon=6)
    with pytest.raises(ct.ControlArgument, match=r"dt=0.2 and a discrete-time system with dt=0.1"):
        UFIRFilter.from_statespace(CART, dt=0.2, horizon=6)
    with pytest.raises(ct.ControlArgument, match="positive number of seconds, got -1"):
        UFIRFilter.from_statespace(CONTINUOUS, dt=-1, horizon=6)
    with pytest.raises(ct.ControlArgument, match="static gain"):
        UFIRFilter.from_statespace(ct.ss([], [], [], [[1.0]]), dt=1.0, horizon=6)
    with pytest.raises(ct.ControlDimension, match="QN"):
        UFIRFilter.from_statespace(CART, np.eye(3), horizon=6)
    assert UFIRFilter.from_statespace(CART, dt=0.1, horizon=6).horizon == 6


def test_a_system_of_unspecified_step_takes_any_dt():
    plant = ct.ss(CART.A, CART.B, CART.C, 0, dt=True)
    assert UFIRFilter.from_statespace(plant, dt=0.3, horizon=6).horizon == 6


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        (UFIRFilter, {}),
        (UFIRFilter, {"horizon": "auto"}),
        (FMSFilterSmoother, {"horizon": 9}),
        (DelayKalmanFilter, {}),
        (DelayHInfinityFilter, {"theta": 0.01}),
    ],
)
@pytest.mark.parametrize("noises", [{}, {"QN": [[0.5]]}, {"RN": [[0.02]]}])
@pytest.mark.parametrize(("plant", "step"), [(CART, None), (CONTINUOUS, 0.25)])
def test_noises_that_a_filter_weighs_must_be_given(kind, options, noises, plant, step):
    with pytest.raises(ct.ControlArgument, match=rf"{kind.__name__}.*weighs .*: give QN and RN"):
        kind.from_statespace(plant, **noises, dt=step, **options)


@pytest.mark.parametrize("horizon", [6, "adaptive"])
def test_least_squares_need_no_noises(horizon):
    f = UFIRFilter.from_statespace(CART, horizon=horizon)
    for z in range(20):
        f.predict(0.0)
        f.update(0.2 * z)
    np.testing.assert_allclose(f.x.ravel(), [3.8, 2.0], rtol=0.2)


@given(plants(feedthrough=False))
def test_there_and_back_is_the_plant(drawn):
    plant, _, _ = drawn
    noises = np.eye(plant.ninputs), np.eye(plant.noutputs)
    f = FMSFilterSmoother.from_statespace(plant, *noises, horizon=30)
    back = to_statespace(f)
    for name in "ABCD":
        np.testing.assert_array_equal(getattr(back, name), getattr(plant, name))
    assert back.input_labels == plant.input_labels
    assert back.isdtime(strict=True)


def test_back_with_process_noise_and_there_again():
    f = UFIRFilter.from_statespace(CART, [[0.5]], [[0.02]], horizon=9)
    noisy = to_statespace(f, dt=0.1, disturbances=True)
    assert noisy.input_labels == ["u[0]", "w[0]", "w[1]"]
    again = UFIRFilter.from_statespace(noisy, f.Q, f.R, disturbance_indices=2, horizon=9)
    np.testing.assert_array_equal(again.B, f.B)
    np.testing.assert_allclose(again.Q, f.Q)
    est = create_fms_iosystem(noisy, f.Q, f.R, 9, disturbance_indices=2)
    direct = create_fms_iosystem(CART, [[0.5]], [[0.02]], 9)
    np.testing.assert_allclose(est.C, direct.C, atol=1e-10)


def test_a_filter_without_inputs_becomes_a_system_driven_by_noise():
    f = UFIRFilter(2, 1, horizon=5)
    f.F, f.H = CART.A, CART.C
    plant = to_statespace(f, dt=0.1)
    assert plant.input_labels == ["w[0]", "w[1]"]
    np.testing.assert_array_equal(plant.B, np.eye(2))
    with pytest.raises(ValueError, match="has no B"):
        to_statespace(f, disturbances=False)


def test_a_filter_of_filterpy_becomes_a_plant():
    from filterpy.kalman import KalmanFilter

    kf = KalmanFilter(2, 1, 1)
    kf.F, kf.H, kf.B = CART.A, CART.C, CART.B
    np.testing.assert_array_equal(to_statespace(kf).A, CART.A)
