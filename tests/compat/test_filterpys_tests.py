"""What filterpy's own tests demand of KalmanFilter, its numbers apart.

Rewritten from the test files of filterpy (Roger R Labbe Jr, MIT license): test_kf.py, test_imm.py,
test_mmae.py, test_rts.py, test_sensor_fusion.py, and the examples in its docstrings. Left out are those that
compare with the Kalman filter's procedural form, which is Kalman numbers.
"""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise, Q_discrete_white_noise, Saver, kinematic_kf
from filterpy.kalman import IMMEstimator, MMAEFilterBank
from scipy.linalg import block_diag
from scipy.spatial.distance import mahalanobis

from ufirext import UFIRFilter


def constant_velocity(make, *, x, P=1.0, R=1.0, Q=0.0001, dt=1.0):
    f = make(2, 1)
    f.x = np.array(x)
    f.F = np.array([[1.0, dt], [0.0, 1.0]])
    f.H = np.array([[1.0, 0.0]])
    f.P *= P
    f.R = R
    f.Q = Q
    return f


def constant_velocity_2d(make, dt=1.0):
    f = make(4, 2)
    f.x = np.array([[0.0, 0.0, 0.0, 0.0]]).T
    f.P *= np.diag([1.0, 1, 1, 1])
    f.F = np.array([[1.0, dt, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, dt], [0.0, 0.0, 0.0, 1.0]])
    f.H = np.array([[1.0, 0, 0, 0], [0.0, 0, 1, 0]])
    f.R *= np.eye(2)
    q = Q_discrete_white_noise(dim=2, dt=dt, var=0.0001)
    f.Q = block_diag(q, q)
    return f


def assert_mahalanobis(f):
    y = np.asarray(f.y, dtype=float).ravel()
    assert f.mahalanobis == pytest.approx(mahalanobis(np.zeros_like(y), y, f.SI))


@pytest.mark.parametrize("x", [[[2.0], [0.0]], [2.0, 0.0]], ids=["column", "flat"])
def test_noisy_1d(make, rng, x):
    """Update before predict, scalar R and Q, then a batch after x changed its form."""
    f = constant_velocity(make, x=x, P=1000.0, R=5)
    zs = [t + 20 * rng.standard_normal() for t in range(100)]
    for z in zs:
        f.update(z)
        f.predict()
        assert f.x.shape == np.shape(x)
        assert_mahalanobis(f)
    f.x = np.array([[2.0, 0]]).T
    f.P = np.eye(2) * 100.0
    saver = Saver(f)
    means, covariances, _, _ = f.batch_filter(zs, update_first=False, saver=saver)
    saver.to_array()
    assert len(saver.x) == len(saver) == len(zs) == len(means) == len(covariances)


def test_batch_filter(make):
    f = constant_velocity(make, x=[2.0, 0], P=1000.0, R=5)
    for update_first in (False, True):
        means, covariances, *_ = f.batch_filter([None, 1.0, 2.0], update_first=update_first)
        assert np.isfinite(means).all()
        assert np.isfinite(covariances).all()


def test_batch_with_losses_is_the_hand_loop(make):
    zs = [13.0, None, 1.0, 2.0] * 10
    f, twin = (
        constant_velocity(
            make, x=[2.0, 0], P=1000.0, R=np.eye(1) * 5, Q=Q_discrete_white_noise(2, 1.0, 0.0001)
        )
        for _ in range(2)
    )
    f.test_matrix_dimensions()
    means, covariances, _, _ = f.batch_filter(zs)
    for z, mean, covariance in zip(zs, means, covariances, strict=True):
        twin.predict()
        twin.update(z)
        np.testing.assert_allclose(mean, twin.x)
        np.testing.assert_allclose(covariance, twin.P)


def test_univariate(make):
    f = make(1, 1, 1)
    f.x = np.array([[0]])
    f.P *= 50
    f.H = np.array([[1.0]])
    f.F = np.array([[1.0]])
    f.B = np.array([[1.0]])
    f.Q = 0.02
    f.R *= 0.1
    for i in range(50):
        f.predict()
        f.update(i)
    assert f.x.shape == (1, 1)
    assert 0 < f.x[0, 0] <= 49


