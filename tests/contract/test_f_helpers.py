"""F: the verbs that look without touching, and what a filter says about itself."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.common import inv_diagonal, kinematic_kf
from filterpy.kalman import KalmanFilter

from .models import assert_same, constant_velocity, flat, plane, ramp_F, run, vector, walk

STEPS = pytest.mark.parametrize("steps", [0, 1, 3, 60])


@pytest.mark.contract(42)
@STEPS
def test_residual_of_is_the_distance_to_the_predicted_measurement(make, column, rng, steps):
    f = plane(make, column)
    run(f, walk(rng, steps, 2))
    f.predict()
    before = flat(f.x)
    residual = f.residual_of([5.0, 6.0])
    assert residual.shape == ((2, 1) if column else (2,))
    np.testing.assert_allclose(flat(residual), [5.0, 6.0] - f.H @ flat(f.x_prior), rtol=1e-12)
    np.testing.assert_array_equal(flat(f.x), before)


@pytest.mark.contract(42)
def test_measurement_of_state_is_H_x(make, column):
    f = plane(make, column)
    x = vector([1.0, 2.0, 3.0, 4.0], column)
    np.testing.assert_array_equal(f.measurement_of_state(x), f.H @ x)


@pytest.mark.contract(43)
@STEPS
def test_get_prediction_is_what_predict_would_give(make, column, rng, steps):
    f = constant_velocity(make, column)
    run(f, walk(rng, steps, 1))
    for arguments in (
        {},
        {"u": vector([2.0], column), "B": np.ones((2, 1)), "F": ramp_F(0.3), "Q": np.eye(2)},
        {"Q": 2.0},
    ):
        x, P = f.get_prediction(**arguments)
        twin = constant_velocity(make, column)
        run(twin, walk(np.random.default_rng(20), steps, 1))
        twin.predict(**arguments)
        np.testing.assert_allclose(x, twin.x, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(P, twin.P, rtol=1e-9, atol=1e-9)


@pytest.mark.contract(44)
@STEPS
@pytest.mark.parametrize("z", [[5.0, 6.0], None], ids=["measured", "missing"])
def test_get_update_is_what_update_would_give(make, column, rng, steps, z):
    f = plane(make, column)
    run(f, walk(rng, steps, 2))
    f.predict()
    x, P = (np.array(value) for value in f.get_update(z))
    f.update(z)
    np.testing.assert_allclose(x, f.x, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(P, f.P, rtol=1e-9, atol=1e-9)


@pytest.mark.contract("43-44")
def test_looking_changes_nothing(make, column, rng):
    f, twin = plane(make, column), plane(make, column)
    for n, z in enumerate(walk(rng, 45, 2)):
        f.predict()
        twin.predict()
        f.get_update([1e3, -1e3])
        f.get_update(None)
        f.get_update(z)
        f.residual_of([9.0, 9.0])
        f.measurement_of_state(f.x)
        assert_same(f, twin)
        f.update(None if n % 7 == 4 else z)
        twin.update(None if n % 7 == 4 else z)
        f.get_prediction()
        f.get_prediction(F=2 * np.eye(4), Q=3.0)
        repr(f)
        f.test_matrix_dimensions(z=vector(z, column))
        assert_same(f, twin)


@pytest.mark.contract("43-44")
def test_what_was_looked_at_may_be_overwritten(make, column, rng):
    """filterpy hands out x itself for get_update(None); only the arrays computed for the caller are his."""
    f, twin = plane(make, column), plane(make, column)
    for z in walk(rng, 60, 2):
        f.predict()
        twin.predict()
        for array in (*f.get_prediction(), *f.get_update(z), f.residual_of(z)):
            array[...] = 1e9
        f.update(z)
        twin.update(z)
        assert_same(f, twin)


@pytest.mark.contract(45)
def test_repr_in_every_state(make, column):
    f = plane(make, column)
    texts = [repr(f)]
    f.predict()
    texts.append(repr(f))
    for z in ([1.0, 2.0], None, *([n, 2.0 * n] for n in range(60))):
        run(f, [z])
        texts.append(repr(f))
    for text in texts:
        assert type(f).__name__ in text
        assert "x = " in text
        assert "P = " in text


@pytest.mark.contract(46)
def test_matrix_dimensions_are_right_in_every_state(make, column):
    f = plane(make, column)
    z = vector([1.0, 2.0], column)
    f.test_matrix_dimensions(z)
    for given in ([1.0, 2.0], None, *([n, 2.0 * n] for n in range(60))):
        run(f, [given])
        f.test_matrix_dimensions(z)


@pytest.mark.contract(46)
@pytest.mark.parametrize(
    "wrong",
    [{"H": np.eye(3)}, {"R": np.eye(3)}, {"F": np.eye(3)}, {"Q": np.eye(3)}, {"z": np.zeros((3, 1))}],
    ids=lambda wrong: next(iter(wrong)),
)
def test_wrong_dimensions_are_found(make, column, wrong):
    """AssertionError in filterpy; the library's own errors are ValueErrors."""
    with pytest.raises((AssertionError, ValueError)):
        plane(make, column).test_matrix_dimensions(**wrong)


