"""What leaves an estimate as it is, whichever filter made it: how a loss is told, and units."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tests.strategies import positive, random_model, seeds
from tests.theory.delays import F1, H1, Q1, R1
from ufirext import (
    CovarianceError,
    DelayHInfinityFilter,
    DelayKalmanFilter,
    FMSFilterSmoother,
    Model,
    UFIRFilter,
    minimum_variance_gain,
    ufir_gain,
    worst_case_gain,
)
from ufirext.channels import BernoulliDelay

few = settings(max_examples=15)
MAKERS = {
    "ufir": lambda n, m, S, **late: UFIRFilter(n, m, horizon=7, **late),
    "fms": lambda n, m, S, **late: FMSFilterSmoother(n, m, horizon=7, lag=2, **late),
    "exact": lambda n, m, S, **late: DelayKalmanFilter(n, m, **late),
    "augmented": lambda n, m, S, **late: DelayKalmanFilter(n, m, method="augmented", **late),
    "posterior": lambda n, m, S, **late: DelayHInfinityFilter(n, m, S=S, **late),
    "prior": lambda n, m, S, **late: DelayHInfinityFilter(n, m, form="prior", S=S, **late),
}
LATE = ({"max_delay": 2}, {"channel": BernoulliDelay(0.7)})


def configured(name: str, model: Model, P0: Any, S: Any, **late: Any) -> Any:
    f = MAKERS[name](model.dim_x, model.dim_z, S, **late)
    f.F, f.H, f.Q, f.R, f.P = model.F, model.H, model.Q, model.R, P0
    return f


@pytest.mark.parametrize("late", LATE, ids=["stamped", "unstamped"])
@pytest.mark.parametrize("name", MAKERS)
def test_missing_is_nan_is_absent_bit_for_bit(name, late):
    rng = np.random.default_rng(0)
    model = Model(F1, H1, Q1, R1)
    told = [configured(name, model, np.eye(2), np.eye(2), **late) for _ in range(3)]
    for step in range(40):
        z = None if rng.random() < 0.3 else rng.normal(size=1)
        delay = min(step, int(rng.integers(0, 3))) if "max_delay" in late else 0
        for way, f in enumerate(told):
            f.predict()
            if z is not None:
                f.update(z, delay=delay)
            elif way == 0:
                f.update(None)
            elif way == 1:
                f.update(np.array([np.nan]), delay=delay)
        for f in told[1:]:
            assert np.array_equal(f.x, told[0].x)
            assert np.array_equal(f.P, told[0].P)


@few
@given(seeds, st.sampled_from(sorted(MAKERS)), st.sampled_from(LATE))
def test_other_units_of_states_and_measurements_give_the_same_estimate(seed, name, late):
    """Kilometres, hours or grams: x, P and what is measured scale, and nothing else happens."""
    rng = np.random.default_rng(seed)
    model = random_model(seed, 3, 2, "oscillating")
    P0, S = positive(rng, 3), positive(rng, 3)
    state, seen = 10.0 ** rng.uniform(-3, 3, 3), 10.0 ** rng.uniform(-3, 3)
    scaled = Model(
        state[:, None] * model.F / state,
        seen * model.H / state,
        np.outer(state, state) * model.Q,
        seen**2 * model.R,
    )
    f = configured(name, model, P0, S, **late)
    g = configured(name, scaled, np.outer(state, state) * P0, S / np.outer(state, state), **late)
    for step in range(15):
        z = rng.normal(size=2)
        if step % 5 == 3:
            z[step % 2] = np.nan
        for filter_, unit in ((f, 1.0), (g, seen)):
            filter_.predict()
            filter_.update(unit * z, delay=min(step, step % 3) if "max_delay" in late else 0)
    size = np.sqrt(np.diag(f.P))
    assert_allclose(g.x.ravel() / state, f.x.ravel(), atol=1e-8 * max(1.0, size.max()))
    assert_allclose(g.P / np.outer(state, state), f.P, atol=1e-8 * max(1.0, np.abs(f.P).max()))


@pytest.mark.parametrize("kind", [UFIRFilter, FMSFilterSmoother])
@pytest.mark.parametrize("changing", [False, True])
@pytest.mark.parametrize("missing", ["extend", "skip"])
def test_one_precise_row_is_forgotten_with_its_window(kind, changing, missing):
    """Rows that say nothing beside it count as missing for a horizon, and no longer."""
    f = kind(2, 1, horizon=8, **({"missing": missing} if kind is UFIRFilter else {}))
    f.F, f.H, f.R, f.Q = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]]), 1e4, 0.01 * np.eye(2)
    for n in range(120):
        f.predict(F=np.array([[1.0, 1.0 + 1e-12 * n], [0.0, 1.0]]) if changing else None)
        f.update(3.0 * n, R=1e-5 if n == 10 else None)
        assert n < 10 or 18 < n < 24 or abs(f.x[0, 0] - 3.0 * n) < 40.0
    assert f.ready
    np.testing.assert_allclose(f.x.ravel(), [357.0, 3.0], rtol=1e-6)


@pytest.mark.parametrize("R", [1e-3, 1e-7, 1e-8, 1e-10, 1e-16, 1e-30, 1e-200])
@pytest.mark.parametrize("lag", [0, 2])
def test_a_precise_row_means_the_same_to_a_model_that_is_constant_and_to_one_that_is_not(R, lag):
    """However heavy it is; a step with another Q, which UFIR does not ask for, is all the change."""
    rng, filters = np.random.default_rng(0), [UFIRFilter(2, 1, horizon=8) for _ in range(2)]
    for f in filters:
        f.F, f.H, f.Q = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]]), 0.01 * np.eye(2)
    for n in range(45):
        z = 2.0 * n + rng.normal()
        filters[0].predict()
        filters[1].predict(Q=np.eye(2) if n == 10 else None)
        for f in filters:
            f.update(z, R=R if n == 20 else None, delay=lag if n == 20 else 0)
        np.testing.assert_allclose(filters[0].x, filters[1].x, atol=1e-5)
    assert abs(filters[0].x[0, 0] - 88.0) < 4.0


@pytest.mark.parametrize("kind", [UFIRFilter, FMSFilterSmoother])
@given(unit=st.sampled_from([1.0, 1e3, 1e6, 1e9]))
def test_sensors_of_different_quantities_never_drown_each_other(kind, unit):
    """Position in m and clock bias in s, ms, us or ns, one after the other: as good as both at once."""
    A = np.array([[1.0, 1.0], [0.0, 1.0]])
    F, units = np.kron(np.eye(2), A), np.array([1.0, 1.0, unit, unit])
    H = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
    R, Q = np.diag([1.0, 1e-16 * unit**2]), np.diag(np.array([1e-2, 1e-2, 1e-20, 1e-20]) * units**2)
    rng, filters = np.random.default_rng(0), [kind(4, 2, horizon=10) for _ in range(2)]
    for f in filters:
        f.F, f.H, f.R, f.Q = F, H, R, Q
    for n in range(40):
        z = np.array([2.0 * n + rng.normal(), (1e-6 + 1e-9 * n + 1e-8 * rng.normal()) * unit])
        for f in filters:
            f.predict()
        filters[0].update(z)
        for i in range(2):
            filters[1].update(z[i], R=R[i : i + 1, i : i + 1], H=H[i : i + 1])
    assert all(f.ready for f in filters)
    np.testing.assert_allclose(filters[1].x.ravel() / units, filters[0].x.ravel() / units, rtol=1e-6)


@pytest.mark.parametrize("scale", [1e-10, 1e-4, 1.0, 1e6])
@pytest.mark.parametrize("changing", [False, True])
def test_an_exact_measurement_among_others_is_met(scale, changing):
    """R = 0 beside others of variance `scale`: the estimate goes through it, whatever the units."""
    f = UFIRFilter(2, 1, horizon=10)
    f.F, f.H, f.R, f.Q = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]]), scale, 1e-6 * np.eye(2)
    for n in range(20):
        f.predict(F=np.array([[1.0, 1.0 + 1e-12 * n], [0.0, 1.0]]) if changing else None)
        f.update(float(n))
    f.predict()
    f.update(25.0, R=0.0)
    np.testing.assert_allclose(f.x[0, 0], 25.0, rtol=1e-6)
    assert 0.0 <= f.P[0, 0] < 1e-3 * max(scale, 1e-6)


@pytest.mark.parametrize("kind", [UFIRFilter, FMSFilterSmoother])
@pytest.mark.parametrize("changing", [False, True])
@pytest.mark.parametrize("R", [5e-324, 1e-310, 1e-290])
def test_a_variance_whose_inverse_is_beyond_all_numbers_is_refused(kind, changing, R):
    f, twin = (kind(2, 1, horizon=10) for _ in range(2))
    for g in (f, twin):
        g.F, g.H, g.Q = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]]), 0.01 * np.eye(2)
    for n in range(60):
        for g in (f, twin):
            g.predict(F=np.array([[1.0, 1.0 + 1e-12 * n], [0.0, 1.0]]) if changing else None)
        if n % 7 == 3:
            with pytest.raises(CovarianceError, match="R must hold variances of at least 1e-280, or 0"):
                f.update(float(n), R=R)
        for g in (f, twin):
            g.update(float(n))
        np.testing.assert_allclose(f.x, twin.x, rtol=1e-9, atol=1e-9)
    for gain in (ufir_gain, minimum_variance_gain):
        with pytest.raises(CovarianceError, match="measure in a smaller unit"):
            gain(Model([[1.0]], [[1.0]], R=R), 5)


def test_where_all_are_exact_none_outweighs_another():
    f, g = (UFIRFilter(2, 1, horizon=6) for _ in range(2))
    for h, R in ((f, 0.0), (g, 1.0)):
        h.F, h.H, h.R = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]]), R
    rng = np.random.default_rng(0)
    for n in range(20):
        z = n + rng.normal()
        for h in (f, g):
            h.predict()
            h.update(z)
    np.testing.assert_allclose(f.x, g.x, rtol=1e-12)


def test_a_row_whose_finer_component_alone_has_another_variance_gets_its_own_weight():
    """Kilometres beside microradians: the variance of the angle is nothing beside that of the range."""
    units, filters = (np.ones(2), np.array([1e3, 1e-6])), [UFIRFilter(2, 2, horizon=6) for _ in range(2)]
    for f, unit in zip(filters, units, strict=True):
        f.F, f.H, f.R = np.array([[1.0, 1.0], [0.0, 1.0]]), np.outer(unit, [1.0, 0.0]), np.diag(unit**2)
    rng = np.random.default_rng(0)
    for n in range(30):
        z, R = rng.normal(size=2), np.diag([1.0, 400.0 if n == 18 else 1.0])
        for f, unit in zip(filters, units, strict=True):
            f.predict()
            f.update(unit * z, R=R * unit**2)
        np.testing.assert_allclose(filters[1].x, filters[0].x, rtol=1e-9)


@pytest.mark.parametrize("unit", [1e-12, 1e12])
def test_disturbances_and_weights_of_small_numbers_count_in_worst_cases(unit):
    F, units = np.array([[1.0, 1.0], [0.0, 1.0]]), np.diag([1.0, unit])
    back, K = np.linalg.inv(units), np.array([[0.6], [0.2]])
    gains = [
        worst_case_gain([T @ K] * 5, T @ F @ T1, np.eye(1, 2) @ T1, T @ T, 1.0, P0=T @ T, S=T1 @ T1).gain
        for T, T1 in ((np.eye(2), np.eye(2)), (units, back))
    ]
    np.testing.assert_allclose(gains[1], gains[0], rtol=1e-9)
