"""C: predict and update."""

from __future__ import annotations

import numpy as np
import pytest

from .models import constant_velocity, flat, plane, ramp_F, run, trajectory, vector, walk


def is_covariance(P):
    scale = np.max(np.abs(P))
    return np.allclose(P, P.T, atol=1e-12 * scale) and np.linalg.eigvalsh(P)[0] >= -1e-12 * scale


@pytest.mark.contract(16)
def test_predict_publishes_the_prior_and_update_the_posterior(make, column, rng):
    f = plane(make, column)
    for z in walk(rng, 60, 2):
        f.predict()
        np.testing.assert_array_equal(f.x_prior, f.x)
        np.testing.assert_array_equal(f.P_prior, f.P)
        prior = f.x_prior.copy(), f.P_prior.copy()
        f.update(z)
        np.testing.assert_array_equal(f.x_post, f.x)
        np.testing.assert_array_equal(f.P_post, f.P)
        np.testing.assert_array_equal(f.x_prior, prior[0])
        np.testing.assert_array_equal(f.P_prior, prior[1])
        assert is_covariance(f.P_prior)
        assert is_covariance(f.P_post)


@pytest.mark.contract(16)
@pytest.mark.parametrize("name", ["x_prior", "P_prior", "x_post", "P_post"])
def test_priors_and_posteriors_are_copies_in_every_step(make, column, name):
    f, twin = constant_velocity(make, column), constant_velocity(make, column)
    for n in range(60):
        f.predict()
        twin.predict()
        getattr(f, name)[...] = 1e9
        f.update(n)
        twin.update(n)
        getattr(f, name)[...] = -1e9
        np.testing.assert_array_equal(f.x, twin.x)
        np.testing.assert_array_equal(f.P, twin.P)


