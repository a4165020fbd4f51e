"""Models that change from step to step, late rows, holes and inputs: the numbers of the stream."""

from __future__ import annotations

import sys
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.engines.streams import MODELS
from tests.oracles import Record, least_squares
from tests.series.test_filter_series import assert_same, measured
from tests.strategies import models, seeds
from ufirext import Model, filter_series, kinematic
from ufirext.series import covariances

STEPS = 80


def changing(model, steps, rng):
    """F, H, R of every step."""
    n = model.dim_x
    return {
        "Fs": model.F + 0.02 * rng.normal(size=(steps, n, n)) * (model.F != 0),
        "Hs": model.H * rng.uniform(0.5, 2.0, (steps, 1, 1)),
        "Rs": model.R * rng.uniform(0.3, 3.0, (steps, 1, 1)),
    }


def everything(kinds, model, steps, seed):
    """A series and the options that go with it."""
    rng = np.random.default_rng(seed)
    model = model.replace(B=np.eye(model.dim_x)[:, :2])
    zs, options = measured(model, steps, seed), {}
    if "changing" in kinds:
        options |= changing(model, steps, rng)
    if "rows" in kinds:
        zs[rng.random(steps) < 0.3] = np.nan
    if "components" in kinds:
        zs[rng.random(zs.shape) < 0.3] = np.nan
    if "late" in kinds:
        options["delays"] = np.minimum(rng.integers(0, 4, steps), np.arange(steps))
    if "inputs" in kinds:
        options["us"] = rng.normal(size=(steps, model.dim_u))
    return model, zs, options


@pytest.mark.parametrize("lag", [0, 3])
@pytest.mark.parametrize("horizon", [5, 30])
@pytest.mark.parametrize(
    "kinds",
    ["", "changing", "rows", "components", "late", "inputs", "changing rows late inputs", "components late"],
)
@pytest.mark.parametrize("name", ["plane", "acceleration", "unstable", "delayed"])
def test_a_scan_is_the_stream(name, kinds, horizon, lag):
    model, zs, options = everything(kinds, MODELS[name], STEPS, seed=1)
    assert_same(
        filter_series(model, zs, horizon, lag=lag, engine="scan", **options),
        filter_series(model, zs, horizon, lag=lag, engine="stepwise", **options),
    )


@settings(max_examples=80, deadline=None)
@given(
    models(max_x=4, max_z=2),
    st.integers(3, 30),
    st.sets(st.sampled_from(["changing", "rows", "components", "late", "inputs"])),
    st.integers(1, 60),
    st.sampled_from([0, 0, 1, 2]),
    seeds,
)
def test_any_model_anything(model, horizon, kinds, steps, lag, seed):
    model, zs, options = everything(kinds, model, steps, seed)
    options["lag"] = lag
    try:
        stream = filter_series(model, zs, horizon, engine="stepwise", **options)
    except ValueError:
        return
    assert_same(filter_series(model, zs, horizon, engine="scan", **options), stream, tolerance=1e-7)


@pytest.mark.parametrize("horizon", [5, 30])
@pytest.mark.parametrize("kinds", ["", "changing", "rows", "components", "inputs", "changing rows inputs"])
@pytest.mark.parametrize("name", ["plane", "acceleration", "unstable", "delayed"])
def test_a_scan_of_minimum_variance_is_the_fms_stream(name, kinds, horizon):
    model, zs, options = everything(kinds, MODELS[name], STEPS, seed=1)
    if "changing" in kinds:
        options["Qs"] = model.Q * np.random.default_rng(0).uniform(0.5, 2.0, (STEPS, 1, 1))
    noise = (model.Q, 2.0 * model.R)
    assert_same(
        filter_series(model, zs, horizon, noise=noise, engine="scan", **options),
        filter_series(model, zs, horizon, noise=noise, engine="stepwise", **options),
    )


@pytest.mark.parametrize("missing", ["extend", "skip"])
def test_what_a_missing_step_does(missing):
    model, zs, options = everything("changing rows", MODELS["plane"], STEPS, seed=3)
    options["missing"] = missing
    assert_same(
        filter_series(model, zs, 6, **options), filter_series(model, zs, 6, engine="stepwise", **options)
    )


@pytest.mark.parametrize("options", [{"missing": "predict"}, {"window": "origins"}, {"noise": (0.1, 2.0)}])
def test_what_no_scan_holds_goes_step_by_step(options):
    model, zs, late = everything("late rows", MODELS["velocity"], 40, seed=2)
    if "noise" in options:
        late = {}
    assert_same(
        filter_series(model, zs, 6, **options, **late),
        filter_series(model, zs, 6, engine="stepwise", **options, **late),
    )


