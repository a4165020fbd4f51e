"""The step, the grid and the gaps of a time axis."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("pymap3d", reason="pip install ufirext[cli]")

from ufirext.track.series import UnusableTrack
from ufirext.track.timing import pieces, timing

from .tracks import recorded, straight


def axis_of(seconds):
    seconds = np.asarray(seconds, dtype=float)
    return timing(recorded(seconds, straight(seconds)))


def test_missing_rows_leave_holes_in_the_grid():
    axis = axis_of([0, 0.1, 0.2, 0.5, 0.6, 0.7, 0.8])
    assert axis.regular
    assert axis.step == pytest.approx(0.1)
    assert axis.steps.tolist() == [0, 1, 1, 3, 1, 1, 1]


def test_rounded_stamps_are_on_the_grid_of_their_mean_step():
    axis = axis_of(np.round(np.arange(3000) / 30.0, 3))
    assert axis.regular
    assert axis.step == pytest.approx(1 / 30, rel=1e-5)
    assert np.all(axis.steps[1:] == 1)


def test_steps_of_one_and_a_half_are_off_the_grid():
    axis = axis_of([0, 0.2, 0.5, 0.7, 0.9, 1.1, 1.4, 1.6])
    assert not axis.regular
    assert axis.step == pytest.approx(0.2)
    assert axis.steps.tolist() == [0, 1, 1.5, 1, 1, 1, 1.5, 1]


def test_rounding_of_steps_does_not_add_up():
    seconds = np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, 20_000))
    axis = axis_of(seconds)
    assert not axis.regular
    assert np.abs(np.cumsum(axis.steps) * axis.step - (seconds - seconds[0])).max() <= 0.00051 * axis.step


def test_a_long_gap_need_not_fit_the_grid_and_cuts_the_track():
    axis = axis_of([*range(20), *(12345.678 + np.arange(10))])
    assert axis.regular
    assert pieces(axis, horizon=6) == [slice(0, 20), slice(20, 30)]


def test_after_a_long_gap_rows_off_the_grid_start_afresh_even_in_a_longer_window():
    on, off = axis_of([*range(20), *range(100, 120)]), axis_of([*range(20), *(100.4 + np.arange(20))])
    assert on.regular
    assert off.regular
    assert pieces(on, horizon=200) == [slice(0, 40)]
    assert pieces(off, horizon=200) == [slice(0, 20), slice(20, 40)]


def test_a_gap_no_longer_than_the_window_does_not_cut():
    axis = axis_of([0, 1, 2, 3, 8, 9])
    assert pieces(axis, horizon=5) == [slice(0, 6)]
    assert pieces(axis, horizon=4) == [slice(0, 4), slice(4, 6)]


def test_one_stamp_is_no_time_axis():
    with pytest.raises(UnusableTrack, match="only one time stamp"):
        axis_of([5.0])
