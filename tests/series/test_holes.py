"""Series with holes: the numbers of the stream, windows that reach further back and coasting included."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.engines.streams import MODELS
from tests.series.test_filter_series import assert_same, measured
from tests.strategies import models, seeds
from ufirext import filter_series, kinematic, series_plan, ufir_gain


def rows_lost(zs, rng):
    zs[rng.random(len(zs)) < 0.3] = np.nan


def bursts_lost(zs, rng):
    for start in rng.integers(0, len(zs), 3):
        zs[start : start + rng.integers(3, 30)] = np.nan


def components_lost(zs, rng):
    zs[rng.random(zs.shape) < 0.3] = np.nan


def nearly_all_lost(zs, rng):
    zs[rng.random(len(zs)) < 0.93] = np.nan


LOSSES = (rows_lost, bursts_lost, components_lost, nearly_all_lost)


@pytest.mark.parametrize("missing", ["extend", "skip"])
@pytest.mark.parametrize("lag", [0, 3])
@pytest.mark.parametrize("horizon", [5, 40])
@pytest.mark.parametrize("lose", LOSSES)
@pytest.mark.parametrize("name", ["plane", "acceleration", "unstable", "delayed"])
def test_a_series_with_holes_is_the_stream(name, lose, horizon, lag, missing):
    model = MODELS[name]
    zs = measured(model, 90)
    lose(zs, np.random.default_rng(1))
    options = {"lag": lag, "missing": missing}
    assert_same(
        filter_series(model, zs, horizon, **options),
        filter_series(model, zs, horizon, engine="stepwise", **options),
        # Three rows in a long window leave the stream's normal equations fewer digits.
        tolerance=1e-10 if lose is nearly_all_lost else 1e-12,
    )


@settings(max_examples=80, deadline=None)
@given(
    models(max_x=4, max_z=2),
    st.integers(1, 40),
    st.sampled_from([0, 0, 1, 2]),
    st.sampled_from(LOSSES),
    st.integers(0, 60),
    seeds,
)
def test_any_model_any_holes(model, horizon, lag, lose, steps, seed):
    try:
        series_plan(model, horizon, lag)
    except ValueError:
        return
    zs = measured(model, steps, seed)
    lose(zs, np.random.default_rng(seed)) if steps else None
    assert_same(
        filter_series(model, zs, horizon, lag=lag),
        filter_series(model, zs, horizon, lag=lag, engine="stepwise"),
        tolerance=1e-8,
    )


@pytest.mark.parametrize("model", [kinematic(1, 1, 0.1), kinematic(2, 3, 0.1)], ids=["2 states", "9 states"])
def test_windows_with_holes_are_least_squares_of_what_is_there(model):
    horizon, steps = 300, 420
    zs = measured(model, steps)
    zs[np.random.default_rng(2).random(steps) < 0.2] = np.nan
    x = filter_series(model, zs, horizon).x
    U = np.linalg.qr(observed(model, horizon))[0]
    for last in np.flatnonzero(~np.isnan(zs[:, 0]))[-3:]:
        window = zs[last - horizon + 1 : last + 1]
        there = ~np.isnan(window).ravel()
        coefficients = np.linalg.lstsq(U[there], window.ravel()[there], rcond=None)[0]
        # Any K with K C = T maps an exact trajectory to its end: the full window's gain does.
        expected = ufir_gain(model, horizon).K @ (U @ coefficients)
        assert np.abs(x[last] - expected).max() <= 1e-11 * np.abs(expected).max()


def observed(model, horizon):
    """[H; H F; ..], each column of unit norm."""
    powers = [np.eye(model.dim_x)]
    for _ in range(horizon - 1):
        powers.append(model.F @ powers[-1])
    C = np.concatenate([model.H @ power for power in powers])
    return C / np.linalg.norm(C, axis=0)


def test_a_series_of_nothing_is_never_ready():
    estimate = filter_series(kinematic(1, 1, 0.1), np.full((30, 1), np.nan), 10)
    assert not estimate.ready.any()
    assert np.isnan(estimate.x).all()
    assert np.isnan(estimate.P).all()


def test_one_series_has_holes_and_the_others_do_not_notice():
    model = kinematic(1, 1, 0.1)
    zs = measured(model, 200, count=3)
    whole = filter_series(model, zs, 20).x
    zs[1, 50:60] = np.nan
    holed = filter_series(model, zs, 20)
    np.testing.assert_array_equal(holed.x[[0, 2]], whole[[0, 2]])
    np.testing.assert_array_equal(holed.x[1, :50], whole[1, :50])
    assert_same(holed, filter_series(model, zs, 20, engine="stepwise"))


def test_none_in_a_list_is_a_hole():
    model = kinematic(1, 1, 0.1)
    zs = [1.0, 2.0, None, 4.0, 5.0, 6.5]
    nan = [np.nan if z is None else z for z in zs]
    np.testing.assert_array_equal(filter_series(model, zs, 4).x, filter_series(model, nan, 4).x)


def test_masked_entries_are_holes():
    model, rng = MODELS["plane"], np.random.default_rng(2)
    zs = measured(model, 60)
    masked = np.ma.array(zs, mask=rng.random(zs.shape) < 0.3)
    expected = filter_series(model, masked.filled(np.nan), 8)
    rows = [np.ma.masked if row.mask.all() else row for row in masked]
    for series in (masked, rows, masked[None], np.ma.array(zs)):
        if series is not rows and not np.ma.is_masked(series):
            expected = filter_series(model, zs, 8)
        found = filter_series(model, series, 8)
        np.testing.assert_array_equal(found.x.reshape(60, -1), expected.x)
        np.testing.assert_array_equal(found.P.reshape(expected.P.shape), expected.P)


def test_after_a_very_long_gap_nothing_is_known():
    model, zs = kinematic(1, 1, 0.1), measured(kinematic(1, 1, 0.1), 400)
    zs[40:330] = np.nan
    ours = filter_series(model, zs, 10)
    assert_same(ours, filter_series(model, zs, 10, engine="stepwise"))
    assert ours.ready[41]
    assert not ours.ready[320]


def test_a_prior_carries_on_where_the_window_does_not_suffice():
    model, zs = kinematic(1, 1, 0.1), measured(kinematic(1, 1, 0.1), 120)
    zs[[0, 1, 2, *range(30, 110)]] = np.nan
    prior = ([1.0, 0.5], 3.0)
    ours = filter_series(model, zs, 5, prior=prior)
    assert not np.isnan(ours.x).any()
    assert_same(ours, filter_series(model, zs, 5, prior=prior, engine="stepwise"))
    np.testing.assert_allclose(
        ours.P, filter_series(model, zs, 5, prior=prior, engine="stepwise").P, rtol=1e-9
    )


def test_the_paper_s_predicted_data_are_the_stream_s():
    model, zs = kinematic(1, 1, 0.1), measured(kinematic(1, 1, 0.1), 60)
    zs[20:25] = np.nan
    predicted = {"missing": "predict"}
    assert_same(
        filter_series(model, zs, 8, **predicted), filter_series(model, zs, 8, engine="stepwise", **predicted)
    )
