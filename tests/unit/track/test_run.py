"""The filter over a track does what least squares over the same rows does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("pymap3d", reason="pip install ufirext[cli]")

from ufirext.track.run import Motion, run
from ufirext.track.timing import timing

from .tracks import noisy, recorded, straight


def filtered(track, motion):
    return run(track, timing(track), motion)


def line_through(seconds, values, order, at):
    """Value and slope at a time of the least-squares polynomial."""
    fit = np.polynomial.Polynomial.fit(seconds, values, order)
    return fit(at), fit.deriv()(at)


def assert_fits(track, estimates, windows, order, tolerance=1e-8):
    """Position and velocity of each row are those of the polynomial through its window."""
    for row, window in windows.items():
        for axis in range(2):
            values = track.position[window, axis]
            position, velocity = line_through(track.seconds[window], values, order, track.seconds[row])
            assert estimates.position[row, axis] == pytest.approx(position, abs=tolerance)
            if order:
                assert estimates.velocity[row, axis] == pytest.approx(velocity, abs=tolerance)


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("step", [0.1, 1.0, 3600.0])
def test_on_a_grid_each_row_is_the_end_of_the_polynomial_through_the_window(order, step):
    seconds = 50.0 + step * np.arange(40)
    track = recorded(seconds, noisy(np.random.default_rng(1), np.arange(40.0), 3.0))
    estimates = filtered(track, Motion(order, horizon=9))
    windows = {row: slice(max(0, row - 8), row + 1) for row in range(order + 1, 40)}
    assert_fits(track, estimates, windows, order)
    assert estimates.ready.tolist() == [row >= order for row in range(40)]


def test_off_the_grid_the_steps_have_their_own_length():
    rng = np.random.default_rng(2)
    seconds = np.cumsum(np.round(rng.uniform(0.5, 1.5, 40), 3))
    seconds = seconds - seconds[0]
    track = recorded(seconds, noisy(rng, seconds, 3.0))
    axis = timing(track)
    assert not axis.regular
    track = replace(track, seconds=np.cumsum(axis.steps) * axis.step)  # as rounded by the filter
    estimates = run(track, axis, Motion(1, horizon=8))
    windows = {row: slice(max(0, row - 7), row + 1) for row in range(2, 40)}
    assert_fits(track, estimates, windows, order=1)


def test_a_gap_within_the_window_is_bridged_and_a_longer_one_starts_afresh():
    seconds = np.array([*range(20), *range(24, 44), *range(100, 120)], dtype=float)
    track = recorded(seconds, noisy(np.random.default_rng(3), seconds, 3.0))
    estimates = filtered(track, Motion(1, horizon=6))
    assert estimates.starts.tolist() == [0, 40]
    # 4 of the rows 16..24 lie in the six steps up to 24: 19 and 24; two older ones are reached for
    assert_fits(track, estimates, {20: slice(17, 21), 30: slice(25, 31), 43: slice(40, 44)}, order=1)


def test_a_gap_of_a_million_steps_costs_no_steps():
    seconds = np.array([*range(20), *(10.0**9 + np.arange(20))])
    track = recorded(seconds, straight(np.array([*range(20), *range(20)], dtype=float)))
    estimates = filtered(track, Motion(1, horizon=6))
    assert estimates.starts.tolist() == [0, 20]
    np.testing.assert_allclose(estimates.position, track.position, atol=1e-9)


def test_large_coordinates_cost_no_digits():
    seconds = np.arange(60.0)
    near = recorded(seconds, noisy(np.random.default_rng(4), seconds, 3.0))
    far = replace(near, position=near.position + np.array([4.5e5, 5.8e6]))
    motion = Motion(1, horizon=8)
    moved = filtered(far, motion).position - [4.5e5, 5.8e6]
    np.testing.assert_allclose(moved, filtered(near, motion).position, atol=2e-9)


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_rows_that_arrive_late_and_out_of_order_lose_nothing_on_a_straight_drive(seed):
    rng = np.random.default_rng(seed)
    seconds = np.sort(rng.integers(0, 40, 60)).astype(float)
    age = rng.uniform(0.0, 3.0, 60)
    track = recorded(seconds, straight(seconds - age), age=age)
    estimates = filtered(track, Motion(1, horizon=12))
    settled = estimates.settled
    assert settled.sum() > 5
    np.testing.assert_allclose(estimates.position[settled], straight(seconds[settled]), atol=1e-7)
    np.testing.assert_allclose(
        estimates.velocity[settled], np.tile([3.0, -1.5], (settled.sum(), 1)), atol=1e-7
    )
    judged = settled & estimates.predicted
    np.testing.assert_allclose(estimates.innovation[judged], 0.0, atol=1e-6)


def test_a_constant_delay_shifts_the_filter_and_extrapolates():
    seconds = np.arange(40.0)
    prompt = recorded(seconds, noisy(np.random.default_rng(5), seconds, 3.0))
    late = replace(prompt, seconds=seconds + 2, age=np.full(40, 2.0), age_unit="steps")
    motion = Motion(1, horizon=8)
    now, then = filtered(late, motion), filtered(prompt, motion)
    expected = then.position + 2 * then.velocity
    np.testing.assert_allclose(now.position[8:], expected[8:], atol=1e-8)


@pytest.mark.parametrize("order", [1, 2])
def test_with_a_lag_each_row_is_the_polynomial_through_the_window_that_ends_later(order):
    seconds = np.arange(40.0)
    track = recorded(seconds, noisy(np.random.default_rng(6), seconds, 3.0))
    estimates = filtered(track, Motion(order, horizon=9, lag=4))
    windows = {row: slice(max(0, row - 4), row + 5) for row in range(2, 36)}
    windows |= {row: slice(31, 40) for row in range(36, 40)}  # the last rows see what there is
    assert_fits(track, estimates, windows, order)


def test_a_lag_lowers_the_error_on_a_smooth_path():
    seconds = np.arange(2000.0)
    track = recorded(seconds, noisy(np.random.default_rng(7), seconds, 3.0, straight))
    prompt, late = (filtered(track, Motion(1, 11, lag=lag)) for lag in (0, 5))
    errors = [np.sqrt(np.mean((each.position - straight(seconds)) ** 2)) for each in (prompt, late)]
    assert errors[1] < 0.65 * errors[0]  # 0.54 in theory: sqrt((1 / 11) / (2 (2 11 - 1) / (11 12)))


def test_standard_deviations_and_nis_are_right_under_the_assumed_noise():
    rng = np.random.default_rng(8)
    seconds = np.arange(4000.0)
    velocity = np.cumsum(rng.normal(0, np.sqrt(0.01), (4000, 2)), axis=0)
    truth = np.cumsum(velocity, axis=0)
    track = recorded(seconds, truth + 3.0 * rng.standard_normal((4000, 2)))
    estimates = filtered(track, Motion(1, horizon=14, q=0.01, r=9.0))
    ratio = (estimates.position - truth)[20:] / estimates.position_std[20:]
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1.0, abs=0.06)
    assert np.mean(estimates.nis[20:]) == pytest.approx(2.0, abs=0.12)


@pytest.mark.parametrize("lag", [0, 3])
@pytest.mark.parametrize("jitter", [0.0, 0.3])
def test_progress_is_told_and_ends_at_the_end(lag, jitter):
    seconds = np.arange(300.0) + jitter * (np.arange(300) % 3)
    told = []
    track = recorded(seconds, straight(seconds))
    run(
        track,
        timing(track),
        Motion(1, 6, lag=lag),
        lambda stage, done, total: told.append((stage, done, total)),
    )
    assert told == sorted(told)
    assert told[-1] == ("filtering", 300, 300)


def test_what_the_data_do_not_tell_yet_is_blank():
    seconds = np.arange(10.0)
    estimates = filtered(recorded(seconds, straight(seconds)), Motion(2, horizon=6))
    assert np.isnan(estimates.velocity[:2]).all()
    assert np.isfinite(estimates.velocity[2:]).all()
    assert np.isfinite(estimates.position).all()
    assert np.isnan(estimates.innovation[:3]).all()
    assert np.isfinite(estimates.innovation[3:]).all()


def test_the_horizon_may_be_chosen_on_the_way():
    seconds = np.arange(300.0)
    track = recorded(seconds, noisy(np.random.default_rng(9), seconds, 3.0, straight))
    estimates = filtered(track, Motion(1, horizon=8, r=9.0, adaptive=True))
    error = np.sqrt(np.mean((estimates.position - straight(seconds))[100:] ** 2))
    assert error < 2.0
