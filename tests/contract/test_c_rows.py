"""C 21-25, 29-30: rows that differ from step to step in weight, number and kind."""

from __future__ import annotations

import numpy as np
import pytest

from .models import assert_same, constant_velocity, flat, plane, ramp_F, run, trajectory, vector, walk


@pytest.mark.contract(21)
@pytest.mark.parametrize("steps", [3, 60])
def test_a_row_of_negligible_weight_leaves_x_at_the_prior(make, column, rng, steps):
    f = plane(make, column)
    run(f, walk(rng, steps, 2))
    f.predict()
    f.update([1e3, -1e3], R=1e12 * f.R)
    np.testing.assert_allclose(f.x, f.x_prior, rtol=1e-6, atol=1e-6)


@pytest.mark.contract(21)
def test_R_for_one_call_weights_the_row_like_an_assigned_R(make, column, rng):
    f, twin = constant_velocity(make, column), constant_velocity(make, column)
    for n, z in enumerate(walk(rng, 60, 1)):
        R = np.array([[4.0 if n % 3 else 100.0]])
        f.predict()
        twin.predict()
        twin.R = R
        f.update(z, R=R)
        twin.update(z)
        np.testing.assert_allclose(f.x, twin.x, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(f.S, twin.S, rtol=1e-9)
    np.testing.assert_array_equal(f.R, [[4.0]])


@pytest.mark.contract(22)
def test_R_and_H_for_one_call_may_bring_another_number_of_rows(make, column):
    """A second sensor measures position and velocity now and then."""
    f = constant_velocity(make, column)
    states = trajectory(f.F, (5.0, 0.7), 60)
    for n, x in enumerate(states):
        f.predict()
        if n % 5 == 2:
            f.update(vector(x, column), R=np.diag([1.0, 0.01]), H=np.eye(2))
            assert (f.S.shape, f.K.shape, f.y.shape) == ((2, 2), (2, 2), (2, 1) if column else (2,))
        else:
            f.update(x[0])
            assert (f.S.shape, f.K.shape, f.y.shape) == ((1, 1), (2, 1), (1, 1) if column else (1,))
    np.testing.assert_allclose(flat(f.x), states[-1], atol=1e-2)
    np.testing.assert_array_equal(f.H, [[1.0, 0.0]])


@pytest.mark.contract(22)
def test_two_rows_of_a_second_sensor_weigh_what_their_R_says(make, column, rng):
    """One update with two rows is two updates with one row each."""
    f, twin = constant_velocity(make, column), constant_velocity(make, column)
    for n in range(60):
        position, speed = n + rng.standard_normal(), 1 + 0.1 * rng.standard_normal()
        f.predict()
        twin.predict()
        f.update(vector([position, speed], column), R=np.diag([1.0, 0.01]), H=np.eye(2))
        twin.update(vector([position], column), R=np.array([[1.0]]), H=np.array([[1.0, 0.0]]))
        twin.update(vector([speed], column), R=np.array([[0.01]]), H=np.array([[0.0, 1.0]]))
        np.testing.assert_allclose(f.x, twin.x, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(f.P, twin.P, rtol=1e-8, atol=1e-8)


@pytest.mark.contract(23)
def test_a_zero_row_of_H_is_not_measured(make, column, rng):
    """Norfair's way of leaving out a hidden point."""
    f, twin = plane(make, column), plane(make, column)
    H = f.H.copy()
    for n, z in enumerate(walk(rng, 60, 2)):
        seen = n % 4
        f.predict()
        twin.predict()
        if seen > 1:
            f.update(z)
            twin.update(z)
        else:
            masked = H * (np.arange(2) == seen)[:, None]
            f.update(vector(np.where(np.arange(2) == seen, z, 1e6), column), None, masked)
            twin.update(vector(z[[seen]], column), R=twin.R[[seen]][:, [seen]], H=H[[seen]])
        np.testing.assert_allclose(f.x, twin.x, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(f.P, twin.P, rtol=1e-9, atol=1e-9)


@pytest.mark.contract(24)
@pytest.mark.parametrize("steps", [0, 1, 60])
def test_an_all_zero_H_measures_nothing(make, column, rng, steps):
    f = plane(make, column)
    run(f, walk(rng, steps, 2))
    for _ in range(5):
        f.predict()
        f.update(vector([1.0, 2.0], column), None, np.zeros((2, 4)))
        assert np.isfinite(f.x).all()
        np.testing.assert_allclose(f.x, f.x_prior, rtol=1e-12)
        np.testing.assert_allclose(f.P, f.P_prior, rtol=1e-12)


@pytest.mark.contract(24)
def test_a_filter_whose_H_was_never_set_does_not_raise(make):
    f = make(3, 1)
    f.predict()
    f.update(1.0)
    np.testing.assert_array_equal(f.x, np.zeros((3, 1)))


@pytest.mark.contract(25)
@pytest.mark.parametrize("H", [[[0.0, 1.0]], [[0.0, 0.0]]], ids=["speed", "nothing"])
def test_an_unobservable_model_stays_finite(make, column, H):
    f = constant_velocity(make, column, x0=(3, 1))
    f.H = np.array(H)
    for n in range(60):
        run(f, [1.0 + 0.01 * (n % 5)])
        assert np.isfinite(f.x).all()
        assert np.isfinite(f.P).all()


@pytest.mark.contract("29-30")
@pytest.mark.parametrize("how", ["assigned", "in place"])
def test_F_may_follow_a_changing_interval(make, column, how):
    f = constant_velocity(make, column, q=1e-4)
    x = np.array([10.0, -1.5])
    for n in range(60):
        dt = (0.5, 1.0, 0.1, 3.0)[n % 4]
        if how == "assigned":
            f.F = ramp_F(dt)
        else:
            f.F[0, 1] = dt
        x = ramp_F(dt) @ x
        run(f, [x[0]])
    np.testing.assert_allclose(flat(f.x), x, atol=1e-2)


@pytest.mark.contract("29-30")
def test_H_and_R_may_be_assigned_between_steps(make, column, rng):
    """Sensors that take turns: assigned or given for one call, the result is the same."""
    f, twin = constant_velocity(make, column), constant_velocity(make, column)
    for n in range(60):
        H = np.array([[1.0, 0.0]]) if n % 3 else np.array([[0.2, 1.0]])
        R = np.array([[4.0]]) if n % 2 else np.array([[0.5]])
        z = vector(H @ [n, 1.0] + rng.standard_normal(1), column)
        f.H, f.R = H, R
        f.predict()
        twin.predict()
        f.update(z)
        twin.update(z, R, H)
        assert_same(f, twin)
