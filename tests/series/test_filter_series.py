"""filter_series gives the numbers of the streaming classes, whatever the series looks like."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.engines.streams import MODELS
from tests.oracles import Stacked, naive_gain
from tests.strategies import models, seeds
from ufirext import (
    Model,
    NonFiniteError,
    SeriesEstimate,
    ShapeError,
    UfirextError,
    UFIRFilter,
    UnobservableWindow,
    filter_series,
    kinematic,
    series_plan,
)
from ufirext.gains import observability_index

NAMES = sorted(MODELS)


def measured(model, steps, seed=0, count=None):
    """A wandering series, or `count` of them."""
    rng = np.random.default_rng(seed)
    shape = (steps, model.dim_z) if count is None else (count, steps, model.dim_z)
    return rng.normal(size=shape).cumsum(axis=-2)


def assert_same(a, b, tolerance=1e-12):
    """Equal where ready, relative to the largest value of each state."""
    np.testing.assert_array_equal(a.ready, b.ready)
    np.testing.assert_array_equal(np.isnan(a.x), np.isnan(b.x))
    scale = np.nanmax(np.abs(b.x), axis=tuple(range(b.x.ndim - 1)), initial=1e-300)
    assert np.nanmax(np.abs(a.x - b.x) / scale, initial=0.0) < tolerance


@pytest.mark.parametrize("lag", [0, 3])
@pytest.mark.parametrize("horizon", [5, 31, 80])
@pytest.mark.parametrize("name", NAMES)
def test_a_series_is_the_stream(name, horizon, lag):
    model = MODELS[name]
    zs = measured(model, 200, count=2)
    assert_same(
        filter_series(model, zs, horizon, lag=lag),
        filter_series(model, zs, horizon, lag=lag, engine="stepwise"),
    )


@pytest.mark.parametrize("lag", [0, 3])
@pytest.mark.parametrize("name", NAMES)
def test_minimum_variance_is_the_fms_stream(name, lag):
    model = MODELS[name]
    noise, zs = (model.Q, 2.0 * model.R), measured(model, 150)
    assert_same(
        filter_series(model, zs, 20, lag=lag, noise=noise),
        filter_series(model, zs, 20, lag=lag, noise=noise, engine="stepwise"),
    )


def test_the_stepwise_engine_is_the_filter_a_user_would_write():
    model, zs = kinematic(1, 1, 0.5), np.random.default_rng(0).normal(size=40)
    f = UFIRFilter(2, 1, horizon=8)
    f.F, f.H, f.Q, f.R = model.F, model.H, model.Q, model.R
    states = []
    for z in zs:
        f.predict()
        f.update(z)
        states.append(f.x.ravel())
    estimate = filter_series(model, zs, 8, engine="stepwise")
    np.testing.assert_array_equal(estimate.x[1:], np.array(states)[1:])


@settings(max_examples=60, deadline=None)
@given(models(max_x=4, max_z=2), st.integers(1, 70), st.integers(0, 3), st.integers(0, 90), seeds)
def test_any_model_any_length(model, horizon, lag, steps, seed):
    index = observability_index(model)
    zs = measured(model, steps, seed)
    lag = min(lag, horizon - 1)
    if index is None or horizon < index:
        with pytest.raises(UnobservableWindow):
            filter_series(model, zs, horizon, lag=lag)
        return
    try:
        ours = filter_series(model, zs, horizon, lag=lag)
    except UnobservableWindow:
        assert lag
        return
    assert_same(ours, filter_series(model, zs, horizon, lag=lag, engine="stepwise"), tolerance=1e-8)


@pytest.mark.parametrize("horizon", [49, 100, 500])
@pytest.mark.parametrize(
    "model",
    [
        kinematic(1, 1, 0.1),
        kinematic(2, 1, 0.1),
        kinematic(2, 3, 0.1),
        Model([[0.95, 0.1], [0.0, 0.9]], [[1.0, 0.0]]),
        Model([[1.05, 0.0], [0.0, 0.9]], [[1.0, 1.0]]),
        Model([[1.05]], [[1.0]]),
    ],
    ids=["velocity", "acceleration", "9 states", "damped", "unstable of two", "unstable"],
)
def test_full_windows_are_least_squares_to_twelve_digits(model, horizon):
    """Against stacked equations solved anew; relative to what the gain makes of measurements of that size."""
    zs = measured(model, horizon + 40)
    x = filter_series(model, zs, horizon).x
    K = naive_gain(full_window(model, horizon))
    for last in (horizon - 1, horizon + 7, horizon + 39):
        window = zs[last - horizon + 1 : last + 1].ravel()
        assert (np.abs(x[last] - K @ window) <= 1e-12 * (np.abs(K) @ np.abs(window))).all()


def full_window(model, horizon):
    """The stacked equations of a full window."""
    powers = [np.eye(model.dim_x)]
    for _ in range(horizon - 1):
        powers.append(model.F @ powers[-1])
    nothing = np.zeros(0)
    return Stacked(
        C=np.concatenate([model.H @ power for power in powers]),
        D=nothing,
        V=np.kron(np.eye(horizon), model.R),
        T=powers[-1],
        E=nothing,
        Qs=nothing,
        Z=nothing,
    )


@pytest.mark.parametrize("horizon", [4, 60, 700])
def test_chunks_that_begin_at_multiples_of_the_alignment_have_the_same_bits(horizon):
    model = kinematic(1, 2, 0.1)
    plan = series_plan(model, horizon)
    step, reach = plan.alignment, plan.aligned_reach()
    assert reach >= horizon - 1
    assert reach % step == 0
    zs = measured(model, 3 * step + 123)
    whole = filter_series(model, zs, horizon).x
    for start in range(reach, len(zs), step):
        stop = min(start + step, len(zs))
        chunk = filter_series(model, zs[start - reach : stop], horizon).x[reach:]
        np.testing.assert_array_equal(chunk, whole[start:stop])


def test_chunks_anywhere_are_the_whole_to_rounding():
    model = kinematic(1, 1, 0.1)
    zs = measured(model, 5000)
    whole = filter_series(model, zs, 100).x
    chunk = filter_series(model, zs[1234 - 99 : 4321], 100).x[99:]
    np.testing.assert_allclose(chunk, whole[1234:4321], rtol=0, atol=1e-12 * np.nanmax(np.abs(whole)))


def test_many_series_are_each_of_them():
    model = kinematic(1, 1, 0.1)
    zs = measured(model, 300, count=7)
    together = filter_series(model, zs, 60)
    assert together.x.shape == (7, 300, 2)
    for one, z in zip(together.x, zs, strict=True):
        np.testing.assert_array_equal(one, filter_series(model, z, 60).x)


@pytest.mark.parametrize("steps", [0, 1, 2, 9, 10, 11])
def test_series_shorter_than_a_window(steps):
    model = kinematic(1, 1, 0.1)
    zs = measured(model, steps)
    estimate = filter_series(model, zs, 10)
    assert estimate.x.shape == (steps, 2)
    assert estimate.P.shape == (steps, 2, 2)
    assert estimate.ready.tolist() == [n >= 1 for n in range(steps)]
    assert_same(estimate, filter_series(model, zs, 10, engine="stepwise"))


@pytest.mark.parametrize("engine", ["auto", "toeplitz", "scan", "stepwise"])
@pytest.mark.parametrize("changes", [{}, {"lag": 3}, {"noise": (0.1, 2.0)}, {"prior": ([0.0, 0.0], 9.0)}])
def test_a_window_that_is_never_full_may_be_of_any_length(engine, changes):
    """Nothing is worked out for rows that do not exist: these horizons are beyond any memory."""
    model = kinematic(1, 1, 0.1)
    if engine == "scan" and "lag" in changes and "noise" in changes:
        return
    zs = measured(model, 40)
    if engine != "toeplitz":
        zs[10:13] = np.nan
    reference = filter_series(model, zs, 60, engine=engine, **changes)
    long = filter_series(model, zs, 10**13, engine=engine, **changes)
    assert long.horizon == 10**13
    np.testing.assert_array_equal(long.ready, reference.ready)
    np.testing.assert_allclose(long.x, reference.x, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(long.P, reference.P, rtol=1e-9, atol=1e-12)


def test_late_rows_in_a_window_that_is_never_full():
    model, delays = kinematic(1, 1, 0.1), np.arange(40) % 3
    zs = measured(model, 40)
    for delays[20], window in ((1, "arrivals"), (1, "origins"), (30, "arrivals"), (30, "origins")):
        options = {"delays": delays, "window": window}
        long, reference = (filter_series(model, zs, horizon, **options) for horizon in (10**13, 100))
        np.testing.assert_array_equal(long.ready, reference.ready)
        np.testing.assert_allclose(long.x, reference.x, rtol=1e-10, atol=1e-10)


def test_no_series_at_all():
    estimate = filter_series(kinematic(1, 1, 0.1), np.zeros((0, 30, 1)), 10)
    assert estimate.x.shape == (0, 30, 2)
    assert estimate.P.shape == (0, 30, 2, 2)


def test_a_horizon_of_one():
    model = Model(np.eye(2), np.eye(2))
    zs = measured(model, 5)
    np.testing.assert_allclose(filter_series(model, zs, 1).x, zs, rtol=1e-15)


@pytest.mark.parametrize("horizon", [10, 100])
def test_memory_layout_and_type_of_the_measurements_do_not_matter(horizon):
    model = kinematic(1, 2, 0.1)
    zs = measured(model, 700).astype(np.float32).astype(float)
    x = filter_series(model, zs, horizon).x
    padded = np.zeros((1400, 5))
    padded[::2, 1:3] = zs
    for other in (zs.astype(np.float32), np.asfortranarray(zs), padded[::2, 1:3], zs[::-1].copy()[::-1]):
        np.testing.assert_array_equal(filter_series(model, other, horizon).x, x)
    np.testing.assert_array_equal(filter_series(model, zs.tolist(), horizon).x, x)
    whole = (100.0 * zs).round()
    np.testing.assert_array_equal(
        filter_series(model, whole.astype(int), horizon).x, filter_series(model, whole, horizon).x
    )


def test_results_go_where_the_caller_wants_them(tmp_path):
    model = kinematic(1, 1, 0.1)
    zs = measured(model, 40_000)
    expected = filter_series(model, zs, 60).x
    mapped = np.lib.format.open_memmap(tmp_path / "x.npy", mode="w+", dtype=float, shape=(40_000, 2))
    single = np.empty((40_000, 2), dtype=np.float32)
    strided = np.empty((40_000, 4))[:, ::2]
    for out in (mapped, single, strided):
        assert filter_series(model, zs, 60, out=out).x is out
        np.testing.assert_array_equal(out, expected.astype(out.dtype))


def test_a_prior_fills_the_warm_up():
    model = kinematic(2, 1, 0.1)
    zs, prior = measured(model, 50, count=2), (np.array([[1.0, 2.0, 0.5], [3.0, 0.0, 0.0]]), 5.0 * np.eye(3))
    ours = filter_series(model, zs, 10, prior=prior)
    stream = filter_series(model, zs, 10, prior=prior, engine="stepwise")
    assert not np.isnan(ours.x).any()
    assert not ours.ready[:, 0].any()
    assert_same(ours, stream)
    np.testing.assert_allclose(ours.P, stream.P, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("noise", [None, (0.1, 2.0)])
@pytest.mark.parametrize("lag", [0, 2])
def test_the_covariance_is_that_of_the_stream(noise, lag):
    model = kinematic(1, 2, 0.5)
    zs = measured(model, 30)
    ours = filter_series(model, zs, 10, lag=lag, noise=noise)
    stream = filter_series(model, zs, 10, lag=lag, noise=noise, engine="stepwise")
    np.testing.assert_allclose(ours.P, stream.P, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("engine", ["auto", "scan", "stepwise"])
@pytest.mark.parametrize("changing", [(), ("Rs",), ("Fs", "Hs", "Qs", "Rs")])
def test_a_covariance_read_later_is_that_of_the_arrays_that_were_given(engine, changing):
    """Buffers are used again; P waits until it is read."""
    model, rng = kinematic(1, 1, 0.5), np.random.default_rng(0)
    matrices = {"F": model.F, "H": model.H, "Q": model.Q, "R": model.R}
    given = {name: matrices[name[0]] * rng.uniform(0.9, 1.1, (40, 1, 1)) for name in changing}
    zs = measured(model, 40)
    zs[[5, 20, 21]] = np.nan
    soon = filter_series(model, zs, 10, engine=engine, **given).P
    late = filter_series(model, zs, 10, engine=engine, **given)
    zs[...] = 0.0
    zs[10:30] = np.nan
    for array in given.values():
        array *= 7.0
    np.testing.assert_array_equal(late.P, soon)


@pytest.mark.parametrize("engine", ["auto", "stepwise"])
def test_an_estimate_pickles_with_its_covariance_unread(engine):
    model = kinematic(1, 1, 0.5)
    estimate = filter_series(model, measured(model, 20), 5, engine=engine)
    again = pickle.loads(pickle.dumps(estimate))
    np.testing.assert_array_equal(again.P, estimate.P)
    assert isinstance(again, SeriesEstimate)


def test_progress_is_told_to_a_callable():
    told = []
    zs = measured(kinematic(1, 1, 0.1), 50_000)
    filter_series(kinematic(1, 1, 0.1), zs, 100, progress=lambda done, total: told.append((done, total)))
    assert told == sorted(told)
    assert told[-1][0] <= told[-1][1] == 50_000
    assert len(told) > 1


def test_plans_are_shared_and_say_what_they_do():
    model = kinematic(1, 1, 0.1)
    plan = series_plan(model, 300)
    assert series_plan(model, 300) is plan
    assert pickle.loads(pickle.dumps(plan)) is plan
    assert "2 levels" in repr(plan)
    assert "1 level" in repr(series_plan(model, 10))
    assert plan.reach(max_delay=4) == 303


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"zs": np.zeros((5, 3))}, ShapeError, r"zs must have shape \(T, 2\).*got \(5, 3\)"),
        ({"zs": np.zeros((5, 2, 1))}, ShapeError, r"without their last axis: zs\[\.\.\., 0\]"),
        ({"zs": [[0.0, np.inf]]}, NonFiniteError, "NaN where a measurement is missing, got inf at step 0"),
        ({"zs": [["a", "b"]]}, ShapeError, "zs must be an array of real numbers"),
        ({"zs": [["1", "2"], None]}, ShapeError, "zs must be an array of real numbers"),
        ({"zs": np.zeros((3, 2), "M8[ns]")}, ShapeError, "zs must be an array of real numbers"),
        ({"zs": np.zeros((3, 2), "m8[s]")}, ShapeError, "zs must be an array of real numbers"),
        ({"horizon": 1}, UnobservableWindow, "shortest horizon that works is 2"),
        ({"horizon": 0}, ValueError, "horizon must be at least 1"),
        ({"horizon": np.array([5, 6])}, ValueError, "horizon must be an integer"),
        ({"missing": np.array(["extend", "skip"])}, UfirextError, "missing must be one of"),
        ({"engine": np.array(["auto", "scan"])}, UfirextError, "engine must be one of"),
        ({"zs": [[1.0, 10**400]]}, NonFiniteError, "zs must be numbers below"),
        ({"zs": np.full((3, 2), np.longdouble("1e400"))}, NonFiniteError, "got inf at step 0"),
        ({"lag": 10}, ValueError, "lag must be between 0 and 9"),
        ({"engine": "fast"}, UfirextError, "engine must be one of 'auto'"),
        ({"window": "all"}, UfirextError, "window must be one of 'arrivals'"),
        ({"missing": "drop"}, UfirextError, "missing must be one of 'extend'"),
        ({"missing": "skip", "noise": (1.0, 1.0)}, UfirextError, 'needs missing="extend"'),
        ({"delays": [1, 0, 0], "noise": (1.0, 1.0)}, UfirextError, 'needs window="origins"'),
        ({"delays": [0.5, 0, 0]}, ValueError, "delays must be integers"),
        ({"delays": [-1, 0, 0]}, ValueError, "delays must be at least 0, got -1"),
        (
            {"delays": np.full(3, 2**63, "u8")},
            ValueError,
            "delays must be at most 9223372036854775807, got 9223",
        ),
        ({"delays": [0, 2**70, 0]}, ValueError, "delays must be integers"),
        ({"delays": [1, 0]}, ShapeError, r"delays must have shape \(3,\)"),
        ({"us": [[1.0]] * 3}, ShapeError, "needs a model with an input matrix B"),
        ({"prior": 3.0}, UfirextError, r"prior must be a pair \(x, P\)"),
        ({"prior": (np.zeros(3), np.eye(4))}, ShapeError, r"prior\[0\] \(x\) must have shape \(4,\)"),
        ({"prior": (np.zeros(4), np.eye(4)), "lag": 1}, UfirextError, "a prior needs lag=0"),
        ({"out": np.zeros((3, 2))}, ShapeError, r"out must have shape \(3, 4\)"),
        ({"engine": "scan", "noise": (1.0, 1.0), "lag": 1}, UfirextError, 'engine="scan" needs UFIR'),
        ({"engine": "numba", "noise": (1.0, 1.0)}, UfirextError, 'engine="numba" needs UFIR'),
        ({"out": [0.0]}, ShapeError, "out must be a writeable array of floats, got list"),
        ({"Fs": np.zeros((2, 4, 4))}, ShapeError, r"Fs must have shape \(3, 4, 4\) \(T, dim_x, dim_x\)"),
        ({"Rs": [np.diag([1.0, -1.0])] * 3}, ValueError, r"Rs\[0\] must be positive semidefinite"),
        (
            {"delays": np.ma.array([0, 1, 0], mask=[0, 1, 0])},
            NonFiniteError,
            "delays must have no masked entries",
        ),
        (
            {"Fs": np.ma.array(np.zeros((3, 4, 4)), mask=True)},
            NonFiniteError,
            "Fs must have no masked entries",
        ),
        (
            {"prior": (np.ma.array(np.zeros(4), mask=[1, 0, 0, 0]), np.eye(4))},
            NonFiniteError,
            r"prior\[0\] \(x\) must have no masked entries",
        ),
        (
            {"engine": "toeplitz", "delays": [0, 1, 0]},
            UfirextError,
            'engine="toeplitz" needs a constant model',
        ),
    ],
)
def test_bad_input_says_what_is_wrong(change, error, message):
    asked = {"zs": np.zeros((3, 2)), "horizon": 10, **change}
    with pytest.raises(error, match=message):
        filter_series(kinematic(1, 2, 0.1), **asked)


@pytest.mark.parametrize("engine", ["auto", "toeplitz", "scan", "stepwise"])
@pytest.mark.parametrize("count", [0, 2])
@pytest.mark.parametrize("steps", [0, 1])
def test_hardly_anything_to_filter(engine, count, steps):
    model = kinematic(1, 1, 0.1)
    estimate = filter_series(model, np.ones((count, steps, 1)), 5, engine=engine)
    assert estimate.x.shape == estimate.P.shape[:-1] == (count, steps, 2)
    assert not estimate.ready.any()


def test_series_with_holes_into_single_precision():
    model = kinematic(1, 1, 0.1)
    zs = measured(model, 80)
    zs[20:30] = np.nan
    expected = filter_series(model, zs, 10).x
    out = np.empty((80, 2), dtype=np.float32)
    filter_series(model, zs, 10, out=out)
    np.testing.assert_array_equal(out, expected.astype(np.float32))


def test_results_may_not_overwrite_what_is_still_read():
    model = Model(np.eye(2), np.eye(2))
    zs = measured(model, 30)
    with pytest.raises(UfirextError, match="out must not share memory with zs"):
        filter_series(model, zs, 5, out=zs)
    for name in ("Fs", "Qs", "Hs", "Rs"):
        matrices = np.repeat(np.eye(2)[None], 30, axis=0)
        with pytest.raises(UfirextError, match=f"out must not share memory with {name}"):
            filter_series(model, zs, 5, **{name: matrices}, out=matrices[:, 0])
