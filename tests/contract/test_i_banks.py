"""I: filterpy's banks of filters."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import IMMEstimator, MMAEFilterBank

from .models import constant_velocity, flat, plane, ramp_F, run, vector, walk


def acceleration(make, column, *, brakes):
    """[position, velocity, acceleration]; ``brakes``: the model in which the acceleration is forgotten."""
    f = make(3, 1)
    f.x = vector([0.0, 1.0, 0.0], column)
    f.F = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
    f.H = np.array([[1.0, 0.0, 0.0]])
    f.Q = 1e-4 * np.eye(3)
    f.P *= 3.0
    if brakes:
        f.F[:, 2] = 0.0
        f.Q[2, 2] = 0.0
    return f


@pytest.mark.contract(61)
def test_an_imm_of_two_noise_levels_finds_the_right_one(make, column, rng):
    quiet, loud = plane(make, column), plane(make, column)
    quiet.R, loud.R = 0.1 * np.eye(2), 25.0 * np.eye(2)
    bank = IMMEstimator([quiet, loud], (0.5, 0.5), np.array([[0.97, 0.03], [0.03, 0.97]]))
    for sigma, winner in ((5.0, 1), (0.3, 0), (5.0, 1)):
        for n in range(60):
            bank.predict()
            bank.update(vector(sigma * rng.standard_normal(2) + [n, 2.0 * n], column))
            assert np.isfinite(bank.x).all()
            assert np.isfinite(bank.P).all()
            np.testing.assert_allclose(bank.mu.sum(), 1.0)
        assert bank.mu[winner] > 0.5
        quiet.x, loud.x = vector(np.zeros(4), column), vector(np.zeros(4), column)


@pytest.mark.contract(61)
def test_an_imm_tracks_within_the_measurement_noise(make, column, rng):
    slow, fast = plane(make, column, q=1e-4), plane(make, column, q=1.0)
    slow.R = fast.R = np.eye(2)
    bank = IMMEstimator([slow, fast], (0.5, 0.5), np.array([[0.9, 0.1], [0.1, 0.9]]))
    errors = []
    for n in range(200):
        bank.predict()
        truth = np.array([n, 2.0 * n])
        bank.update(vector(truth + rng.standard_normal(2), column))
        errors.append(flat(bank.x)[::2] - truth)
    assert np.sqrt(np.mean(np.square(errors[50:]))) < 1.0


@pytest.mark.contract(62)
@pytest.mark.parametrize("steps", [0, 1, 3, 60, 200])
def test_x_and_P_written_from_outside_decide_the_prior(make, column, rng, steps):
    f = plane(make, column)
    run(f, walk(rng, steps, 2))
    for z in walk(rng, 5, 2):
        x, P = rng.standard_normal(4), np.diag(rng.uniform(1.0, 9.0, 4))
        f.x, f.P = vector(x, column), P.copy()
        f.predict()
        np.testing.assert_allclose(f.x_prior, vector(f.F @ x, column), rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(f.P_prior, f.F @ P @ f.F.T + f.Q, rtol=1e-9)
        f.update(z)
        assert np.isfinite(f.x).all()


@pytest.mark.contract(62)
def test_moving_every_filter_of_a_bank_in_every_step_costs_no_accuracy(make, column):
    """What an IMM does; here it moves the filter to where it is already."""
    f = constant_velocity(make, column, q=1e-3)
    x = np.array([1.0, 2.0])
    for _ in range(100):
        f.x, f.P = vector(x, column), np.eye(2)
        x = f.F @ x
        run(f, [x[0]])
        np.testing.assert_allclose(flat(f.x), x, rtol=1e-8, atol=1e-8)


@pytest.mark.contract(63)
def test_an_mmae_bank_finds_the_model_that_accelerates(make, column, rng):
    filters = [acceleration(make, column, brakes=True), acceleration(make, column, brakes=False)]
    bank = MMAEFilterBank(filters, np.array([0.5, 0.5]), dim_x=3)
    for n in range(60):
        bank.predict()
        bank.update(n + 2.0 * n**2 + rng.standard_normal())
        assert np.isfinite(bank.x).all()
        assert np.isfinite(bank.P).all()
        np.testing.assert_allclose(bank.p.sum(), 1.0)
    assert bank.x.shape == filters[0].x.shape
    assert bank.p[1] > 0.99


@pytest.mark.contract(63)
def test_an_mmae_bank_passes_R_and_H_on(make, rng):
    bank = MMAEFilterBank(
        [constant_velocity(make), constant_velocity(make, q=1.0)], np.array([0.5, 0.5]), dim_x=2
    )
    twin = constant_velocity(make)
    for z in walk(rng, 20, 1):
        bank.predict()
        twin.predict()
        R, H = np.array([[2.0]]), np.array([[1.0, 0.5]])
        bank.update(z[:, None], R, H)
        twin.update(z[:, None], R, H)
        np.testing.assert_allclose(bank.filters[0].x, twin.x, rtol=1e-12)


@pytest.mark.contract(63)
def test_filters_of_a_bank_may_differ_in_F(make, rng):
    """A filter whose clock is wrong loses."""
    right, wrong = constant_velocity(make), constant_velocity(make)
    wrong.F = ramp_F(2.0)
    for f in (right, wrong):
        f.R = np.array([[0.01]])
        f.x = np.array([[0.0], [1.0]])
        f.P = 1e-4 * np.eye(2)
    bank = MMAEFilterBank([right, wrong], np.array([0.5, 0.5]), dim_x=2)
    for n in range(1, 4):
        bank.predict()
        bank.update(n + 0.1 * rng.standard_normal())
    assert bank.p[0] > 0.9
