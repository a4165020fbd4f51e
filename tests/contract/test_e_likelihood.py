"""E: likelihoods and distances."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from .models import constant_velocity, flat, plane, run, vector, walk


@pytest.mark.contract(38)
def test_log_likelihood_is_the_log_density_of_the_innovation(make, column, rng):
    f = plane(make, column)
    for z in walk(rng, 60, 2):
        run(f, [z])
        expected = multivariate_normal.logpdf(flat(f.y), np.zeros(2), f.S)
        np.testing.assert_allclose(f.log_likelihood, expected, rtol=1e-9)
        np.testing.assert_allclose(f.likelihood, math.exp(expected), rtol=1e-8)


@pytest.mark.contract(38)
def test_log_likelihood_of_a_scalar_measurement(make, column, rng):
    f = constant_velocity(make, column)
    for z in walk(rng, 60, 1):
        run(f, [z])
        variance = f.S[0, 0]
        expected = -0.5 * (math.log(2 * math.pi * variance) + flat(f.y)[0] ** 2 / variance)
        np.testing.assert_allclose(f.log_likelihood, expected, rtol=1e-9)


@pytest.mark.contract(38)
@pytest.mark.parametrize("name", ["log_likelihood", "likelihood", "mahalanobis"])
def test_likelihoods_are_properties_computed_when_read(make, name):
    assert isinstance(getattr(type(make(2, 1)), name), property)


@pytest.mark.contract(38)
def test_a_likelihood_may_be_read_as_often_as_one_likes(make, column, rng):
    f, twin = plane(make, column), plane(make, column)
    for z in walk(rng, 60, 2):
        run(f, [z])
        run(twin, [z])
        assert f.likelihood == f.likelihood
        assert f.mahalanobis == f.mahalanobis
        np.testing.assert_array_equal(f.x, twin.x)


@pytest.mark.contract(39)
def test_likelihood_is_never_zero(make, column):
    f = constant_velocity(make, column)
    run(f, [*range(60), 1e9])
    assert f.likelihood == sys.float_info.min
    assert -np.inf < f.log_likelihood < math.log(sys.float_info.min)


@pytest.mark.contract(40)
def test_mahalanobis_is_the_length_of_the_innovation_in_standard_deviations(make, column, rng):
    f = plane(make, column)
    for z in walk(rng, 60, 2):
        run(f, [z])
        y = flat(f.y)
        assert isinstance(f.mahalanobis, float)
        np.testing.assert_allclose(f.mahalanobis, math.sqrt(y @ np.linalg.inv(f.S) @ y), rtol=1e-9)


@pytest.mark.contract(40)
def test_a_fresh_filter_answers(make):
    f = make(4, 2)
    assert f.mahalanobis == 0.0
    assert f.likelihood == pytest.approx(sys.float_info.min)
    assert f.log_likelihood == math.log(sys.float_info.min)


@pytest.mark.contract(40)
def test_a_filter_that_has_only_predicted_answers(make, column):
    f = plane(make, column)
    f.predict()
    assert isinstance(f.mahalanobis, float)
    assert 0.0 < f.likelihood < np.inf
    assert np.isfinite(f.log_likelihood)


@pytest.mark.contract(41)
def test_log_likelihood_of_a_measurement_that_was_not_used(make, column, rng):
    """As in filterpy: N(z; H x, S) with the x of now and the S of the last update."""
    f = plane(make, column)
    for z in walk(rng, 60, 2):
        run(f, [z])
        other = z + np.array([1.0, -2.0])
        expected = multivariate_normal.logpdf(other, f.H @ flat(f.x), f.S)
        before = flat(f.x)
        for form in (list(other), other, other[:, None]):
            np.testing.assert_allclose(f.log_likelihood_of(form), expected, rtol=1e-9)
        np.testing.assert_array_equal(flat(f.x), before)


@pytest.mark.contract(41)
def test_log_likelihood_of_no_measurement_is_the_smallest_there_is(make, column):
    f = constant_velocity(make, column)
    run(f, [1.0, 2.0])
    assert f.log_likelihood_of(None) == math.log(sys.float_info.min)


@pytest.mark.contract(41)
def test_likely_measurements_score_higher(make, column):
    f = plane(make, column)
    run(f, [vector([n, 2.0 * n], column) for n in range(60)])
    near, far = f.H @ flat(f.x), f.H @ flat(f.x) + 5.0
    assert f.log_likelihood_of(near) > f.log_likelihood_of(far)
