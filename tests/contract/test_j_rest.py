"""J: the less usual verbs."""

from __future__ import annotations

import numpy as np
import pytest

from .models import constant_velocity, flat, plane, run, trajectory, vector, walk
from .naive import BookKalman


@pytest.mark.contract(65)
def test_steady_state_verbs_keep_K_S_and_P(make, column, rng):
    f = plane(make, column)
    zs = walk(rng, 120, 2)
    run(f, zs[:60])
    K, S, P = f.K.copy(), f.S.copy(), f.P.copy()
    for z in zs[60:]:
        x = flat(f.x)
        f.predict_steadystate()
        np.testing.assert_allclose(flat(f.x_prior), f.F @ x, rtol=1e-9, atol=1e-9)
        f.update_steadystate(z)
        np.testing.assert_allclose(flat(f.y), z - f.H @ flat(f.x_prior), rtol=1e-9, atol=1e-9)
        np.testing.assert_array_equal(f.x_post, f.x)
        for name, kept in (("K", K), ("S", S), ("P", P)):
            np.testing.assert_allclose(getattr(f, name), kept, rtol=1e-12, err_msg=name)
        assert np.isfinite(f.mahalanobis)


@pytest.mark.contract(65)
def test_steady_state_verbs_follow_exact_data(make, column):
    f = plane(make, column, q=1e-2)
    states = trajectory(f.F, (1.0, 0.5, -3.0, -0.2), 160)
    run(f, states[:100, ::2])
    for x in states[100:]:
        f.predict_steadystate()
        f.update_steadystate(x[::2])
    np.testing.assert_allclose(flat(f.x), states[-1], atol=1e-2)


@pytest.mark.contract(65)
def test_steady_state_verbs_know_inputs_and_losses(make, column):
    f = constant_velocity(make, column, q=1e-2)
    f.B = np.array([[0.5], [1.0]])
    run(f, range(60))
    x = flat(f.x)
    f.predict_steadystate(vector([2.0], column))
    np.testing.assert_allclose(flat(f.x), f.F @ x + [1.0, 2.0], rtol=1e-9)
    f.update_steadystate(None)
    np.testing.assert_array_equal(f.x, f.x_prior)
    assert all(value is None for value in f.z.ravel())


@pytest.mark.contract(66)
def test_update_correlated_with_M_zero_is_update(make, column, rng):
    f, twin = plane(make, column), plane(make, column)
    for n, z in enumerate(walk(rng, 60, 2)):
        f.predict()
        twin.predict()
        if n % 6 == 3:
            f.update_correlated(None)
            twin.update(None)
        else:
            f.update_correlated(z)
            twin.update(z)
        for name in ("x", "S"):
            np.testing.assert_allclose(
                getattr(f, name), getattr(twin, name), rtol=1e-8, atol=1e-8, err_msg=name
            )
        np.testing.assert_allclose(f.P, twin.P, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(flat(f.y), flat(twin.y), rtol=1e-8, atol=1e-8)


@pytest.mark.contract(66, kalman=True)
def test_the_first_correlated_update_is_the_books(make, column):
    """S = H P H' + H M + M' H' + R, K = (P H' + M) S^-1, P - K (H P + M')."""
    f = constant_velocity(make, column, x0=(1, 2))
    f.M = np.array([[0.3], [0.1]])
    f.predict()
    x, P, M, H = flat(f.x), f.P.copy(), f.M, f.H
    f.update_correlated(5.0)
    S = H @ P @ H.T + H @ M + M.T @ H.T + f.R
    K = (P @ H.T + M) @ np.linalg.inv(S)
    np.testing.assert_allclose(f.S, S, rtol=1e-12)
    np.testing.assert_allclose(f.K, K, rtol=1e-12)
    np.testing.assert_allclose(flat(f.x), x + K @ ([5.0] - H @ x), rtol=1e-12)
    np.testing.assert_allclose(f.P, P - K @ (H @ P + M.T), rtol=1e-9)


@pytest.mark.contract(66)
def test_correlated_updates_follow_exact_data(make, column):
    f = plane(make, column, q=1e-2)
    f.M[0, 0] = f.M[2, 1] = 0.01
    states = trajectory(f.F, (1.0, 0.5, -3.0, -0.2), 60)
    for x in states:
        f.predict()
        f.update_correlated(x[::2])
        assert np.isfinite(f.P).all()
    np.testing.assert_allclose(flat(f.x), states[-1], atol=1e-2)


@pytest.mark.contract(66)
def test_a_sequence_of_partial_updates_is_one_update(make, rng):
    f, twin = plane(make), plane(make)
    for z in walk(rng, 60, 2):
        f.predict()
        twin.predict()
        f.update_sequential(0, z[0])
        f.update_sequential(1, z[1])
        twin.update(z)
        np.testing.assert_allclose(f.x, twin.x, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(f.P, twin.P, rtol=1e-8, atol=1e-8)
        np.testing.assert_array_equal(f.x_post, f.x)
        np.testing.assert_array_equal(f.z.ravel(), z)


@pytest.mark.contract(66, better=True)
def test_a_sequence_of_partial_updates_of_a_flat_state(make, rng):
    f, twin = plane(make, column=False), plane(make, column=False)
    for z in walk(rng, 60, 2):
        f.predict()
        twin.predict()
        f.update_sequential(0, z[0])
        f.update_sequential(1, [z[1]])
        twin.update(z)
        assert f.x.shape == (4,)
        np.testing.assert_allclose(f.x, twin.x, rtol=1e-8, atol=1e-8)


@pytest.mark.contract(66)
def test_R_and_H_of_a_partial_update_hold_for_that_call(make, rng):
    f, twin = plane(make), plane(make)
    for z in walk(rng, 60, 2):
        f.predict()
        twin.predict()
        f.update_sequential(0, z[0], 9.0, np.array([[1.0, 0.5, 0.0, 0.0]]))
        f.update_sequential(1, z[1])
        twin.update(z[:1, None], np.array([[9.0]]), np.array([[1.0, 0.5, 0.0, 0.0]]))
        twin.update(z[1:, None], twin.R[1:, 1:], twin.H[1:])
        np.testing.assert_allclose(f.x, twin.x, rtol=1e-8, atol=1e-8)
    np.testing.assert_array_equal(f.H, plane(make).H)


@pytest.mark.contract(66, kalman=True)
def test_the_first_partial_update_is_the_books(make):
    f = plane(make, x0=(1, 2, 3, 4))
    f.predict()
    book = BookKalman(flat(f.x), f.P.copy())
    f.update_sequential(1, 7.0)
    book.update(np.array([7.0]), f.H[1:], f.R[1:, 1:])
    np.testing.assert_allclose(flat(f.x), book.x, rtol=1e-12)
    np.testing.assert_allclose(f.P, book.P, rtol=1e-9)
    np.testing.assert_allclose(f.y[1], 7.0 - 7.0, atol=1e-12)
