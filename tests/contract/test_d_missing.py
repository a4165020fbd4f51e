"""D: missing measurements."""

from __future__ import annotations

import numpy as np
import pytest

from .models import constant_velocity, flat, plane, run, trajectory, vector, walk

NAN = np.nan


@pytest.mark.contract(33)
@pytest.mark.parametrize("steps", [0, 1, 3, 60])
def test_without_a_measurement_x_and_P_stay_the_prior(make, column, rng, steps):
    f = plane(make, column)
    run(f, walk(rng, steps, 2))
    f.predict()
    f.update(None)
    for of_update, of_predict in (
        ("x", "x_prior"),
        ("x_post", "x_prior"),
        ("P", "P_prior"),
        ("P_post", "P_prior"),
    ):
        np.testing.assert_array_equal(getattr(f, of_update), getattr(f, of_predict))
    np.testing.assert_array_equal(f.y.ravel(), [0.0, 0.0])
    assert f.z.size == 2
    assert all(value is None for value in f.z.ravel())


@pytest.mark.contract(33, better=True)
def test_without_a_measurement_y_and_z_keep_the_form_of_x(make):
    """filterpy turns them into columns; then Saver.to_array fails on a track with losses."""
    f = plane(make, column=False)
    run(f, [[1.0, 2.0], None])
    assert f.y.shape == f.z.shape == (2,)


@pytest.mark.contract(34)
def test_the_first_measurement_may_be_missing(make, column):
    f = plane(make, column, q=1e-3)
    states = trajectory(f.F, (1.0, 0.5, -3.0, -0.2), 60)
    run(f, [None, *states[1:, ::2]])
    np.testing.assert_allclose(flat(f.x), states[-1], atol=1e-2)


@pytest.mark.contract(34)
@pytest.mark.parametrize("gap", [50, 400], ids=["50 missing", "400 missing"])
@pytest.mark.parametrize("before", [0, 1, 3, 60])
def test_a_gap_longer_than_any_window_is_survived(make, column, gap, before):
    """Finite in the gap, and followed again after it; the longer gap lies beyond what is reached back."""
    f = plane(make, column, q=1e-3)
    states = trajectory(f.F, (1.0, 0.5, -3.0, -0.2), before + gap + 60)
    for n, x in enumerate(states):
        run(f, [None if before <= n < before + gap else x[::2]])
        assert np.isfinite(f.x).all()
        assert np.isfinite(f.P).all()
    np.testing.assert_allclose(flat(f.x), states[-1], atol=1e-2)


@pytest.mark.contract(35)
@pytest.mark.parametrize("before", [0, 1, 3, 60])
def test_P_grows_while_data_are_missing(make, column, rng, before):
    """As F P F' + Q, in every step of a gap longer than any window."""
    f = plane(make, column, q=0.5)
    run(f, walk(rng, before, 2))
    for _ in range(200):
        P = f.P.copy()
        run(f, [None])
        np.testing.assert_allclose(f.P, f.F @ P @ f.F.T + f.Q, rtol=1e-8)
        assert np.trace(f.P) > np.trace(P)


@pytest.mark.contract(36)
@pytest.mark.parametrize("before", [0, 1, 60])
def test_likelihoods_still_answer(make, column, rng, before):
    f = plane(make, column)
    run(f, walk(rng, before, 2))
    run(f, [None])
    assert not np.isnan(f.log_likelihood)
    assert 0.0 < f.likelihood < np.inf
    assert f.mahalanobis == 0.0
    assert np.isfinite(f.log_likelihood_of(None))


@pytest.mark.contract(37, better=True)
@pytest.mark.parametrize("steps", [0, 1, 60])
@pytest.mark.parametrize(
    "nothing", [[NAN, NAN], np.full((2, 1), NAN), (NAN, NAN)], ids=["list", "column", "tuple"]
)
def test_nan_is_no_measurement(make, column, rng, steps, nothing):
    f = plane(make, column)
    run(f, [*walk(rng, steps, 2), nothing])
    np.testing.assert_array_equal(f.x, f.x_prior)
    np.testing.assert_array_equal(f.P, f.P_prior)
    np.testing.assert_array_equal(f.y.ravel(), [0.0, 0.0])
    assert np.isfinite(f.log_likelihood)
    assert f.mahalanobis == 0.0


@pytest.mark.contract(37, better=True)
def test_a_scalar_nan_is_no_measurement(make, column, rng):
    f, twin = constant_velocity(make, column), constant_velocity(make, column)
    for n, z in enumerate(walk(rng, 60, 1)):
        lost = n % 5 == 3 or 20 <= n < 30
        run(f, [NAN if lost else z])
        run(twin, [None if lost else z])
        np.testing.assert_array_equal(f.x, twin.x)
        np.testing.assert_array_equal(f.P, twin.P)


@pytest.mark.contract(37, better=True)
def test_a_nan_component_is_a_missing_component(make, column, rng):
    """The same x and P as from an update with the rows that are there."""
    f, twin = plane(make, column), plane(make, column)
    for n, z in enumerate(walk(rng, 60, 2)):
        f.predict()
        twin.predict()
        if n % 3:
            seen = n % 2
            f.update(vector(np.where(np.arange(2) == seen, z, NAN), column))
            twin.update(vector(z[[seen]], column), R=f.R[[seen]][:, [seen]], H=f.H[[seen]])
            np.testing.assert_allclose(flat(f.y)[seen], flat(twin.y)[0], rtol=1e-9, atol=1e-9)
            assert flat(f.y)[1 - seen] == 0.0
            np.testing.assert_allclose(f.log_likelihood, twin.log_likelihood, rtol=1e-9)
            np.testing.assert_allclose(f.mahalanobis, twin.mahalanobis, rtol=1e-9)
        else:
            f.update(z)
            twin.update(z)
        np.testing.assert_allclose(f.x, twin.x, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(f.P, twin.P, rtol=1e-9, atol=1e-9)


@pytest.mark.contract(37, better=True)
def test_a_missing_component_is_known_to_be_correlated_with_the_others(make, column, rng):
    """With a full R the rest has the marginal covariance: rows and columns of R struck out."""
    f, twin = plane(make, column), plane(make, column)
    f.R = np.array([[4.0, 1.5], [1.5, 1.0]])
    for n, z in enumerate(walk(rng, 60, 2)):
        f.predict()
        twin.predict()
        if n % 4 == 1:
            f.update([z[0], NAN])
            twin.update(vector(z[:1], column), R=f.R[:1, :1], H=f.H[:1])
        else:
            f.update(z)
            twin.update(z, R=f.R)
        np.testing.assert_allclose(f.x, twin.x, rtol=1e-9, atol=1e-9)


@pytest.mark.contract(37, better=True)
def test_nan_never_poisons_x(make, column, rng):
    f = plane(make, column, q=1e-3)
    states = trajectory(f.F, (1.0, 0.5, -3.0, -0.2), 260)
    for n, x in enumerate(states):
        z = np.where(rng.random(2) < 0.5, NAN, x[::2]) if n < 200 else x[::2]
        run(f, [z])
        assert np.isfinite(f.x).all()
        assert np.isfinite(f.P).all()
    np.testing.assert_allclose(flat(f.x), states[-1], atol=1e-2)
