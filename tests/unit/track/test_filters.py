"""Four filters over the same tracks: what must agree agrees, late rows and lags included."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import replace
from math import ceil

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("pymap3d", reason="pip install ufirext[cli]")

from ufirext import DelayKalmanFilter, kinematic
from ufirext.errors import HorizonError
from ufirext.recursions import ThetaTooLarge
from ufirext.track.motion import Wish, choose
from ufirext.track.run import Motion, run
from ufirext.track.stretch import Stretch
from ufirext.track.timing import timing

from .tracks import bend, noisy, recorded, straight

FILTERS = ("ufir", "fms", "kalman", "hinf")
ROWS = 90
MOTION = Motion(1, 9, q=0.3, r=9.0)


def of_kind(kind: str, rng: np.random.Generator):
    """A track on a grid with holes, off a grid, or with late rows on or off it; and true positions."""
    seconds = np.arange(float(ROWS))
    if "irregular" in kind:
        seconds = np.cumsum(rng.uniform(0.4, 1.6, ROWS))
    if "holes" in kind:
        kept = rng.random(ROWS) > 0.2
        kept[:4] = True
        seconds = seconds[kept]
    measured = noisy(rng, seconds, 3.0)
    if "late" not in kind:
        return recorded(seconds, measured), bend(seconds)
    age = np.where(rng.random(len(seconds)) < 0.4, rng.uniform(0.2, 3.0, len(seconds)), 0.0)
    if "irregular" not in kind:
        age = np.rint(age)
    age = np.minimum(age, seconds)
    arrival = np.argsort(seconds + age, kind="stable")
    came = (seconds + age)[arrival]
    return recorded(came, measured[arrival], age=age[arrival], age_unit="s"), bend(came)


KINDS = ("grid", "holes", "irregular", "late", "irregular late")


@pytest.mark.parametrize("lag", [0, 3])
@pytest.mark.parametrize("kind", KINDS)
def test_minimum_variance_over_everything_is_the_kalman_filter(kind, lag):
    """Two programs without a line of filtering in common, from a vague start."""
    # With late rows and no lag the Kalman filter is the recursion, a little above the optimum.
    near, relative = (0.4, 0.02) if "late" in kind and not lag else (2e-3, 2e-3)
    track, _ = of_kind(kind, np.random.default_rng(1))
    axis = timing(track)
    whole = run(track, axis, replace(MOTION, filter="fms", horizon=4 * ROWS, lag=lag))
    kalman = run(track, axis, replace(MOTION, filter="kalman", lag=lag))
    rows = slice(5, None)
    np.testing.assert_allclose(whole.mean[rows], kalman.mean[rows], atol=near)
    np.testing.assert_allclose(whole.std[rows], kalman.std[rows], rtol=relative)
    np.testing.assert_allclose(whole.innovation[rows], kalman.innovation[rows], atol=near)
    np.testing.assert_allclose(whole.nis[rows], kalman.nis[rows], rtol=10 * relative, atol=near)


@pytest.mark.parametrize("kind", KINDS)
def test_h_infinity_that_promises_nothing_is_the_kalman_filter(kind):
    track, _ = of_kind(kind, np.random.default_rng(2))
    axis = timing(track)
    kalman = run(track, axis, replace(MOTION, filter="kalman"))
    bound = run(track, axis, replace(MOTION, filter="hinf", theta=0.0))
    # Late rows: the one recursion is within 0.2 % of the other's optimum.
    close = {"rtol": 5e-3, "atol": 0.15} if "late" in kind else {"rtol": 1e-8, "atol": 1e-7}
    np.testing.assert_allclose(bound.mean[3:], kalman.mean[3:], **close)
    np.testing.assert_allclose(bound.std[3:], kalman.std[3:], **close)
    assert bound.theta == (0.0, 0.0, bound.theta[2])
    assert kalman.theta is None


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("kind", KINDS)
def test_every_filter_brings_a_track_closer_to_the_truth(name, kind):
    track, truth = of_kind(kind, np.random.default_rng(3))
    estimates = run(track, timing(track), replace(MOTION, filter=name))
    rows = slice(12, None)
    raw, filtered = (
        np.sqrt(np.mean(np.sum((each - truth)[rows] ** 2, axis=1)))
        for each in (track.position, estimates.position)
    )
    assert filtered < 0.85 * raw
    assert np.isfinite(estimates.std[rows]).all()


@pytest.mark.parametrize("kind", ["grid", "late"])
def test_the_kalman_row_is_the_delay_kalman_filter_step_by_step(kind):
    track, _ = of_kind(kind, np.random.default_rng(4))
    model = kinematic(1, 2, 1.0, q=0.3, r=9.0)
    kf = DelayKalmanFilter(4, 2, max_delay=3)
    kf.F, kf.H, kf.Q, kf.R, kf.P = model.F, model.H, model.Q, model.R, 9e8 * np.eye(4)
    estimates = run(track, timing(track), replace(MOTION, filter="kalman"))
    ages = np.zeros(len(track)) if track.age is None else track.age
    now = 0
    for row, (seconds, age) in enumerate(zip(track.seconds, ages, strict=True)):
        while now < seconds + 1:
            kf.predict()
            now += 1
        kf.update(track.position[row] - track.position[0], delay=int(age))
        position = kf.x.ravel()[::2] + track.position[0]
        if row >= 2:
            np.testing.assert_allclose(estimates.position[row], position, rtol=1e-9)


@pytest.mark.parametrize("name", FILTERS)
def test_a_straight_line_without_noise_is_met(name):
    seconds = np.cumsum(np.random.default_rng(5).uniform(0.2, 2.0, 60))
    track = recorded(seconds, straight(seconds))
    estimates = run(track, timing(track), Motion(1, 8, q=1e-6, r=1.0, filter=name))
    # Stamps are rounded to thousandths of a step.
    np.testing.assert_allclose(estimates.position[3:], straight(seconds[3:]), atol=5e-3)


@pytest.mark.parametrize("name", FILTERS)
def test_a_fresh_start_follows_a_long_gap(name):
    seconds = np.concatenate([np.arange(40.0), 1000.0 + np.arange(40.0)])
    track = recorded(seconds, np.vstack([straight(seconds[:40]), -straight(seconds[40:])]))
    estimates = run(track, timing(track), replace(MOTION, filter=name))
    assert estimates.starts.tolist() == [0, 40]
    np.testing.assert_allclose(estimates.position[45:], -straight(seconds[45:]), atol=1e-3)


@given(st.integers(0, 2**32 - 1), st.booleans())
def test_the_origin_of_a_late_row_is_the_last_step_before_it_was_measured(seed, regular):
    rng = np.random.default_rng(seed)
    steps = rng.integers(0, 4, 25).astype(float) if regular else np.round(rng.uniform(0, 2, 25), 3)
    steps = np.where(rng.random(25) < 0.2, 0.0, steps)
    steps[0] = 0.0
    ages = rng.uniform(0, 6, 25) if rng.random() < 0.5 else rng.integers(0, 6, 25).astype(float)
    delays, ahead = Stretch(slice(0, 25), steps, np.zeros((25, 2)), ages, regular).origins()
    elapsed: list[float] = []
    for row, step in enumerate(steps.tolist()):
        whole = [1.0] * round(step) if regular else [step] * (step > 0)
        for one in whole if row else [1.0]:
            elapsed.append((elapsed[-1] if elapsed else 0.0) + one)
        taken = elapsed[-1] - ages[row]
        back = len(elapsed) - bisect_right(elapsed, taken + 1e-6)
        at = elapsed[-1 - back] if back < len(elapsed) else -max(0, ceil(-taken - 1e-6))
        assert delays[row] == back + (max(0, ceil(-taken - 1e-6)) if back == len(elapsed) else 0)
        assert ahead[row] == pytest.approx(max(0.0, taken - at), abs=1e-9)


# -- choices -----------------------------------------------------------------------------


def test_every_filter_gets_the_noise_that_makes_the_window_best_and_minimum_variance_a_longer_window():
    track, _ = of_kind("grid", np.random.default_rng(6))
    axis = timing(track)
    choices = {name: choose(track, axis, Wish(order=1, filter=name)) for name in FILTERS}
    horizon, density = choices["ufir"].motion.horizon, choices["ufir"].density
    assert {choice.density for choice in choices.values()} == {density}
    assert choices["fms"].motion.horizon == ceil(1.5 * horizon)
    assert "half as long again" in choices["fms"].why_horizon
    assert choices["kalman"].why_density == f"the one for which a window of {horizon} steps is the best"


def test_the_density_counts_seconds_whatever_a_step_lasts():
    rng = np.random.default_rng(7)
    seconds = np.arange(200.0)
    positions = noisy(rng, seconds, 3.0)
    slow, fast = (recorded(seconds * unit, positions) for unit in (1.0, 0.1))
    one, other = (choose(each, timing(each), Wish(order=1)) for each in (slow, fast))
    assert other.density == pytest.approx(one.density * 1e3)
    told = choose(fast, timing(fast), Wish(order=1, density=2.0))
    assert told.density == pytest.approx(2.0)
    assert told.motion.q == pytest.approx(2.0 * 0.1**3)
    assert told.why_density == "as told"
    assert told.motion.r > one.motion.r  # less of the innovations is motion


def test_an_excessive_density_leaves_a_positive_sigma():
    track, _ = of_kind("grid", np.random.default_rng(8))
    motion = choose(track, timing(track), Wish(order=1, density=1e9)).motion
    assert 0.0 < motion.r < 1.0
    estimates = run(track, timing(track), replace(motion, filter="kalman"))
    np.testing.assert_allclose(estimates.position[3:], track.position[3:], atol=0.1)


# -- limits ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("delay", [300.0, 1e9])
def test_rows_too_late_to_be_used_are_counted_and_leave_the_estimate_alone(name, delay):
    seconds = np.arange(400.0)
    age = np.zeros(400)
    age[350] = delay
    measured = straight(seconds)
    measured[350] = 1e6
    track = recorded(seconds, measured, age=age, age_unit="steps")
    choice = choose(track, timing(track), Wish(order=1, filter=name))
    assert choice.motion.horizon < 20
    estimates = run(track, timing(track), replace(MOTION, filter=name))
    assert estimates.late.sum() == 1
    np.testing.assert_allclose(estimates.position[10:], straight(seconds)[10:], atol=1e-3)


def test_a_lag_that_needs_too_long_a_memory_is_refused():
    track, _ = of_kind("grid", np.random.default_rng(9))
    with pytest.raises(HorizonError, match="lag must be at most 200 steps for kalman, got 201"):
        run(track, timing(track), replace(MOTION, filter="kalman", lag=201))


def test_a_theta_beyond_its_limit_is_refused():
    track, _ = of_kind("grid", np.random.default_rng(9))
    with pytest.raises(ThetaTooLarge, match="theta must be below theta_max"):
        run(track, timing(track), replace(MOTION, filter="hinf", theta=1.0))


def test_an_automatic_theta_stays_below_its_limit_and_is_told():
    track, _ = of_kind("late", np.random.default_rng(10))
    low, high, limit = run(track, timing(track), replace(MOTION, filter="hinf")).theta
    assert 0.0 <= low < high
    assert limit > 0.0
