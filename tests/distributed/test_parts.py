"""A part with its overlap has the numbers of the whole series, and says where it might not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.engines.streams import MODELS
from ufirext import UfirextError, filter_series, kinematic, series_plan
from ufirext.distributed import BeyondOverlap, BeyondOverlapWarning, chunk_length
from ufirext.distributed.part import checked
from ufirext.errors import HorizonError

PLANE = MODELS["plane"]
OPTIONS = {
    "lag": 0,
    "missing": "extend",
    "noise": None,
    "window": "arrivals",
    "longest_delay": 0,
    "beyond": "raise",
}


def task(model, horizon, overlap=None, **options):
    return checked(model, horizon, overlap, **{**OPTIONS, **options})


def whole(model, z, horizon, **options):
    estimate = filter_series(model, z, horizon, **options)
    np.testing.assert_array_equal(np.isnan(estimate.x).any(axis=-1), ~estimate.ready)
    return estimate.x


def close(ours, theirs, tolerance=1e-12):
    np.testing.assert_array_equal(np.isnan(ours), np.isnan(theirs))
    scale = np.nanmax(np.abs(theirs), axis=(0, 1), initial=1e-300)
    assert np.nanmax(np.abs(ours - theirs) / scale, initial=0.0) < tolerance


def measured(model, steps, seed=0, series=1):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(series, steps, model.dim_z)).cumsum(axis=1)


@pytest.mark.parametrize("lag", [0, 2])
@pytest.mark.parametrize("name", sorted(MODELS))
def test_a_part_is_that_part_of_the_whole(name, lag):
    model = MODELS[name]
    z = measured(model, 500, series=2)
    job = task(model, 40, lag=lag)
    x = whole(model, z, 40, lag=lag)
    for start, stop in ((0, 200), (200, 210), (210, 490), (490, 500)):
        before = min(start, job.overlap)
        close(job.run(z[:, start - before : stop], start, before), x[:, start:stop])


@pytest.mark.parametrize("horizon", [20, 300])
@pytest.mark.parametrize("states", [(1, 1), (1, 2), (2, 3)])
def test_parts_on_the_plans_grid_have_the_bits_of_the_whole(states, horizon):
    model = kinematic(*states, 0.1, q=0.5, r=1.0)
    grid = series_plan(model, horizon).alignment
    z = measured(model, 3 * grid + 100)
    job = task(model, horizon)
    x = whole(model, z, horizon)
    for start in (0, grid, 2 * grid, 3 * grid):
        stop, before = min(start + grid, z.shape[1]), min(start, job.overlap)
        part = job.run(z[:, start - before : stop], start, before)
        np.testing.assert_array_equal(part, x[:, start:stop])


def test_minimum_variance_parts():
    model = MODELS["velocity"]
    noise = (model.Q, model.R)
    z = measured(model, 400)
    job = task(model, 30, noise=noise, lag=3)
    x = whole(model, z, 30, noise=noise, lag=3)
    close(job.run(z[:, 200 - job.overlap :], 200, job.overlap), x[:, 200:], 1e-11)


def test_delays_and_inputs():
    model = MODELS["velocity"].replace(B=[[0.5], [1.0]])
    rng = np.random.default_rng(3)
    z, us = measured(model, 300), rng.normal(size=(1, 300, 1))
    delays = np.minimum(rng.integers(0, 4, size=(1, 300)), np.arange(300))
    job = task(model, 12, longest_delay=3)
    x = whole(model, z, 12, delays=delays, us=us)
    cut = slice(150 - job.overlap, None)
    close(job.run(z[:, cut], 150, job.overlap, delays[:, cut], us[:, cut]), x[:, 150:], 1e-10)


@given(
    seed=st.integers(0, 10_000),
    lost=st.floats(0.0, 0.95),
    component=st.sampled_from([0.0, 0.5]),
    gap=st.integers(0, 90),
    since=st.integers(-60, 10),
    overlap=st.integers(0, 60),
    name=st.sampled_from(["velocity", "plane"]),
)
@settings(max_examples=80)
def test_whatever_is_missing_a_part_is_exact_or_says_it_is_not(
    seed, lost, component, gap, since, overlap, name
):
    """Never a wrong number silently: the theorem of this module."""
    model, horizon, start = MODELS[name], 5, 160
    rng = np.random.default_rng(seed)
    z = measured(model, 300, seed)
    z[0, rng.random(300) < lost] = np.nan
    z[rng.random(z.shape) < component] = np.nan
    z[0, start + since : start + since + gap] = np.nan
    job = task(model, horizon, horizon - 1 + overlap)
    x = whole(model, z, horizon)
    try:
        part = job.run(z[:, start - job.overlap :], start, job.overlap)
    except BeyondOverlap:
        return
    close(part, x[:, start:], 1e-11)


@pytest.mark.parametrize("since", range(-7, 4))
def test_a_gap_anywhere_about_the_edge_is_exact_or_said(since):
    model, horizon, start = MODELS["velocity"], 5, 160
    z = measured(model, 300)
    z[0, start + since : start + since + 20] = np.nan
    x = whole(model, z, horizon)
    said = False
    for overlap in (4, 6, 30):
        job = task(model, horizon, overlap)
        try:
            part = job.run(z[:, start - overlap :], start, overlap)
        except BeyondOverlap:
            said = True
        else:
            close(part, x[:, start:], 1e-11)
    assert said is (since < 1), "a gap that begins after a full window is within the part"


def test_one_axis_that_is_silent_about_the_edge_is_said():
    """Rows enough, and yet one state is known from before the overlap alone."""
    model, start = PLANE, 160
    z = measured(model, 300)
    z[0, 140:170, 1] = np.nan
    job = task(model, 5)
    with pytest.raises(BeyondOverlap, match="rows 160 to"):
        job.run(z[:, start - 4 :], start, 4)
    enough = task(model, 5, job.sufficient) if job.sufficient < start else task(model, 5, start - 5)
    close(
        enough.run(z[:, start - enough.overlap :], start, enough.overlap),
        whole(model, z, 5)[:, start:],
        1e-11,
    )


@pytest.mark.parametrize("missing", ["extend", "skip"])
@pytest.mark.parametrize("lost", [0.3, 0.9])
@pytest.mark.parametrize("gap", [0, 30, 83, 84, 85, 100, 200])
def test_the_sufficient_overlap_is_sufficient_for_any_gap(gap, lost, missing):
    model, horizon, start = MODELS["velocity"], 5, 400
    rng = np.random.default_rng(gap)
    z = measured(model, 600)
    z[0, rng.random(600) < lost] = np.nan
    z[0, start - gap // 2 : start + gap // 2] = np.nan
    enough = task(model, horizon, missing=missing).sufficient
    job = task(model, horizon, enough, missing=missing)
    part = job.run(z[:, start - enough :], start, enough)
    close(part, whole(model, z, horizon, missing=missing)[:, start:], 1e-11)


def test_what_lies_beyond_is_said_with_rows_series_and_remedy():
    model = MODELS["velocity"]
    z = measured(model, 300, series=2)
    z[1, 140:160] = np.nan
    job = task(model, 5)
    message = r"rows 150 to 162 of series 1 .* more than 4 rows before .* row 150.* overlap=167 is enough"
    with pytest.raises(BeyondOverlap, match=message):
        job.run(z[:, 146:], 150, 4)
    patient = task(model, 5, beyond="warn")
    with pytest.warns(BeyondOverlapWarning, match="overlap=167"):
        patient.run(z[:, 146:], 150, 4)


def test_skipping_never_reaches_back():
    model = MODELS["velocity"]
    z = measured(model, 300)
    z[0, 140:160] = np.nan
    job = task(model, 5, missing="skip")
    assert job.sufficient == job.overlap == 4
    close(job.run(z[:, 146:], 150, 4), whole(model, z, 5, missing="skip")[:, 150:])


def test_single_precision_measurements():
    model = MODELS["plane"]
    z = measured(model, 400).astype(np.float32)
    close(task(model, 25).run(z[:, 176:], 200, 24), whole(model, z, 25)[:, 200:])


def test_chunks_are_long_aligned_and_mostly_not_overlap():
    for horizon in (10, 500, 40_000):
        model = kinematic(1, 1, 0.1)
        length = chunk_length(model, horizon)
        assert length >= 1_000_000
        assert length >= 50 * (horizon - 1)
        assert length % series_plan(model, horizon).alignment == 0


def test_refusals():
    with pytest.raises(UfirextError, match="remembers everything"):
        task(MODELS["plane"], 5, missing="predict")
    with pytest.raises(UfirextError, match="beyond must be one of"):
        task(MODELS["plane"], 5, beyond="ignore")
    with pytest.raises(HorizonError, match=r"overlap must be at least 7, got 3; horizon - 1 \+ lag"):
        task(MODELS["plane"], 5, 3, lag=3)
