"""A: what a fresh filter is."""

from __future__ import annotations

import numpy as np
import pytest

from .models import constant_velocity, flat, plane, run, vector

FRESH = {
    "x": np.zeros((4, 1)),
    "P": np.eye(4),
    "Q": np.eye(4),
    "F": np.eye(4),
    "H": np.zeros((2, 4)),
    "R": np.eye(2),
}


@pytest.mark.contract(1)
def test_dimensions_are_keywords_or_positional(make):
    by_name, by_place = make.build(dim_x=4, dim_z=2), make(4, 2, 1)
    assert (by_name.dim_x, by_name.dim_z, by_name.dim_u) == (4, 2, 0)
    assert (by_place.dim_x, by_place.dim_z, by_place.dim_u) == (4, 2, 1)


@pytest.mark.contract(1)
def test_whatever_comes_after_the_dimensions_is_keyword_only(make):
    with pytest.raises(TypeError):
        make.build(4, 2, 0, 8)


@pytest.mark.contract(2)
@pytest.mark.parametrize("dims", [(0, 1), (-1, 1), (1, 0), (1, -2), (1, 1, -1)])
def test_impossible_dimensions_are_refused(make, dims):
    with pytest.raises(ValueError, match=r"dim_[xzu]"):
        make(*dims)


@pytest.mark.contract(3)
@pytest.mark.parametrize("name", FRESH)
def test_a_fresh_model_has_filterpys_defaults(make, name):
    value = getattr(make(4, 2), name)
    assert value.dtype == float
    np.testing.assert_array_equal(value, FRESH[name])


@pytest.mark.contract(3)
def test_a_fresh_filter_has_no_input_matrix(make):
    assert make(4, 2, 1).B is None


@pytest.mark.contract(4)
def test_a_fresh_filter_publishes_arrays_of_the_final_shapes(make):
    f = make(4, 2)
    shapes = {name: getattr(f, name).shape for name in ("K", "y", "S", "SI", "z", "M")}
    assert shapes == {"K": (4, 2), "y": (2, 1), "S": (2, 2), "SI": (2, 2), "z": (2, 1), "M": (4, 2)}
    assert all(value is None for value in f.z.ravel())


@pytest.mark.contract(5)
@pytest.mark.parametrize(
    ("name", "of"), [("x_prior", "x"), ("x_post", "x"), ("P_prior", "P"), ("P_post", "P")]
)
def test_prior_and_posterior_exist_from_the_start_as_copies(make, name, of):
    f = make(4, 2)
    np.testing.assert_array_equal(getattr(f, name), getattr(f, of))
    assert not np.shares_memory(getattr(f, name), getattr(f, of))
    getattr(f, name)[...] = 7.0
    np.testing.assert_array_equal(getattr(f, of), FRESH[of])


@pytest.mark.contract(6)
def test_the_defaults_may_be_edited_in_place(make):
    """SORT's way of setting a filter up makes the same filter as assigning whole matrices."""
    edited, assigned = make(4, 2), make(4, 2)
    edited.F[0, 1] = edited.F[2, 3] = 1.0
    edited.H[0, 0] = edited.H[1, 2] = 1.0
    edited.R[1:, 1:] *= 10.0
    edited.Q[2:, 2:] *= 0.01
    edited.P[2:, 2:] *= 1000.0
    edited.P *= 10.0
    edited.x[::2] = [[3.0], [4.0]]

    assigned.F = np.kron(np.eye(2), [[1.0, 1.0], [0.0, 1.0]])
    assigned.H = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0]])
    assigned.R = np.diag([1.0, 10.0])
    assigned.Q = np.diag([1.0, 1.0, 0.01, 0.01])
    assigned.P = np.diag([10.0, 10.0, 1e4, 1e4])
    assigned.x = np.array([[3.0], [0.0], [4.0], [0.0]])

    for z in ([4.0, 6.0], [5.5, 8.1], [7.0, 9.9], [8.1, 12.0], [8.8, 14.2], [10.1, 16.0]):
        run(edited, [z])
        run(assigned, [z])
        np.testing.assert_allclose(edited.x, assigned.x, rtol=1e-12)
        np.testing.assert_allclose(edited.P, assigned.P, rtol=1e-12)
        np.testing.assert_allclose(edited.S, assigned.S, rtol=1e-12)


@pytest.mark.contract(7)
def test_integer_matrices_and_states_are_numbers_like_any_other(make, column):
    whole, real = constant_velocity(make, column), constant_velocity(make, column, x0=(1, 2))
    whole.F, whole.H = np.array([[1, 1], [0, 1]]), np.array([[1, 0]])
    whole.x = vector([1, 2], column).astype(int)
    for z in (3, 4.5, 7, 9.25, 11):
        run(whole, [z])
        run(real, [z])
        np.testing.assert_allclose(whole.x, real.x, rtol=1e-12)


@pytest.mark.contract(7)
def test_an_integer_state_takes_fractions_once_the_filter_runs(make, column):
    f = constant_velocity(make, column)
    f.x = vector([0, 0], column).astype(int)
    run(f, [0.25, 0.5, 0.75])
    assert 0.0 < flat(f.x)[0] < 1.0


@pytest.mark.contract(8)
def test_scalar_R_and_Q_stand_for_multiples_of_the_identity(make):
    scalar, matrix = constant_velocity(make), constant_velocity(make)
    scalar.R, matrix.R = 5, np.array([[5.0]])
    scalar.predict(Q=0.25)
    matrix.predict(Q=0.25 * np.eye(2))
    np.testing.assert_allclose(scalar.P, matrix.P, rtol=1e-12)
    scalar.update(3.0)
    matrix.update(3.0)
    np.testing.assert_allclose(scalar.S, matrix.S, rtol=1e-12)
    np.testing.assert_allclose(scalar.x, matrix.x, rtol=1e-12)


@pytest.mark.contract(8)
@pytest.mark.parametrize("R", [5, 5.0, np.float64(5.0)])
def test_a_scalar_R_for_one_call_is_a_multiple_of_the_identity(make, R):
    scalar, matrix = plane(make), plane(make)
    for z in ([1.0, 2.0], [2.0, 4.2], [3.1, 6.0]):
        scalar.predict()
        matrix.predict()
        scalar.update(z, R=R)
        matrix.update(z, R=5.0 * np.eye(2))
        np.testing.assert_allclose(scalar.x, matrix.x, rtol=1e-12)
        np.testing.assert_allclose(scalar.S, matrix.S, rtol=1e-12)


@pytest.mark.contract(8)
def test_a_scalar_Q_may_be_assigned(make):
    """What filterpy's own tests do: ``f.R = 5; f.Q = 0.0001``."""
    f = constant_velocity(make, x0=(2, 0))
    f.R, f.Q = 5, 0.0001
    run(f, np.arange(100.0))
    np.testing.assert_allclose(flat(f.x), [99.0, 1.0], atol=0.1)
