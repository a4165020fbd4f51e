"""B: forms of z and x."""

from __future__ import annotations

import numpy as np
import pytest

from .models import constant_velocity, flat, plane, run, vector

ONE = [
    3.5,
    np.float64(3.5),
    np.array(3.5),
    [3.5],
    (3.5,),
    [[3.5]],
    ([3.5],),
    np.array([3.5]),
    np.array([[3.5]]),
]
TWO = [
    [3.5, 4.5],
    (3.5, 4.5),
    [[3.5, 4.5]],
    [[3.5], [4.5]],
    ((3.5,), (4.5,)),
    np.array([3.5, 4.5]),
    np.array([[3.5, 4.5]]),
    np.array([[3.5], [4.5]]),
]


@pytest.mark.contract(9)
@pytest.mark.parametrize("z", ONE, ids=repr)
def test_a_scalar_measurement_has_nine_forms(make, column, z):
    f, reference = constant_velocity(make, column), constant_velocity(make, column)
    run(f, [1.0, 2.2, z])
    run(reference, [1.0, 2.2, np.array([[3.5]])])
    np.testing.assert_array_equal(f.x, reference.x)


@pytest.mark.contract(10)
@pytest.mark.parametrize("z", TWO, ids=repr)
def test_a_vector_measurement_may_be_list_tuple_row_or_column(make, column, z):
    f, reference = plane(make, column), plane(make, column)
    run(f, [[1, 2], [2.2, 3], z])
    run(reference, [[1, 2], [2.2, 3], np.array([[3.5], [4.5]])])
    np.testing.assert_array_equal(f.x, reference.x)


@pytest.mark.contract(11)
@pytest.mark.parametrize(
    "z", [[], [1.0], [1.0, 2.0, 3.0], np.zeros((2, 2)), np.zeros((1, 3)), np.zeros((2, 1, 1))]
)
def test_a_measurement_of_the_wrong_size_is_refused(make, column, z):
    f = plane(make, column)
    f.predict()
    with pytest.raises(ValueError, match="shape"):
        f.update(z)


@pytest.mark.contract(11)
def test_a_refused_measurement_leaves_no_trace(make, column):
    f, twin = plane(make, column), plane(make, column)
    for z in ([1.0, 2.0], [2.1, 3.0], [3.0, 4.2]):
        f.predict()
        twin.predict()
        with pytest.raises(ValueError, match="shape"):
            f.update([1.0, 2.0, 3.0])
        f.update(z)
        twin.update(z)
        np.testing.assert_array_equal(f.x, twin.x)


@pytest.mark.contract(12)
def test_x_keeps_the_clients_form_for_ever(make, column):
    f = plane(make, column)
    shape = (4, 1) if column else (4,)
    for n in range(60):
        f.predict()
        assert (f.x.shape, f.x_prior.shape) == (shape, shape)
        f.update(None if n % 7 == 3 else [n, 2.0 * n])
        assert (f.x.shape, f.x_post.shape) == (shape, shape)
    assert f.get_prediction()[0].shape == shape
    assert f.get_update([1.0, 2.0])[0].shape == shape


@pytest.mark.contract(13)
def test_y_and_z_have_the_form_of_x(make, column):
    f = plane(make, column)
    for z in TWO:
        run(f, [z])
        assert f.y.shape == f.z.shape == ((2, 1) if column else (2,))
        np.testing.assert_array_equal(f.z.ravel(), [3.5, 4.5])


@pytest.mark.contract(14)
@pytest.mark.parametrize("change_at", [0, 1, 3, 30])
def test_x_may_change_form_in_mid_life(make, column, change_at):
    f, twin = plane(make, column), plane(make, column)
    for n in range(60):
        if n == change_at:
            f.x = vector(f.x, not column)
        run(f, [[n, n % 3]])
        run(twin, [[n, n % 3]])
        np.testing.assert_allclose(flat(f.x), flat(twin.x), rtol=1e-9, atol=1e-9)
    assert f.x.ndim == f.y.ndim == (1 if column else 2)


@pytest.mark.contract(14)
@pytest.mark.parametrize("steps", [0, 1, 3, 60])
def test_P_may_be_replaced_in_mid_life(make, column, steps):
    f = plane(make, column)
    run(f, [[n, 2.0 * n] for n in range(steps)])
    P = np.diag([1.0, 2.0, 3.0, 4.0])
    f.P = P.copy()
    np.testing.assert_array_equal(f.P, P)
    f.predict()
    np.testing.assert_allclose(f.P_prior, f.F @ P @ f.F.T + f.Q, rtol=1e-12)
    f.update([steps, 2.0 * steps])
    assert np.isfinite(f.x).all()
    assert np.isfinite(f.P).all()


@pytest.mark.contract(15)
def test_both_forms_of_x_give_the_same_numbers(make, rng):
    column, flat_one = plane(make, True), plane(make, False)
    for n in range(60):
        z = None if n % 9 == 5 else rng.normal([n, 2.0 * n], 1.0)
        run(column, [z])
        run(flat_one, [z])
        np.testing.assert_array_equal(column.x[:, 0], flat_one.x)
        for name in ("P", "S", "SI", "K", "log_likelihood", "mahalanobis"):
            np.testing.assert_array_equal(getattr(column, name), getattr(flat_one, name), err_msg=name)
        np.testing.assert_array_equal(column.y.ravel(), flat_one.y.ravel())
