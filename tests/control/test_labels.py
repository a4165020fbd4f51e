"""Labels, indices, C and name are python-control's."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest

from tests.control.plants import CART
from ufirext.control import (
    create_delay_kalman_iosystem,
    create_fms_iosystem,
    create_hinfinity_iosystem,
    create_ufir_iosystem,
    fms,
)

A, C = CART.A, CART.C
NAMED = ct.ss(
    A,
    np.hstack([CART.B, [[0.0], [0.1]], [[0.1], [0.0]]]),
    C,
    np.zeros((1, 3)),
    dt=0.1,
    inputs=["force", "gust", "slope"],
    outputs=["position"],
    name="cart",
)
Q2, R = np.diag([0.2, 0.1]), np.array([[0.05]])

CREATE = {
    "ufir": lambda sys, **k: create_ufir_iosystem(sys, 6, **k),
    "fms": lambda sys, **k: create_fms_iosystem(sys, Q2, R, 6, **k),
    "kalman": lambda sys, **k: create_delay_kalman_iosystem(sys, Q2, R, np.eye(2), **k),
    "hinfinity": lambda sys, **k: create_hinfinity_iosystem(sys, Q2, R, np.eye(2), **k),
}
every = pytest.mark.parametrize("name", CREATE)


@every
def test_signals_are_measurements_then_known_inputs_to_estimates(name):
    est = CREATE[name](NAMED, disturbance_indices=2)
    theirs = ct.create_estimator_iosystem(NAMED, Q2, R, np.eye(2), disturbance_indices=2)
    # python-control says y[0] where its own documentation says the name of the output.
    assert est.input_labels == ["position", "force"]
    assert theirs.input_labels[1:] == ["force"]
    assert est.output_labels == theirs.output_labels == ["xhat[0]", "xhat[1]"]
    assert est.dt == theirs.dt == 0.1


@every
def test_labels_may_be_formats_or_lists_and_inputs_outputs_override_them(name):
    build = CREATE[name]
    options = {"disturbance_indices": 2}
    est = build(NAMED, estimate_labels="m{i}", measurement_labels=["gps"], control_labels="f{i}", **options)
    assert (est.input_labels, est.output_labels) == (["gps", "f0"], ["m0", "m1"])
    est = build(NAMED, inputs=["a", "b"], outputs=["c", "d"], name="mine", **options)
    assert (est.input_labels, est.output_labels, est.name) == (["a", "b"], ["c", "d"], "mine")
    with pytest.raises(ct.ControlDimension, match="incorrect length of estimate_labels: 1 instead of 2"):
        build(NAMED, estimate_labels=["m"], **options)
    with pytest.raises(ct.ControlArgument, match="measurement_labels should be a string or a list"):
        build(NAMED, measurement_labels=3, **options)


def test_the_states_of_a_register_are_named_by_their_age():
    est = create_ufir_iosystem(NAMED, 2, control_indices=["force"])
    assert est.state_labels == ["position[k-2]", "position[k-1]", "force[k-2]", "force[k-1]"]
    assert create_ufir_iosystem(NAMED, 2, control_indices=1, states=list("abcd")).state_labels == list("abcd")
    error = est.error_system()
    assert error.input_labels == ["w[0]", "w[1]", "v[0]"]
    assert est.error_system(error_labels=["p", "s"], name="e").output_labels == ["p", "s"]


def test_the_states_of_a_recursion_are_estimates_and_covariances():
    est = create_delay_kalman_iosystem(CART, [[1]], R, np.eye(2), delay=1, covariance_labels="C{i}{j}")
    assert est.state_labels[:5] == ["xhat[0]", "xhat[1]", "xhat[0][k-1]", "xhat[1][k-1]", "C00"]
    assert est.nstates == 4 + 16
    stamped = create_delay_kalman_iosystem(CART, [[1]], R, np.eye(2), stamped=True, delay_label="age")
    assert stamped.input_labels == ["y[0]", "u[0]", "age"]
    listed = create_hinfinity_iosystem(CART, [[1]], R, np.eye(2), covariance_labels=list("abcd"))
    assert listed.state_labels == ["xhat[0]", "xhat[1]", *"abcd"]


@pytest.mark.parametrize(
    ("options", "known", "noise"),
    [
        ({"disturbance_indices": 2}, [0], [1, 2]),
        ({"disturbance_indices": ["slope", "gust"]}, [0], [2, 1]),
        ({"disturbance_indices": slice(1, None)}, [0], [1, 2]),
        ({"control_indices": 1}, [0], [1, 2]),
        ({"control_indices": [0]}, [0], [1, 2]),
        ({"control_indices": [-3]}, [0], [1, 2]),
        ({"control_indices": ["force"], "disturbance_indices": ["gust", "slope"]}, [0], [1, 2]),
        ({"control_indices": ["force"], "G": NAMED.B[:, 1:]}, [0], [1, 2]),
    ],
)
def test_indices_say_what_is_known_and_what_is_noise(options, known, noise):
    P = fms(NAMED, Q2, R, 6, **options)[1]
    plain = ct.ss(A, NAMED.B[:, known], C, np.zeros((1, len(known))), dt=0.1)
    np.testing.assert_allclose(P, fms(plain, Q2, R, 6, G=NAMED.B[:, noise])[1], rtol=1e-12)
    est = create_fms_iosystem(NAMED, Q2, R, 6, **options)
    assert est.input_labels[1:] == [NAMED.input_labels[i] for i in known]


def test_noise_is_added_to_the_inputs_where_nothing_is_said():
    P = fms(CART, [[0.5]], R, 6)[1]
    np.testing.assert_allclose(P, fms(CART, [[0.5]], R, 6, control_indices=1)[1])
    np.testing.assert_allclose(P, fms(CART, 0.5 * CART.B @ CART.B.T, R, 6, G=np.eye(2))[1], rtol=1e-10)


def test_zero_known_inputs_are_none():
    est = create_ufir_iosystem(NAMED, 6, control_indices=0)
    assert est.input_labels == ["position"]
    assert create_ufir_iosystem(NAMED, 6, disturbance_indices=0).ninputs == 4


@every
def test_C_picks_the_measurements_from_a_full_state_output(name):
    full = ct.ss(A, NAMED.B, np.eye(2), np.zeros((2, 3)), dt=0.1, inputs=NAMED.input_labels)
    est = CREATE[name](full, C=C, disturbance_indices=2)
    assert est.input_labels == ["y[0]", "force"]
    same = CREATE[name](NAMED, disturbance_indices=2)
    start = est.initial_state([1.0, 0.5])
    np.testing.assert_array_equal(start, same.initial_state([1.0, 0.5]))
    signals = np.random.default_rng(0).normal(size=(2, 20))
    found, wanted = (
        ct.input_output_response(e, np.arange(20) * 0.1, signals, start).outputs for e in (est, same)
    )
    np.testing.assert_array_equal(found, wanted)
