"""Model, kinematic and discretise: frozen, validated, and right."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad_vec
from scipy.linalg import expm

from tests.strategies import models, positive
from ufirext import CovarianceError, Model, NonFiniteError, ShapeError, UfirextError, discretise, kinematic

RAMP = [[1.0, 1.0], [0.0, 1.0]]


def test_defaults_are_no_process_noise_and_unit_measurement_noise():
    model = Model(RAMP, [[1, 0]])
    np.testing.assert_array_equal(model.Q, np.zeros((2, 2)))
    np.testing.assert_array_equal(model.R, [[1.0]])
    assert model.B is None
    assert model.dt is None
    assert (model.dim_x, model.dim_z, model.dim_u) == (2, 1, 0)


def test_scalars_rows_and_columns_are_understood():
    model = Model(RAMP, [1, 0], Q=2, R=3, B=[0.5, 1.0], dt=0.1)
    np.testing.assert_array_equal(model.H, [[1.0, 0.0]])
    np.testing.assert_array_equal(model.Q, 2.0 * np.eye(2))
    np.testing.assert_array_equal(model.R, [[3.0]])
    np.testing.assert_array_equal(model.B, [[0.5], [1.0]])
    assert model.dim_u == 1
    assert repr(model) == "Model(dim_x=2, dim_z=1, dim_u=1, dt=0.1)"
    assert Model(0.5, 1.0).F.tolist() == [[0.5]]


@pytest.mark.parametrize("name", ["F", "H", "Q", "R", "B"])
def test_the_arrays_are_copies_and_read_only(name):
    given_arrays = {
        "F": np.eye(2),
        "H": np.ones((1, 2)),
        "Q": np.eye(2),
        "R": np.eye(1),
        "B": np.ones((2, 1)),
    }
    model = Model(**given_arrays)
    given_arrays[name][0, 0] = 7.0
    held = getattr(model, name)
    assert held[0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        held[0, 0] = 2.0
    with pytest.raises(AttributeError):
        setattr(model, name, held)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"F": np.ones((2, 3)), "H": [[1, 0]]}, ShapeError, r"F must have shape \(2, 2\) \(dim_x, dim_x\)"),
        (
            {"F": RAMP, "H": [[1, 0, 0]]},
            ShapeError,
            r"H must have shape \(any, 2\) \(dim_z, dim_x\), got \(1, 3\)",
        ),
        ({"F": RAMP, "H": np.zeros((0, 2))}, ShapeError, "H must have at least one row"),
        ({"F": np.zeros((0, 0)), "H": [[]]}, ShapeError, "F must have at least one state"),
        (
            {"F": [[1, np.nan], [0, 1]], "H": [[1, 0]]},
            NonFiniteError,
            r"F must be finite, got NaN or inf at \(0, 1\)",
        ),
        ({"F": RAMP, "H": [[1, 0]], "Q": np.eye(3)}, ShapeError, r"Q must have shape \(2, 2\)"),
        ({"F": RAMP, "H": [[1, 0]], "Q": -1.0}, CovarianceError, "Q must be positive semidefinite"),
        ({"F": RAMP, "H": [[1, 0]], "R": [[1, 0], [0, 1]]}, ShapeError, r"R must have shape \(1, 1\)"),
        ({"F": RAMP, "H": [[1, 0]], "R": -1e-3}, CovarianceError, "R must be positive semidefinite"),
        ({"F": RAMP, "H": [[1, 0]], "B": np.ones((3, 1))}, ShapeError, r"B must have shape \(2, any\)"),
        (
            {"F": RAMP, "H": [[1, 0]], "dt": 0.0},
            UfirextError,
            "dt must be a positive number of seconds, got 0.0",
        ),
        ({"F": RAMP, "H": [[1, 0]], "dt": np.inf}, UfirextError, "dt must be a positive number"),
        ({"F": RAMP, "H": [[1, 0]], "dt": "1"}, ShapeError, "dt must be a number, got '1'"),
        ({"F": RAMP, "H": [[1, 0]], "dt": [1.0]}, ShapeError, r"dt must be a number, got \[1.0\]"),
        ({"F": RAMP, "H": [[1, 0]], "R": "4"}, ShapeError, "R must be an array of real numbers, got '4'"),
        ({"F": "ramp", "H": [[1, 0]]}, ShapeError, "F must be an array of real numbers, got 'ramp'"),
    ],
)
def test_bad_input_is_refused_by_name(arguments, error, message):
    with pytest.raises(error, match=message):
        Model(**arguments)


@given(models())
def test_models_are_values(model):
    twin = Model(model.F, model.H, model.Q, model.R)
    assert twin == model
    assert hash(twin) == hash(model)
    assert {model: "found"}[twin] == "found"
    other = model.replace(R=2.0 * model.R)
    assert other != model
    np.testing.assert_array_equal(other.F, model.F)


def test_a_model_is_not_equal_to_something_else():
    assert Model(1.0, 1.0) != "model"
    assert Model(1.0, 1.0) != Model(1.0, 1.0, dt=1.0)
    assert Model(1.0, 1.0) != Model(1.0, 1.0, B=0.0)


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda m: pickle.loads(pickle.dumps(m))])
def test_copies_are_equal_models(copied):
    model = kinematic(1, 2, 0.1)
    assert copied(model) == model


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_a_kinematic_model_is_its_continuous_one_discretised(order, dim):
    size, dt, q = order + 1, 0.4, 3.0
    A = np.kron(np.eye(dim), np.eye(size, k=1))
    G = np.kron(np.eye(dim), np.eye(size)[:, -1:])
    F, Q = discretise(A, G, q * np.eye(dim), dt)
    model = kinematic(order, dim, dt, q=q, r=2.0)
    np.testing.assert_allclose(model.F, F, atol=1e-15)
    np.testing.assert_allclose(model.Q, Q, rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(model.R, 2.0 * np.eye(dim))
    np.testing.assert_array_equal(model.H @ np.arange(1.0, dim * size + 1), np.arange(dim) * size + 1.0)
    assert model.dt == dt


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((3, 1, 1.0), "order must be between 0 and 2, got 3"),
        ((1.0, 1, 1.0), "order must be an integer"),
        ((1, 0, 1.0), "dim must be at least 1, got 0"),
        ((1, 1, -1.0), "dt must be a positive number of seconds, got -1.0"),
        ((1, 1, np.nan), "dt must be a positive number of seconds, got nan"),
        ((1, 1, "1"), "dt must be a number, got '1'"),
        ((1, 1, np.timedelta64(1, "ns")), "dt must be a number, got"),
    ],
)
def test_a_kinematic_model_refuses_what_it_cannot_be(arguments, message):
    with pytest.raises(UfirextError, match=message):
        kinematic(*arguments)


@pytest.mark.parametrize("name", ["q", "r"])
@pytest.mark.parametrize("value", [-1.0, np.inf, np.nan])
def test_a_kinematic_model_refuses_bad_noise(name, value):
    with pytest.raises(UfirextError, match=f"{name} must be a finite number, not negative"):
        kinematic(1, 1, 1.0, **{name: value})


@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.floats(0.01, 2.0))
def test_discretisation_is_the_integral_it_says(seed, size, dt):
    rng = np.random.default_rng(seed)
    A, G = rng.normal(size=(size, size)), rng.normal(size=(size, 2))
    Qc = positive(rng, 2)
    F, Q = discretise(A, G, Qc, dt)

    def density(s: float) -> np.ndarray:
        response = expm(A * s) @ G
        return response @ Qc @ response.T

    np.testing.assert_allclose(F, expm(A * dt), rtol=1e-10, atol=1e-12)
    integral = quad_vec(density, 0.0, dt, epsrel=1e-11)[0]
    np.testing.assert_allclose(Q, integral, rtol=1e-8, atol=1e-10 * np.abs(integral).max())


@given(st.integers(0, 2**32 - 1), st.floats(0.01, 1.0))
def test_two_half_steps_are_one_step(seed, dt):
    rng = np.random.default_rng(seed)
    A, G = rng.normal(size=(3, 3)), rng.normal(size=(3, 1))
    F, Q = discretise(A, G, 1.0, dt)
    half, noise = discretise(A, G, 1.0, dt / 2)
    np.testing.assert_allclose(half @ half, F, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(half @ noise @ half.T + noise, Q, rtol=1e-8, atol=1e-11)


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (([[0, 1]], [[1]], 1.0, 1.0), ShapeError),
        (([[0, 1], [0, 0]], [[1]], 1.0, 1.0), ShapeError),
        (([[0, 1], [0, 0]], [[0], [1]], -1.0, 1.0), CovarianceError),
        (([[0, 1], [0, 0]], [[0], [1]], 1.0, 0.0), UfirextError),
        (([[0, np.inf], [0, 0]], [[0], [1]], 1.0, 1.0), NonFiniteError),
    ],
)
def test_discretise_refuses_bad_input(arguments, error):
    with pytest.raises(error):
        discretise(*arguments)