def test_steady_state(make):
    """kinematic_kf in seven dimensions of fifth order; its H measures the sum of the positions."""
    f = kinematic_kf(dim=7, order=5, kf=make(42, 1))
    f.x[1] = 1.0
    for i in range(40):
        f.predict()
        f.update(i)
    for i in range(40):
        f.predict_steadystate()
        f.update_steadystate(i)
        assert_mahalanobis(f)
        assert np.isfinite(f.x).all()


def test_forms_of_z(make):
    f = constant_velocity(make, x=[2, 0.0], Q=Q_discrete_white_noise(2, 1.0, 5.1))
    f.test_matrix_dimensions()
    for z in (3.0, [3], np.array([[3]])):
        f.update(z)
        assert f.x.shape == (2,)
    with pytest.raises(ValueError, match="shape"):
        f.update(np.array([[[3, 3]]]))

    f = constant_velocity_2d(make)
    for z in (3, [3], [3, 3, 3]):
        with pytest.raises(ValueError, match="shape"):
            f.update(z)
    for z in ([3, 3], [[3, 3]], [[3], [3]], np.array([[3], [3]])):
        f.update(z)


def test_matrix_dimensions(make):
    f = constant_velocity_2d(make)
    f.test_matrix_dimensions()
    f.test_matrix_dimensions(z=[[3.0], [3.0]])
    for wrong in ({"H": np.array(3)}, {"R": np.array([3, 4.0])}, {"R": [3]}, {"z": 3.0}, {"z": [3.0]}):
        with pytest.raises((AssertionError, ValueError)):
            f.test_matrix_dimensions(**wrong)
    f.R = np.diag([3, 4.0])
    f.test_matrix_dimensions()

    f = constant_velocity(make, x=[2, 0.0], R=np.eye(1), Q=Q_discrete_white_noise(2, 1.0, 5.1))
    for x in (np.array([0.0, 0.0]), np.array([[0.0, 0.0]]).T):
        f.x = x
        f.update([[3]])
        f.test_matrix_dimensions(z=3.0)
        f.test_matrix_dimensions(z=[3.0])


def test_default_dims(make):
    """A filter of which nothing but the dimensions was set."""
    f = make(3, 1)
    f.predict()
    f.update(np.array([[1.0]]).T)
    for z in (3.0, [3], (3), [[3]], np.array([[3]])):
        f.update(z)
    with pytest.raises(ValueError, match="shape"):
        f.update([[3, 3]])
    f = make(3, 2)
    for z in ([3, 4], [[3, 4]], np.array([[3, 4]]), np.array([[3, 4]]).T):
        f.update(z)


def test_imm_of_crassidis(make, rng):
    """Example 4.6 of Crassidis and Junkins, as far as filterpy goes: no predictions, P of 1e-12."""
    block = np.array([[1, 1, 0.5], [0, 1, 1], [0, 0, 1]])
    q = np.array([[0.05, 0.125, 1 / 6], [0.125, 1 / 3, 0.5], [1 / 6, 0.5, 1]]) * 1e-3
    filters = []
    for scale in (1.0, 0.0):
        f = make(6, 2)
        f.F = block_diag(block, block)
        f.x = np.array([[2000.0, 0, 0, 10000, -15, 0]]).T
        f.P *= 1e-12
        f.Q *= 0
        f.Q[0:3, 0:3] = scale * q
        f.Q[3:6, 3:6] = scale * q
        f.H = np.array([[1, 0, 0, 0, 0, 0], [0, 0, 0, 1, 0, 0]])
        filters.append(f)
    bank = IMMEstimator(filters, (0.5, 0.5), np.array([[0.97, 0.03], [0.03, 0.97]]))
    for _ in range(10):
        bank.update(np.array([[2000.0], [10000.0]]) + rng.standard_normal((2, 1)))
        assert np.isfinite(bank.x).all()
        assert bank.mu.sum() == pytest.approx(1.0)
        assert repr(bank).startswith("IMMEstimator")


