"""The motion model, the horizon and the noise come from the data."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("pymap3d", reason="pip install ufirext[cli]")

from ufirext import HorizonError, best_horizon, kinematic
from ufirext.track.motion import Wish, choose
from ufirext.track.run import run
from ufirext.track.summary import summarise
from ufirext.track.timing import timing

from .tracks import noisy, recorded, straight


def walk(rng, order, rows, q, sigma):
    """A path whose derivative of the given order is a random walk, and measurements of it."""
    path = np.cumsum(np.sqrt(q) * rng.standard_normal((rows, 2)), axis=0)
    for _ in range(order):
        path = np.cumsum(path, axis=0)
    return path, path + sigma * rng.standard_normal((rows, 2))


def chosen(position, **told):
    track = recorded(np.arange(float(len(position))), position)
    return track, timing(track), choose(track, timing(track), Wish(**told))


def test_the_order_is_that_of_the_path():
    rng = np.random.default_rng(1)
    assert chosen(walk(rng, 1, 1500, 0.05, 1.0)[1])[2].motion.order == 1
    assert chosen(walk(rng, 2, 1500, 0.001, 0.2)[1])[2].motion.order == 2


@pytest.mark.parametrize(("q", "sigma"), [(0.05, 1.0), (0.01, 3.0)])
def test_noise_horizon_and_nis_are_those_of_the_simulation(q, sigma):
    truth, measured = walk(np.random.default_rng(2), 1, 4000, q, sigma)
    track, axis, choice = chosen(measured, order=1)
    model_best = best_horizon(kinematic(1, 2, 1.0, q=q, r=sigma**2))
    assert 0.6 * model_best <= choice.motion.horizon <= 1.7 * model_best
    assert np.sqrt(choice.motion.r) == pytest.approx(sigma, rel=0.1)
    estimates = run(track, axis, choice.motion)
    assert summarise(track, estimates).nis == pytest.approx(2.0, abs=0.1)
    ratio = (estimates.position - truth)[100:] / estimates.position_std[100:]
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1.0, abs=0.15)


def test_a_told_sigma_is_kept_and_the_rest_is_motion():
    measured = walk(np.random.default_rng(3), 1, 1000, 0.05, 2.0)[1]
    small, large = (chosen(measured, order=1, horizon=10, sigma=sigma)[2].motion for sigma in (1.0, 1.5))
    assert (small.r, large.r) == (1.0, 2.25)
    assert small.q > large.q > 0


def test_what_is_told_is_done():
    measured = noisy(np.random.default_rng(4), np.arange(200.0), 2.0)
    choice = chosen(measured, order=0, horizon=7, sigma=4.0)[2]
    assert (choice.motion.order, choice.motion.horizon, choice.motion.r) == (0, 7, 16.0)
    assert {choice.why_order, choice.why_horizon, choice.why_sigma} == {"as told"}


def test_a_lag_lies_in_the_middle_of_its_window_unless_a_horizon_is_told():
    measured = noisy(np.random.default_rng(5), np.arange(200.0), 2.0)
    choice = chosen(measured, order=1, lag=20)[2]
    assert choice.motion.horizon == 41
    assert "lag" in choice.why_horizon
    track, axis, choice = chosen(measured, order=1, horizon=10, lag=10)
    with pytest.raises(HorizonError):
        run(track, axis, choice.motion)


@pytest.mark.parametrize("rows", [2, 3, 4, 5, 8, 12, 20])
def test_few_rows_are_enough_for_a_result(rows):
    seconds = np.arange(float(rows))
    track, axis, choice = chosen(noisy(np.random.default_rng(6), seconds, 2.0, straight))
    estimates = run(track, axis, choice.motion)
    assert np.isfinite(estimates.position).all()
    assert np.isfinite(estimates.position_std).all()
    assert estimates.ready[-1]


def test_exact_data_give_finite_standard_deviations():
    track, axis, choice = chosen(straight(np.arange(50.0)))
    estimates = run(track, axis, choice.motion)
    assert choice.motion.order == 1  # the least that explains everything
    assert np.isfinite(estimates.position_std).all()
    np.testing.assert_allclose(estimates.position, track.position, atol=1e-8)


def test_a_long_track_is_judged_by_blocks_spread_over_it():
    rng = np.random.default_rng(7)
    # the first tenth stands still; the choice must not rest on it
    moving = walk(rng, 1, 18_000, 0.05, 1.0)[0]
    path = np.vstack([np.zeros((2_000, 2)), moving])
    choice = chosen(path + rng.standard_normal(path.shape), order=1)[2]
    model_best = best_horizon(kinematic(1, 2, 1.0, q=0.05, r=1.0))
    assert choice.motion.horizon <= 2 * model_best