@pytest.mark.contract(17)
def test_the_innovation_and_its_covariance(make, column, rng):
    f = plane(make, column)
    for z in walk(rng, 60, 2):
        run(f, [z])
        np.testing.assert_allclose(flat(f.y), z - f.H @ flat(f.x_prior), rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(f.S, f.H @ f.P_prior @ f.H.T + f.R, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(f.S, f.S.T, rtol=1e-12)
        assert np.linalg.eigvalsh(f.S)[0] > 0.0
        np.testing.assert_allclose(f.SI, np.linalg.inv(f.S), rtol=1e-9, atol=1e-12)


@pytest.mark.contract(18)
@pytest.mark.parametrize("steps", [0, 1, 5, 60])
def test_arguments_of_predict_override_one_call(make, column, steps):
    f, twin = constant_velocity(make, column), constant_velocity(make, column)
    run(f, range(steps))
    run(twin, range(steps))
    x, P = flat(f.x), f.P.copy()
    F, Q, B = ramp_F(2.5), np.diag([3.0, 4.0]), np.array([[0.5], [1.0]])
    u = vector([2.0], column)
    f.predict(u, B, F, Q)
    np.testing.assert_allclose(flat(f.x), F @ x + B @ [2.0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(f.P, F @ P @ F.T + Q, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(f.F, twin.F)
    np.testing.assert_array_equal(f.Q, twin.Q)
    assert f.B is None
    x, P = flat(f.x), f.P.copy()
    f.predict()
    np.testing.assert_allclose(flat(f.x), twin.F @ x, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(f.P, twin.F @ P @ twin.F.T + twin.Q, rtol=1e-9, atol=1e-9)


@pytest.mark.contract(19)
def test_an_input_acts_through_B(make, column):
    f = constant_velocity(make, column, x0=(1, 2))
    f.B = np.array([[0.5, 0.0], [1.0, 3.0]])
    for u in (np.array([2.0, 1.0]), [2.0, 1.0]):
        f.predict(u=vector(u, column))
    expected = np.array([1.0, 2.0])
    for _ in range(2):
        expected = f.F @ expected + f.B @ [2.0, 1.0]
    np.testing.assert_allclose(flat(f.x), expected, rtol=1e-12)


@pytest.mark.contract(19, better=True)
def test_an_input_may_be_scalar_flat_or_column_whatever_the_form_of_x(make, column):
    B = np.array([[0.5], [1.0]])
    for u in (2.0, np.array(2.0), [2.0], np.array([2.0]), np.array([[2.0]])):
        f = constant_velocity(make, column, x0=(1, 2))
        f.predict(u, B)
        np.testing.assert_allclose(f.x, vector([4.0, 4.0], column), rtol=1e-12)
        assert f.x.shape == ((2, 1) if column else (2,))


@pytest.mark.contract(19)
@pytest.mark.parametrize("u", [0, 3.0, np.array([1.0, 2.0, 3.0])], ids=repr)
def test_an_input_without_B_is_ignored(make, column, u):
    f, twin = constant_velocity(make, column), constant_velocity(make, column)
    for z in (1.0, 2.2, 2.9, 4.0):
        f.predict(u)
        twin.predict()
        f.update(z)
        twin.update(z)
        np.testing.assert_array_equal(f.x, twin.x)


@pytest.mark.contract(20)
def test_known_inputs_leave_no_bias(make, column):
    """300 steps of strong, changing, known acceleration: without noise the estimate is exact."""
    f = constant_velocity(make, column)
    f.B = np.array([[0.5], [1.0]])
    x = np.zeros(2)
    for n in range(300):
        u = 10.0 * np.sin(0.1 * n)
        x = f.F @ x + f.B[:, 0] * u
        f.predict(u=vector([u], column))
        f.update(x[0])
        np.testing.assert_allclose(flat(f.x), x, rtol=1e-7, atol=1e-7)


@pytest.mark.contract(26)
def test_an_update_may_come_before_the_first_predict(make, column):
    f = constant_velocity(make, column)
    states = trajectory(f.F, (4.0, 2.0), 60)
    for x in states:
        f.update(x[0])
        np.testing.assert_array_equal(f.x_post, f.x)
        assert np.isfinite(f.x).all()
        posterior = flat(f.x)
        f.predict()
    np.testing.assert_allclose(posterior, states[-1], atol=1e-2)


@pytest.mark.contract(27)
def test_several_updates_per_predict(make, column):
    f = plane(make, column, q=1e-4)
    states = trajectory(f.F, (1.0, 0.5, -3.0, -0.2), 60)
    for x in states:
        f.predict()
        f.update(vector(x[:1], column), R=np.array([[1.0]]), H=f.H[:1])
        f.update(x[::2])
        f.update(vector(x[2:3], column), R=np.array([[2.0]]), H=f.H[1:])
    np.testing.assert_allclose(flat(f.x), states[-1], atol=1e-2)


@pytest.mark.contract(27)
def test_several_predicts_per_update(make, column):
    f = plane(make, column, q=1e-4)
    states = trajectory(f.F, (1.0, 0.5, -3.0, -0.2), 90)
    for n, x in enumerate(states):
        f.predict()
        if n % 3 == 2:
            f.update(x[::2])
        assert np.isfinite(f.x).all()
    np.testing.assert_allclose(flat(f.x), states[-1], atol=1e-2)


@pytest.mark.contract(31)
def test_exact_constant_velocity_data_are_followed_within_a_hundredth(make, column):
    f = plane(make, column, q=1e-3)
    states = trajectory(f.F, (50.0, 2.0, -20.0, -0.7), 60)
    run(f, states[:, ::2])
    np.testing.assert_allclose(flat(f.x), states[-1], atol=1e-2)


@pytest.mark.contract(32)
def test_the_callers_arrays_are_never_written_to(make, column, rng):
    f = make(4, 2, 1)
    given = {
        "x": vector([1, 2, 3, 4], column),
        "P": 10.0 * np.eye(4),
        "F": np.kron(np.eye(2), ramp_F()),
        "H": np.kron(np.eye(2), [[1.0, 0.0]]),
        "Q": 0.1 * np.eye(4),
        "R": np.diag([4.0, 1.0]),
        "B": np.ones((4, 1)),
    }
    before = {name: value.copy() for name, value in given.items()}
    for name, value in given.items():
        setattr(f, name, value)
    for z in walk(rng, 60, 2):
        u, sent = vector([0.5], column), z.copy()
        f.predict(u)
        f.update(z)
        np.testing.assert_array_equal(z, sent)
        np.testing.assert_array_equal(u, vector([0.5], column))
    for name, value in given.items():
        np.testing.assert_array_equal(value, before[name], err_msg=name)


@pytest.mark.contract(32)
def test_what_was_passed_for_one_call_may_be_reused_by_the_caller(make, column, rng):
    f, twin = plane(make, column), plane(make, column)
    z, H, R, F, Q, u = (
        np.zeros(2),
        np.zeros((2, 4)),
        np.zeros((2, 2)),
        np.zeros((4, 4)),
        np.zeros((4, 4)),
        np.zeros(1),
    )
    u, B = vector(u, column), np.zeros((4, 1))
    z = vector(z, column)
    for value in walk(rng, 60, 2):
        z[...], H[...], R[...], F[...], Q[...] = vector(value, column), f.H, f.R, f.F, f.Q
        u[...], B[...] = 0.3, 1.0
        f.predict(u, B, F, Q)
        twin.predict(vector([0.3], column), np.ones((4, 1)))
        f.update(z, R, H)
        twin.update(value)
        for reused in (z, H, R, F, Q, u, B):
            reused[...] = 1e6
        np.testing.assert_allclose(f.x, twin.x, rtol=1e-9, atol=1e-9)


@pytest.mark.contract(32)
def test_an_initial_state_is_not_read_again_once_the_filter_has_started(make, column, rng):
    f, twin = plane(make, column), plane(make, column)
    x0, P0 = vector([1, 2, 3, 4], column), 10.0 * np.eye(4)
    f.x, f.P = x0, P0
    twin.x, twin.P = x0.copy(), P0.copy()
    for z in walk(rng, 60, 2):
        f.predict()
        twin.predict()
        x0 += 100.0
        P0 += 100.0
        f.update(z)
        twin.update(z)
        np.testing.assert_array_equal(f.x, twin.x)
        np.testing.assert_array_equal(f.P, twin.P)
