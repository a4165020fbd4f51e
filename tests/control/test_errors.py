"""What does not fit is refused in python-control's words, with advice."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest

from tests.control.plants import CART
from ufirext import HorizonError, UnobservableWindow
from ufirext.control import (
    create_delay_kalman_iosystem,
    create_fms_iosystem,
    create_hinfinity_iosystem,
    create_ufir_iosystem,
    fms,
    norm,
    ufir,
    with_dead_time,
)
from ufirext.errors import CovarianceError

CONTINUOUS = ct.ss([[0, 1], [0, -0.2]], [[0], [1]], [[1, 0]], 0)
Q, R = [[1.0]], [[0.1]]
BUILDERS = {
    "ufir": lambda sys, **k: ufir(sys, 8, **k),
    "fms": lambda sys, **k: fms(sys, Q, R, 8, **k),
    "create_ufir_iosystem": lambda sys, **k: create_ufir_iosystem(sys, 8, **k),
    "create_fms_iosystem": lambda sys, **k: create_fms_iosystem(sys, Q, R, 8, **k),
    "create_delay_kalman_iosystem": lambda sys, **k: create_delay_kalman_iosystem(sys, Q, R, **k),
    "create_hinfinity_iosystem": lambda sys, **k: create_hinfinity_iosystem(sys, Q, R, **k),
}
every = pytest.mark.parametrize("name", BUILDERS)


@every
def test_a_continuous_system_is_refused_with_the_call_that_discretises_it(name):
    with pytest.raises(
        ct.ControlArgument, match=rf"{name}\(\) called with a continuous-time system.*ct\.c2d"
    ):
        BUILDERS[name](CONTINUOUS)


@every
def test_a_system_of_unspecified_timebase_is_refused(name):
    with pytest.raises(ct.ControlArgument, match="unspecified timebase"):
        BUILDERS[name](ct.ss(CART.A, CART.B, CART.C, 0, dt=None))


@every
def test_a_static_gain_is_refused(name):
    with pytest.raises(ct.ControlArgument, match=rf"{name}\(\) called with a static gain"):
        BUILDERS[name](ct.ss([], [], [], [[2.0]], dt=0.1))


@every
def test_other_kinds_of_systems_are_refused(name):
    build = BUILDERS[name]
    with pytest.raises(
        ct.ControlArgument, match=r"LTI system must be in state space form, got TransferFunction"
    ):
        build(ct.tf([1.0], [1.0, -0.5], 0.1))
    cart = ct.nlsys(lambda t, x, u, params: x, inputs=1, outputs=1, states=1, dt=0.1)
    with pytest.raises(ct.ControlArgument, match=r"linear I/O system, got NonlinearIOSystem; linearize"):
        build(cart)
    with pytest.raises(ct.ControlArgument, match="linear I/O system, got ndarray"):
        build(np.eye(2))


@every
@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"G": np.eye(3)}, ct.ControlDimension, r"Incompatible dimensions of G matrix; expected \(2, any\)"),
        ({"C": [[1.0, 0.0]]}, ct.ControlDimension, "System output must be full state"),
        ({"control_indices": ["v"]}, ct.ControlArgument, r"names 'v', but the inputs.*\['u\[0\]'\]"),
        ({"control_indices": 2}, ct.ControlArgument, "control_indices is too large; max = 1"),
        ({"disturbance_indices": 1.5}, ct.ControlArgument, "invalid argument for disturbance_indices"),
        ({"form": "corrector"}, ct.ControlArgument, "unknown form 'corrector'"),
    ],
)
def test_options_that_do_not_fit_are_named(name, options, error, words):
    with pytest.raises(error, match=words):
        BUILDERS[name](CART, **options)


@pytest.mark.parametrize(
    "build",
    [
        lambda QN, RN: fms(CART, QN, RN, 8),
        lambda QN, RN: create_fms_iosystem(CART, QN, RN, 8),
        lambda QN, RN: create_delay_kalman_iosystem(CART, QN, RN),
        lambda QN, RN: create_hinfinity_iosystem(CART, QN, RN),
        lambda QN, RN: create_ufir_iosystem(CART, "auto", RN, QN=QN),
    ],
)
def test_covariances_that_do_not_fit_are_named(build):
    with pytest.raises(
        ct.ControlDimension, match=r"dimensions of QN matrix; expected \(1, 1\) but found \(2, 2\)"
    ):
        build(np.eye(2), R)
    with pytest.raises(ct.ControlDimension, match="RN must be a square matrix"):
        build(Q, [[1.0, 2.0]])
    with pytest.raises(CovarianceError, match="QN must be positive semidefinite"):
        build([[-1.0]], R)


def test_a_covariance_must_be_symmetric():
    plant = ct.ss(CART.A, np.eye(2), CART.C, np.zeros((1, 2)), dt=0.1)
    with pytest.raises(ct.ControlArgument, match="QN must be a symmetric matrix"):
        fms(plant, [[1.0, 0.5], [0.0, 1.0]], R, 8)


def test_a_singular_RN_is_refused_by_minimum_variance_only():
    with pytest.raises(CovarianceError, match="RN must be positive definite"):
        fms(CART, Q, [[0.0]], 8)
    assert ufir(CART, 8, [[0.0]])[0].shape == (2, 8)


def test_auto_needs_both_noises():
    with pytest.raises(ct.ControlArgument, match="give QN and RN"):
        create_ufir_iosystem(CART, "auto", R)


def test_a_window_that_is_too_short_names_the_one_that_works():
    with pytest.raises(UnobservableWindow, match="shortest horizon that works is 2"):
        create_ufir_iosystem(CART, 1)
    blind = ct.ss(np.diag([1.1, 0.5]), [[1.0], [1.0]], [[0.0, 1.0]], 0, dt=True)
    with pytest.raises(UnobservableWindow, match="measure another state"):
        create_fms_iosystem(blind, Q, R, 20)


@pytest.mark.parametrize("horizon", [0, 2.5, "long", True])
def test_a_horizon_is_a_count(horizon):
    with pytest.raises(HorizonError, match="horizon must be"):
        create_ufir_iosystem(CART, horizon)


def test_a_lag_lies_in_the_window():
    with pytest.raises(HorizonError, match="lag must be between 0 and 8, got 9"):
        create_ufir_iosystem(CART, 8, lag=9)
    with pytest.raises(HorizonError, match="lag must be between 0 and 7, got 8"):
        create_fms_iosystem(CART, Q, R, 8, lag=8, form="filter")


def test_feedthrough_that_has_no_place_is_refused():
    direct = ct.ss(CART.A, CART.B, CART.C, [[0.5]], dt=0.1)
    with pytest.raises(NotImplementedError, match=r"nonzero 'D' matrix.*delayed"):
        create_delay_kalman_iosystem(direct, Q, R, delay=1)
    noisy = ct.ss(CART.A, np.hstack([CART.B, CART.B]), CART.C, [[0.0, 1.0]], dt=0.1)
    with pytest.raises(NotImplementedError, match="nonzero 'D' matrix for the disturbances"):
        fms(noisy, Q, R, 8, disturbance_indices=1)
    assert ufir(noisy, 8, disturbance_indices=1)[0].shape == (2, 8)


def test_an_input_is_known_or_noise_but_not_both():
    plant = ct.ss(CART.A, np.eye(2), CART.C, np.zeros((1, 2)), dt=0.1)
    with pytest.raises(ct.ControlArgument, match=r"\['u\[1\]'\] were given as both"):
        create_ufir_iosystem(plant, 8, control_indices=[0, 1], disturbance_indices=["u[1]"])


@pytest.mark.parametrize("options", [{"theta": -1.0}, {"theta": "max"}, {"fraction": 1.0}, {"S": [[1.0]]}])
def test_options_of_hinfinity_are_checked(options):
    with pytest.raises((ct.ControlArgument, ct.ControlDimension), match=next(iter(options))):
        create_hinfinity_iosystem(CART, Q, R, **options)


def test_dead_time_is_a_count_of_steps():
    with pytest.raises(HorizonError, match="input_delay"):
        with_dead_time(CART, input_delay=-1)
    with pytest.raises(ct.ControlArgument, match="continuous-time"):
        with_dead_time(CONTINUOUS, 1)
    with pytest.raises(ct.ControlArgument, match="linear I/O system"):
        norm("cart")
