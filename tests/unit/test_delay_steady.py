"""The hot path of the delay filters is the filter: streams of all that clients do, against slow twins."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from numpy.testing import assert_allclose

from tests.theory.delays import F1, H1, Q1, R1
from ufirext.filters._steady import INTERVAL, SLOW
from ufirext.filters.hinfinity import DelayHInfinityFilter
from ufirext.filters.kalman import DelayKalmanFilter

PUBLISHED = ("x", "P", "x_prior", "P_prior", "x_post", "P_post", "y", "S", "K", "log_likelihood")
KALMAN = {
    "exact": {},
    "exact, late ones allowed": {"max_delay": 2},
    "augmented": {"method": "augmented"},
    "white": {"method": "white", "max_delay": 1},
}
ROBUST = {
    "posterior": {"theta": 0.002},
    "prior": {"theta": 0.001, "form": "prior"},
    "auto": {"theta": "auto"},
    "mixed": {"theta": 1e-4, "form": "mixed"},
    "clipped": {"theta": 1e3, "on_violation": "clip"},
}


def tracker(make: Any, **options: Any) -> Any:
    f = make(2, 1, **options)
    f.F, f.H, f.Q, f.R = F1.copy(), H1.copy(), Q1.copy(), R1.copy()
    return f


def disturb(rng: np.random.Generator, filters: list[Any], names: tuple[str, ...]) -> None:
    """What clients do between steps, the same to all filters."""
    match int(rng.integers(0, 9)):
        case 0:
            move = rng.normal(size=(2, 1))
            for f in filters:
                f.x = f.x + move
        case 1:
            for f in filters:
                f.x[0] += 1.0
        case 2:
            for f in filters:
                f.P[0, 0] += 1.0
        case 3:
            for f in filters:
                f.P = 3.0 * np.eye(2)
        case 4:
            scale = rng.uniform(0.5, 2.0)
            for f in filters:
                f.R = R1 * scale
        case 5:
            for f in filters:
                f.F[0, 1] = 1.0 + 0.1 * (f.F[0, 1] == 1.0)
        case 6:
            for f in filters:
                f.Q = Q1 * 1.0
        case 7:
            for f in filters:
                f.alpha = 1.01 if f.alpha == 1.0 else 1.0
        case 8:
            same(filters, names)


def same(filters: list[Any], names: tuple[str, ...]) -> None:
    """Everything published agrees with the first filter."""
    for f in filters[1:]:
        for name in names:
            assert_allclose(getattr(f, name), getattr(filters[0], name), rtol=1e-9, atol=1e-9, err_msg=name)


def stream(seed: int, filters: list[Any], names: tuple[str, ...], steps: int = 1500) -> int:
    """Play it; how often the last filter was on its hot path."""
    rng, hot = np.random.default_rng(seed), 0
    for step in range(steps):
        if rng.random() < 0.01:
            disturb(rng, filters, names)
        for f in filters:
            f.predict()
        if rng.random() < 0.004:
            disturb(rng, filters, names)
        z = None if rng.random() < 0.005 else rng.normal(size=(1, 1)) * 3.0
        R = 5.0 if rng.random() < 0.005 else None
        for f in filters:
            f.update(z, R=R)
        if rng.random() < 0.02:
            same(filters, names)
        if rng.random() < 0.01:
            filters[-1] = [copy.deepcopy, lambda f: pickle.loads(pickle.dumps(f))][step % 2](filters[-1])
        hot += filters[-1]._state.mode != SLOW
        assert_allclose(filters[-1].x, filters[0].x, rtol=1e-9, atol=1e-9)
    return hot


@pytest.mark.parametrize("options", KALMAN.values(), ids=KALMAN)
@pytest.mark.parametrize("seed", [0, 1])
def test_a_client_sees_filterpys_kalman_filter_whatever_it_does(options, seed):
    filters = [tracker(KalmanFilter), tracker(DelayKalmanFilter, **options)]
    assert stream(seed, filters, PUBLISHED[:6]) > 200


@pytest.mark.parametrize("options", ROBUST.values(), ids=ROBUST)
def test_a_client_sees_the_slow_hinfinity_filter_whatever_it_does(options):
    class Slow(DelayHInfinityFilter):
        def predict(self, *args: Any, **more: Any) -> None:
            self._state.settle()
            super().predict(*args, **more)

    filters = [tracker(Slow, **options), tracker(DelayHInfinityFilter, **options)]
    try:
        hot = stream(2, filters, PUBLISHED)
    except ValueError as error:
        pytest.fail(str(error))
    assert hot > 200
    told, expected = filters[1].guarantee, filters[0].guarantee
    assert (told.steps, told.clipped) == (expected.steps, expected.clipped)
    assert (*told.theta, told.theta_max) == pytest.approx((*expected.theta, expected.theta_max), rel=1e-9)


@pytest.mark.parametrize("name", ["F", "H", "Q", "R"])
def test_an_array_the_client_holds_may_be_edited_at_any_time(name):
    rng = np.random.default_rng(7)
    kf, f = tracker(KalmanFilter), tracker(DelayKalmanFilter)
    held = [np.array(getattr(kf, name)) for _ in range(2)]
    kf.__setattr__(name, held[0])
    f.__setattr__(name, held[1])
    for step in range(400):
        if step == 300:
            assert f._state.mode != SLOW
            for array in held:
                array *= 1.5
        z = rng.normal(size=(1, 1))
        for filter_ in (kf, f):
            filter_.predict()
            filter_.update(z)
        assert_allclose(f.x, kf.x, rtol=1e-9, atol=1e-9)
    assert_allclose(f.P, kf.P, rtol=1e-9)


def test_fading_memory_may_begin_at_any_time():
    rng = np.random.default_rng(8)
    kf, f = tracker(KalmanFilter), tracker(DelayKalmanFilter)
    for step in range(400):
        if step == 300:
            assert f._state.mode != SLOW
            kf.alpha = f.alpha = 1.05
        z = rng.normal(size=(1, 1))
        for filter_ in (kf, f):
            filter_.predict()
            filter_.update(z)
        assert_allclose(f.x, kf.x, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("form", ["posterior", "prior"])
def test_the_guarantee_counts_the_hot_steps(form):
    f = tracker(DelayHInfinityFilter, theta=0.001, form=form)
    for step in range(400):
        f.predict()
        f.update(float(step))
    assert f._state.mode != SLOW
    assert f.guarantee.steps == 400
    f.predict()
    assert f.guarantee.steps == 400 + (form == "prior")


def test_a_caller_may_reuse_its_array_of_measurements():
    f, z = tracker(DelayKalmanFilter), np.zeros((1, 1))
    for step in range(200):
        z[0, 0] = step
        f.predict()
        f.update(z)
    z[0, 0] = -1.0
    assert f.z.item() == 199.0
    assert f.y.item() == pytest.approx(199.0 - f.x_prior[0, 0])


@pytest.mark.parametrize("z", [[1.0, 2.0], np.zeros((2, 2)), np.inf, "five", [[1.0], [2.0]]])
def test_the_hot_path_refuses_what_the_slow_one_refuses(z):
    f = tracker(DelayKalmanFilter)
    for step in range(200):
        f.predict()
        f.update(float(step))
    f.predict()
    assert f._state.mode != SLOW
    with pytest.raises(ValueError, match="z must"):
        f.update(z)
    f.update([1.0])
    assert np.isfinite(f.x).all()


@pytest.mark.parametrize("argument", ["F", "Q"])
@pytest.mark.parametrize("switch", range(120, 120 + INTERVAL))
def test_steps_by_other_matrices_do_not_make_the_filters_own_stand_still(argument, switch):
    kf, f = tracker(KalmanFilter), tracker(DelayKalmanFilter)
    other = {"F": np.array([[1.0, 0.5], [0.0, 1.0]]), "Q": 3.0 * Q1}[argument]
    for step in range(switch + 5):
        for filter_ in (kf, f):
            filter_.predict(**({argument: other} if step < switch else {}))
            filter_.update(float(step % 3))
        assert_allclose(f.x, kf.x, rtol=1e-9, atol=1e-9)