@pytest.mark.parametrize(
    "model",
    [
        kinematic(1, 1, 0.1),
        kinematic(2, 2, 0.1),
        Model([[1.05]], [[1.0]]),
        Model([[0.9, 0.4], [-0.4, 0.9]], [[1.0, 0.0]]),
    ],
    ids=["velocity", "acceleration", "unstable", "oscillating"],
)
def test_changing_windows_are_least_squares_to_twelve_digits(model):
    rng = np.random.default_rng(4)
    horizon, steps = 40, 130
    zs, options = measured(model, steps), changing(model, steps, rng)
    x = filter_series(model, zs, horizon, **options).x
    F, Q = dict(enumerate(options["Fs"])), dict.fromkeys(range(steps), model.Q)
    for last in (horizon - 1, 77, steps - 1):
        window = range(last - horizon + 1, last + 1)
        records = [Record(k, k, options["Hs"][k], options["Rs"][k], zs[k]) for k in window]
        expected, K, _ = least_squares(records, F, Q, last)
        assert (np.abs(x[last] - expected) <= 1e-12 * (np.abs(K) @ np.abs(zs[window].ravel()))).all()


def assert_same_spread(a, b, tolerance=1e-10):
    """Covariances that are equal, relative to the standard deviations of their states."""
    np.testing.assert_array_equal(np.isnan(a.P), np.isnan(b.P))
    size = np.sqrt(np.einsum("tii->ti", b.P))
    scale = np.maximum(size[:, :, None] * size[:, None, :], 1e-300)
    assert np.nanmax(np.abs(a.P - b.P) / scale, initial=0.0) < tolerance


@pytest.mark.parametrize("prior", [False, True])
@pytest.mark.parametrize("horizon", [5, 30])
@pytest.mark.parametrize(
    ("noise", "kinds"),
    [
        *product([False, True], ["changing", "changing rows", "components", "inputs"]),
        (False, "late"),
    ],
)
@pytest.mark.parametrize("name", ["plane", "acceleration", "unstable", "delayed"])
def test_the_covariances_of_a_scan_are_those_of_the_stream(name, noise, kinds, horizon, prior):
    model, zs, options = everything(kinds, MODELS[name], STEPS, seed=1)
    options["Qs"] = model.Q * np.random.default_rng(0).uniform(0.5, 2.0, (STEPS, 1, 1))
    options["noise"] = (model.Q, 2.0 * model.R) if noise else None
    options["prior"] = (np.ones(model.dim_x), 50.0 * np.eye(model.dim_x)) if prior else None
    assert_same_spread(
        filter_series(model, zs, horizon, engine="scan", **options),
        filter_series(model, zs, horizon, engine="stepwise", **options),
    )


@settings(max_examples=60, deadline=None)
@given(
    models(max_x=7, max_z=2),
    st.integers(3, 30),
    st.sets(st.sampled_from(["changing", "components", "inputs"])),
    st.integers(1, 60),
    st.integers(0, 2),
    seeds,
)
def test_the_covariances_of_any_model(model, horizon, kinds, steps, lag, seed):
    model, zs, options = everything(kinds, model, steps, seed)
    try:
        stream = filter_series(model, zs, horizon, lag=lag, engine="stepwise", **options)
    except ValueError:
        return
    scan = filter_series(model, zs, horizon, lag=lag, engine="scan", **options)
    assert_same_spread(scan, stream, tolerance=1e-6)


@pytest.mark.parametrize("noise", [False, True])
def test_rows_too_close_in_time_for_the_sums_have_their_covariances_too(noise):
    """A constant acceleration, three rows a thousandth of a step apart, then a gap."""
    model = kinematic(2, 1, 1.0, q=0.1)
    spans = np.ones(40)
    spans[1:4] = spans[21:24] = 1e-3
    steps = [kinematic(2, 1, span, q=0.1) for span in spans]
    options = {"Fs": [step.F for step in steps], "Qs": [step.Q for step in steps]}
    options["noise"] = (model.Q, model.R) if noise else None
    zs = measured(model, 40)
    scan = filter_series(model, zs, 4, **options)
    assert_same_spread(scan, filter_series(model, zs, 4, engine="stepwise", **options), tolerance=1e-5)
    assert np.einsum("tii->ti", scan.P)[24].max() > 1e6  # next to nothing is known of the acceleration


