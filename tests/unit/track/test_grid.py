"""Whole windows by one product, holes by the filter, rows off the grid as a series: all are the filter."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("pymap3d", reason="pip install ufirext[cli]")

from ufirext.track import run as runs
from ufirext.track import stretch, uneven
from ufirext.track.filters import new_filter
from ufirext.track.grid import on_grid
from ufirext.track.run import Motion, run
from ufirext.track.timing import timing

from .tracks import noisy, recorded


def measurements(rng, lost):
    zs = noisy(rng, np.arange(240.0), 3.0)
    zs[rng.random(240) < lost] = np.nan
    zs[0] = 1.0
    return zs


def by_hand(zs, motion):
    """Means and covariances of the filter, one step after the other, and of its smoother."""
    kf = new_filter(motion)
    steps = []
    for z in zs:
        kf.predict()
        kf.update(z)
        steps.append((kf.x.copy(), kf.P.copy()))
        if motion.lag and kf.ready and len(steps) > motion.lag:
            steps[-1 - motion.lag] = kf.smoothed(motion.lag)
    for back in range(1, motion.lag):
        steps[-1 - back] = kf.smoothed(back)
    return np.array([x for x, _ in steps]), np.array([P for _, P in steps])


@pytest.mark.parametrize("lost", [0.0, 0.01, 0.3])
@pytest.mark.parametrize(
    ("order", "horizon", "lag"), [(0, 3, 0), (1, 8, 0), (2, 20, 0), (1, 8, 4), (2, 12, 11)]
)
def test_it_is_the_filter_step_by_step(lost, order, horizon, lag):
    motion = Motion(order, horizon, q=0.05, r=9.0, lag=lag)
    zs = measurements(np.random.default_rng(1), lost)
    means, covs = on_grid(zs, motion, lag)
    expected_means, expected_covs = by_hand(zs, motion)
    np.testing.assert_allclose(means, expected_means, rtol=1e-9, atol=1e-8)
    np.testing.assert_allclose(covs, expected_covs, rtol=1e-7, atol=1e-8)


@pytest.mark.parametrize("lag", [0, 5])
def test_pieces_do_not_show(monkeypatch, lag):
    """A finite memory makes pieces with an overlap exact."""
    rng = np.random.default_rng(2)
    seconds = np.arange(800.0)
    kept = rng.random(800) > 0.02
    track = recorded(seconds[kept], noisy(rng, seconds[kept], 3.0))
    axis, motion = timing(track), Motion(1, horizon=8, q=0.05, r=9.0, lag=lag)
    at_once = run(track, axis, motion)
    monkeypatch.setattr(stretch, "CHUNK", 1)
    in_pieces = run(track, axis, motion)
    assert len(track) > 4 * (4 * motion.horizon + 64)  # so that there are several
    for name in ("mean", "std", "innovation", "innovation_std", "nis"):
        np.testing.assert_allclose(getattr(in_pieces, name), getattr(at_once, name), rtol=1e-9, atol=1e-8)


NAMES = ("mean", "std", "innovation", "innovation_std", "nis")


def off_the_grid(rows):
    """A bend with stamps of its own, and a gap that no window spans."""
    rng = np.random.default_rng(3)
    seconds = np.cumsum(rng.uniform(0.3, 1.7, rows)).round(3)
    seconds[rows // 2 :] += 300.0
    return recorded(seconds, noisy(rng, seconds, 3.0))


@pytest.mark.parametrize("name", ["ufir", "fms"])
@pytest.mark.parametrize(
    ("order", "horizon", "lag"), [(0, 3, 0), (1, 8, 0), (2, 20, 0), (1, 8, 4), (2, 12, 11), (1, 90, 60)]
)
def test_rows_off_the_grid_as_a_series_are_the_filter_step_by_step(monkeypatch, name, order, horizon, lag):
    track = off_the_grid(160)
    motion = Motion(order, horizon, q=0.05, r=9.0, lag=lag, filter=name)
    as_series = run(track, timing(track), motion)
    monkeypatch.setattr(runs, "is_series", lambda motion: False)
    by_steps = run(track, timing(track), motion)
    assert not timing(track).regular
    assert by_steps.starts.tolist() == as_series.starts.tolist() == [0, 80]
    for part in NAMES:
        ours, expected = getattr(as_series, part), getattr(by_steps, part)
        np.testing.assert_allclose(ours, expected, rtol=1e-6, atol=1e-6, err_msg=part)


def test_without_the_spread_the_estimates_are_the_same():
    track, motion = off_the_grid(100), Motion(1, 8, q=0.05, r=9.0, lag=3)
    whole, bare = (run(track, timing(track), motion, spread=spread) for spread in (True, False))
    np.testing.assert_array_equal(bare.mean, whole.mean)
    np.testing.assert_array_equal(bare.innovation, whole.innovation)
    assert np.isnan(bare.std).all()


@pytest.mark.parametrize("lag", [0, 5])
@pytest.mark.parametrize("name", ["ufir", "fms"])
def test_pieces_of_a_series_do_not_show(monkeypatch, name, lag):
    track, motion = off_the_grid(400), Motion(1, 8, q=0.05, r=9.0, lag=lag, filter=name)
    at_once = run(track, timing(track), motion)
    monkeypatch.setattr(uneven, "CHUNK", 1)
    in_pieces = run(track, timing(track), motion)
    for part in NAMES:
        np.testing.assert_allclose(getattr(in_pieces, part), getattr(at_once, part), rtol=1e-9, atol=1e-8)