@pytest.mark.contract(47)
def test_alpha_is_one_and_may_be_raised(make):
    f = make(2, 1)
    assert f.alpha == 1.0
    f.alpha = 1.02
    assert f.alpha == pytest.approx(1.02)


@pytest.mark.contract(47, better=True)
@pytest.mark.parametrize("alpha", ["1", None, [1.0], 1j, np.nan, np.inf, 10**400, np.ma.masked])
def test_alpha_is_a_number(make, alpha):
    f = constant_velocity(make)
    with pytest.raises(ValueError, match="alpha must be a"):
        f.alpha = alpha
    assert f.alpha == 1.0


@pytest.mark.contract(47)
@pytest.mark.parametrize("alpha", [0.99, 0, -1.0])
def test_alpha_below_one_is_refused(make, alpha):
    f = make(2, 1)
    with pytest.raises(ValueError, match="alpha"):
        f.alpha = alpha
    assert f.alpha == 1.0


@pytest.mark.contract(47)
def test_alpha_inflates_the_predicted_covariance(make, column):
    f = plane(make, column)
    P = f.P.copy()
    f.alpha = 1.1
    f.predict()
    np.testing.assert_allclose(f.P_prior, 1.21 * f.F @ P @ f.F.T + f.Q, rtol=1e-12)
    run(f, [[n, n] for n in range(60)])
    P = f.P.copy()
    f.predict()
    np.testing.assert_allclose(f.P_prior, 1.21 * f.F @ P @ f.F.T + f.Q, rtol=1e-9)


@pytest.mark.contract(47, better=True)
def test_an_inverse_that_works_in_place_leaves_S_alone(make, column):
    """And those of other filters of the model, which share it."""
    f, other = (run(plane(make, column), [[n, n] for n in range(60)]) for _ in range(2))

    def in_place(S):
        S[...] = np.linalg.inv(S)
        return S

    S, f.inv = f.S, in_place
    for _ in range(2):
        _ = f.SI, f.mahalanobis
    np.testing.assert_array_equal(f.S, S)
    np.testing.assert_array_equal(other.S, S)


@pytest.mark.contract(47)
def test_inv_may_be_replaced(make, column):
    """By the pseudo-inverse, by filterpy's inv_diagonal (S is diagonal here), by anything that inverts S."""
    inverted = []

    def noted(S):
        inverted.append(S.copy())
        return np.linalg.inv(S)

    f = plane(make, column)
    assert f.inv is np.linalg.inv
    for inverse in (np.linalg.pinv, inv_diagonal, noted):
        f.inv = inverse
        run(f, [[1.0, 2.0]])
        np.testing.assert_allclose(f.SI, np.linalg.inv(f.S), rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(inverted[-1], f.S)


@pytest.mark.contract(48)
@pytest.mark.parametrize(
    ("dim", "order", "by_dim"),
    [(1, 0, True), (1, 2, True), (2, 1, True), (3, 2, False)],
)
def test_kinematic_kf_sets_the_filter_up(make, dim, order, by_dim):
    """With several dimensions filterpy's H measures their sum only: unobservable, and followed even so."""
    f = make(dim * (order + 1), 1)
    built = kinematic_kf(dim, order, dt=0.5, order_by_dim=by_dim, kf=f)
    reference = kinematic_kf(dim, order, dt=0.5, order_by_dim=by_dim, kf=KalmanFilter(dim * (order + 1), 1))
    assert built is f
    np.testing.assert_array_equal(f.F, reference.F)
    np.testing.assert_array_equal(f.H, reference.H)
    zs = 3.0 + 0.5 * np.arange(60) * (order > 0)
    run(f, zs[:45])
    for z in zs[45:]:
        run(f, [z])
        assert np.isfinite(f.x).all()
        assert abs(f.y[0, 0]) < 5e-2