@pytest.mark.parametrize("lag", [0, 3])
@pytest.mark.parametrize("name", ["plane", "acceleration", "delayed"])
def test_windows_side_by_side_leave_nothing_to_the_stream(monkeypatch, name, lag):
    model, zs, options = everything("changing inputs", MODELS[name], STEPS, seed=1)
    monkeypatch.setattr(covariances, "stepwise_covariances", None)
    scan = filter_series(model, zs, 12, lag=lag, **options)
    assert np.isfinite(scan.P[scan.ready]).all()


@pytest.mark.parametrize("noise", [False, True])
def test_windows_over_which_an_unstable_model_outgrows_the_digits(noise):
    model, rng = Model([[1.5]], [[1.0]], 0.1, 1.0), np.random.default_rng(0)
    options = {"Rs": rng.uniform(0.5, 2.0, (130, 1, 1)), "noise": (0.1, 1.0) if noise else None}
    zs = rng.normal(size=130)
    assert_same_spread(
        filter_series(model, zs, 110, **options),
        filter_series(model, zs, 110, engine="stepwise", **options),
        tolerance=1e-9,
    )


def test_the_covariance_of_a_changing_window_is_that_of_stacked_equations():
    model, rng, horizon = kinematic(2, 2, 0.1, q=0.5), np.random.default_rng(4), 12
    zs, options = measured(model, 40), changing(model, 40, rng)
    options["Qs"] = model.Q * rng.uniform(0.5, 2.0, (40, 1, 1))
    P = filter_series(model, zs, horizon, **options).P
    F, Q = dict(enumerate(options["Fs"])), dict(enumerate(options["Qs"]))
    for last in (horizon - 1, 27, 39):
        window = range(last - horizon + 1, last + 1)
        records = [Record(k, k, options["Hs"][k], options["Rs"][k], zs[k]) for k in window]
        *_, expected = least_squares(records, F, Q, last)
        np.testing.assert_allclose(P[last], expected, rtol=1e-9, atol=1e-12 * expected.max())


def test_late_rows_are_older_rows():
    """In which order they came does not matter once all are in the window."""
    model, zs = kinematic(1, 1, 0.1), measured(kinematic(1, 1, 0.1), 60)
    swapped, delays = zs.copy(), np.zeros(60, dtype=int)
    swapped[20:60:4], swapped[21:60:4] = np.nan, zs[20:60:4]
    delays[21:60:4] = 1
    kept = zs.copy()
    kept[21:60:4] = np.nan
    late = filter_series(model, swapped, 20, delays=delays).x
    punctual = filter_series(model, kept, 20).x
    # Windows of 20 arrivals that end at a step where nothing is still to come.
    np.testing.assert_allclose(late[43:60:4], punctual[43:60:4], rtol=0, atol=1e-11)


def test_None_in_a_list_of_matrices_is_the_model_s():
    model, zs = kinematic(1, 1, 0.1), measured(kinematic(1, 1, 0.1), 30)
    Rs = [None] * 30
    Rs[7] = [[9.0]]
    full = np.ones((30, 1, 1))
    full[7] = 9.0
    np.testing.assert_array_equal(
        filter_series(model, zs, 8, Rs=Rs).x, filter_series(model, zs, 8, Rs=full).x
    )


def test_several_series_that_change_alike():
    model = MODELS["plane"]
    zs, options = measured(model, 60, count=3), changing(model, 60, np.random.default_rng(0))
    zs[1, 20:26] = np.nan
    together = filter_series(model, zs, 10, **options)
    for one, z in zip(together.x, zs, strict=True):
        np.testing.assert_array_equal(one, filter_series(model, z, 10, **options).x)


@pytest.mark.parametrize("lag", [0, 3])
@pytest.mark.parametrize("kinds", ["changing rows late inputs", "components"])
@pytest.mark.parametrize("name", ["plane", "unstable", "delayed"])
def test_the_compiled_loop_has_the_same_numbers(name, kinds, lag):
    pytest.importorskip("numba")
    model, zs, options = everything(kinds, MODELS[name], STEPS, seed=1)
    for horizon in (5, 30):
        assert_same(
            filter_series(model, zs, horizon, lag=lag, engine="numba", **options),
            filter_series(model, zs, horizon, lag=lag, engine="scan", **options),
        )


def test_without_numba_the_compiled_loop_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    monkeypatch.delitem(sys.modules, "ufirext.series.compiled", raising=False)
    with pytest.raises(ImportError, match=r"pip install 'ufirext\[numba\]', or use engine=\"auto\""):
        filter_series(kinematic(1, 1, 0.1), [1.0, 2.0], 2, engine="numba")


def test_without_rich_the_bar_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "rich.progress", None)
    with pytest.raises(ImportError, match="progress=True needs rich: pip install rich"):
        filter_series(kinematic(1, 1, 0.1), [1.0, 2.0], 2, progress=True)