def test_imm_of_the_docstring(make, rng):
    filters = [kinematic_kf(1, 1, kf=make(2, 1)) for _ in range(2)]
    filters[1].Q *= 0
    bank = IMMEstimator(filters, [0.5, 0.5], np.array([[0.97, 0.03], [0.03, 0.97]]))
    for i in range(100):
        bank.predict()
        bank.update(np.array([[i + rng.standard_normal()]]))
    assert abs(bank.x[0, 0] - 99) < 3.0


def test_mmae(make, rng):
    """In one model the acceleration is struck out: F is singular.

    filterpy's test zeroes Q[2, 2] alone, which leaves Q indefinite: that is refused here (next test), so
    the whole row and column go.
    """
    dt = 0.1
    filters = []
    for keeps in (False, True):
        f = make(3, 1)
        f.x = np.array([0.0, 0.0, 0.0])
        f.P *= 3
        f.R *= 0.6**2
        f.Q = Q_discrete_white_noise(dim=3, dt=dt, var=0.02)
        f.F = np.array([[1, dt, 0.5 * dt * dt], [0, 1, dt], [0, 0, 1]], dtype=float)
        f.H = np.array([[1, 0, 0]], dtype=float)
        if not keeps:
            f.F[:, 2] = 0
            f.P[2, 2] = 0
            f.Q[2, :] = f.Q[:, 2] = 0
        filters.append(f)
    bank = MMAEFilterBank(filters, (0.5, 0.5), dim_x=3)
    for i in range(120):
        bank.predict()
        bank.update(0.3 * i + 0.6 * rng.standard_normal())
        assert np.isfinite(bank.x).all()
        assert np.sum(bank.p) == pytest.approx(1.0)
    assert abs(bank.x[0] - 0.3 * 119) < 2.0


def test_an_indefinite_Q_is_refused_at_the_next_verb():
    f = UFIRFilter(3, 1)
    f.Q = Q_discrete_white_noise(dim=3, dt=0.1, var=0.02)
    f.Q[2, 2] = 0.0
    with pytest.raises(ValueError, match="Q must be positive semidefinite"):
        f.predict()


def test_two_sensors_are_better_than_one(make, rng):
    def spread(sigmas):
        dt = 0.1
        f = make(2, len(sigmas))
        f.F = np.array([[1.0, dt], [0.0, 1.0]])
        f.H = np.array([[1.0, 0.0]] * len(sigmas))
        f.x = np.array([[0.0], [10.0]])
        f.Q = np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]) * 0.02
        f.P *= 100
        f.R = np.diag(np.square(sigmas))
        errors = []
        for noise in noises:
            f.predict()
            f.update((len(errors) + 1.0 + sigmas * noise[: len(sigmas)])[:, None])
            errors.append(f.x[0, 0] - len(errors) - 1.0)
        return np.std(errors)

    noises = rng.standard_normal((400, 2))
    assert spread(np.array([2.0, 1.0])) < spread(np.array([2.0]))


def test_rts_smooths(make, rng):
    """The smoothed positions of a batch lie nearer the truth than the filtered ones."""
    f = constant_velocity(
        make, x=[2.0, 0], P=10.0, R=np.eye(1) * 5.0, Q=Q_discrete_white_noise(2, 1.0, 0.001)
    )
    truth = np.arange(100.0)
    means, covariances, _, _ = f.batch_filter(list(truth + np.sqrt(5.0) * rng.standard_normal(100)))
    smoothed, _, _, _ = f.rts_smoother(means, covariances)
    assert smoothed.shape == means.shape
    assert np.std(smoothed[:90, 0] - truth[:90]) < np.std(means[:90, 0] - truth[:90])


def test_a_saver_as_its_docstring_shows_it(make):
    f = kinematic_kf(dim=1, order=2, dt=0.1, kf=make(3, 1))
    f.Q = Q_continuous_white_noise(3, 0.1, 0.1)
    saver = Saver(f)
    for i in range(50):
        f.predict()
        f.update([[i]])
        saver.save()
    assert np.array(saver.x).shape == (50, 3, 1)
    assert len(saver["P"]) == 50
    saver.to_array(flatten=True)
    assert saver.x.shape == (50, 3)
    assert saver.z.shape == (50,)
