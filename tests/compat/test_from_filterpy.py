"""UFIRFilter.from_filterpy takes a configured filter over, at any moment of its life."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.common import inv_diagonal
from filterpy.kalman import KalmanFilter

from ufirext import UFIRFilter


@pytest.fixture(params=[True, False], ids=["column", "flat"])
def configured(request):
    kf = KalmanFilter(4, 2, 1)
    kf.x = np.array([[1.0], [2.0], [3.0], [4.0]]) if request.param else np.array([1.0, 2.0, 3.0, 4.0])
    kf.F = np.kron(np.eye(2), [[1.0, 1.0], [0.0, 1.0]])
    kf.H = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0]])
    kf.B = np.array([[0.5], [1.0], [0.5], [1.0]])
    kf.P *= 10.0
    kf.Q *= 0.01
    kf.R = np.diag([4.0, 1.0])
    kf.alpha = 1.02
    kf.inv = inv_diagonal
    return kf


@pytest.mark.parametrize("steps", [0, 20])
def test_the_model_and_the_state_are_taken_over(configured, steps):
    for n in range(steps):
        configured.predict()
        configured.update([n, 2.0 * n])
    f = UFIRFilter.from_filterpy(configured, horizon=8)
    assert (f.dim_x, f.dim_z, f.dim_u, f.horizon, f.inv) == (4, 2, 1, 8, inv_diagonal)
    assert f.alpha == pytest.approx(1.02)
    for name in ("x", "P", "F", "H", "Q", "R", "B", "M"):
        np.testing.assert_array_equal(getattr(f, name), getattr(configured, name))
        assert not np.shares_memory(getattr(f, name), getattr(configured, name))
    f.predict(0.5)
    configured.predict(np.array([[0.5]]) if configured.x.ndim == 2 else np.array([0.5]))
    np.testing.assert_allclose(f.x, configured.x, rtol=1e-12)
    np.testing.assert_allclose(f.P, configured.P, rtol=1e-12)


def test_the_filter_that_was_taken_over_is_left_alone(configured):
    before = {name: getattr(configured, name).copy() for name in ("x", "P", "F", "H", "Q", "R", "B")}
    f = UFIRFilter.from_filterpy(configured, horizon=8)
    f.F[0, 1] = 9.0
    for n in range(20):
        f.predict()
        f.update([n, 2.0 * n])
    for name, value in before.items():
        np.testing.assert_array_equal(getattr(configured, name), value)


def test_it_follows_exact_data_from_there(configured):
    f = UFIRFilter.from_filterpy(configured)
    for n in range(30):
        f.predict()
        f.update([n, 2.0 * n])
    np.testing.assert_allclose(f.x.ravel(), [29.0, 1.0, 58.0, 2.0], atol=1e-9)
    assert isinstance(f.horizon, int)


def test_scalar_R_and_Q_are_taken_over(configured):
    configured.R, configured.Q = 5.0, 0.1
    f = UFIRFilter.from_filterpy(configured, horizon=8)
    f.predict()
    f.update([1.0, 2.0])
    np.testing.assert_allclose(f.S - f.H @ f.P_prior @ f.H.T, 5.0 * np.eye(2), atol=1e-9)
