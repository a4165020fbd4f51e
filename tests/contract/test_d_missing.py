"""D: missing measurements."""

from __future__ import annotations

import numpy as np
import pytest

from ufirext import NonFiniteError

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


MASKED = {
    "one component": (lambda z: np.ma.array(z, mask=[True, False]), [True, False]),
    "as a column": (lambda z: np.ma.array(z.reshape(2, 1), mask=[[True], [False]]), [True, False]),
    "of integers": (lambda z: np.ma.array(z.astype(int), mask=[True, False]), [True, False]),
    "in a list": (lambda z: [np.ma.masked, z[1]], [True, False]),
    "all": (lambda z: np.ma.array(z, mask=True), True),
    "the constant": (lambda z: np.ma.masked, True),
    "none": (lambda z: np.ma.array(z), False),
}


@pytest.mark.contract(37, better=True)
@pytest.mark.parametrize("kind", MASKED)
def test_a_masked_entry_is_a_missing_component(make, column, rng, kind):
    f, twin = plane(make, column), plane(make, column)
    for n, z in enumerate(np.rint(walk(rng, 60, 2))):
        hide, hidden = MASKED[kind]
        marked, seen = (hide(z), np.where(hidden, NAN, z)) if n % 4 == 3 else (z, z)
        run(f, [marked])
        run(twin, [seen])
        np.testing.assert_array_equal(f.x, twin.x)
        np.testing.assert_array_equal(f.P, twin.P)
        np.testing.assert_array_equal(f.z, twin.z)
        np.testing.assert_array_equal(f.residual_of(marked), f.residual_of(seen))
        assert f.log_likelihood_of(marked) == f.log_likelihood_of(seen)


@pytest.mark.contract(37, better=True)
def test_a_masked_scalar_is_no_measurement(make, column, rng):
    f, twin = constant_velocity(make, column), constant_velocity(make, column)
    forms = (np.ma.masked, [np.ma.masked], np.ma.array([7.0], mask=True), np.ma.array(7.0, mask=True))
    for n, z in enumerate(walk(rng, 60, 1)):
        run(f, [forms[n // 5 % 4] if n % 5 == 3 else z])
        run(twin, [NAN if n % 5 == 3 else z])
        np.testing.assert_array_equal(f.x, twin.x)
        np.testing.assert_array_equal(f.P, twin.P)


@pytest.mark.contract(37, better=True)
def test_a_masked_component_taken_on_its_own_is_missing(make, column, rng):
    f, twin, zs = plane(make, column), plane(make, column), walk(rng, 5, 2)
    run(f, zs)
    run(twin, zs)
    f.update_sequential(0, np.ma.array([1.0, 2.0], mask=[False, True]))
    twin.update_sequential(0, [1.0, NAN])
    np.testing.assert_array_equal(f.x, twin.x)


@pytest.mark.contract(37, better=True)
def test_batch_filter_reads_masks(make, column, rng):
    zs = np.ma.array(walk(rng, 30, 2), mask=rng.random((30, 2)) < 0.3)
    for series in (zs, list(zs)):
        ours = plane(make, column).batch_filter(series)
        for mine, other in zip(ours, plane(make, column).batch_filter(zs.filled(NAN)), strict=True):
            np.testing.assert_array_equal(mine, other)


@pytest.mark.contract(37, better=True)
@pytest.mark.parametrize("steps", [0, 30])
@pytest.mark.parametrize("name", ["F", "H", "Q", "R", "B", "P", "x", "M"])
def test_a_mask_means_nothing_elsewhere(make, column, rng, name, steps):
    f = plane(make, column)
    run(f, walk(rng, steps, 2))
    f.B = np.ones((4, 1))
    shape = np.shape(getattr(f, name))
    masked = np.ma.array(np.ones(shape), mask=np.eye(*(*shape, 1)[:2], dtype=bool).reshape(shape))
    before = getattr(f, name).copy()
    with pytest.raises(NonFiniteError, match=f"{name} must have no masked entries, .*, got"):
        setattr(f, name, masked)
    np.testing.assert_array_equal(getattr(f, name), before)
    plain = np.ma.array(before)
    setattr(f, name, plain)
    run(f, walk(rng, 9, 2))
    np.testing.assert_array_equal(np.asarray(getattr(f, name)).shape, shape)


@pytest.mark.contract(37, better=True)
@pytest.mark.parametrize("steps", [0, 30])
def test_a_mask_means_nothing_in_an_argument_of_a_verb(make, column, rng, steps):
    f = plane(make, column)
    f.B = np.ones((4, 1))
    run(f, walk(rng, steps, 2))
    for name, shape in {"u": (1,), "B": (4, 1), "F": (4, 4), "Q": (4, 4)}.items():
        given = {"u": [1.0]} | {name: np.ma.array(np.ones(shape), mask=True)}
        with pytest.raises(NonFiniteError, match=f"{name} must have no masked entries"):
            f.predict(**given)
    f.predict()
    for name, shape in {"H": (2, 4), "R": (2, 2)}.items():
        with pytest.raises(NonFiniteError, match=f"{name} must have no masked entries"):
            f.update([1.0, 2.0], **{name: np.ma.array(np.ones(shape), mask=True)})


@pytest.mark.contract(37, better=True)
def test_edits_of_a_masked_array_that_was_assigned_count(make, column, rng):
    f, twin = plane(make, column), plane(make, column)
    F = np.ma.array(f.F.copy())
    f.F = F
    for n, z in enumerate(walk(rng, 40, 2)):
        if n == 20:
            F[0, 1] = 2.0
            twin.F = np.array(F)
        run(f, [z])
        run(twin, [z])
        np.testing.assert_array_equal(f.x, twin.x)
