"""`ufirext track` on recorded tracks does no harm to them, and gains on truth with noise added."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("pymap3d", reason="pip install ufirext[cli]")

from dataclasses import replace

from ufirext.track.motion import choose
from ufirext.track.reading import read_track
from ufirext.track.run import run
from ufirext.track.summary import facts, summarise
from ufirext.track.timing import timing

NAMES = (
    "bike_hampshire_edge605_1hz",
    "bike_hampshire_motog3_gaps",
    "car_berlin_potsdamer_ublox_truth_5hz",
    "car_california_comma2k19_ublox_truth_10hz",
    "car_chemnitz_truthonly_1hz",
    "car_dresden_balzer_10hz",
)


@pytest.mark.parametrize("name", NAMES)
def test_every_recorded_track_is_filtered_without_harm(tracks, name):
    track = read_track(tracks / f"{name}.csv")
    axis = timing(track)
    choice = choose(track, axis)
    estimates = run(track, axis, choice.motion)
    summary = summarise(track, estimates)
    assert track.left_out == []
    assert np.isfinite(estimates.position).all()
    assert np.isfinite(estimates.velocity[estimates.ready]).all()
    assert 1.0 < summary.nis < 3.0
    # an estimate stays as near to its measurement as measurements are to their predictions
    assert summary.moved < 2.0 * summary.innovation_std
    if summary.raw_rmse is not None:
        assert summary.filtered_rmse < 1.001 * summary.raw_rmse
    assert dict(facts(track, axis, choice, estimates, summary))["left out"] == "none"


def test_white_noise_on_a_recorded_drive_is_reduced(tracks):
    track = read_track(tracks / "car_chemnitz_truthonly_1hz.csv")
    noise = 5.0 * np.random.default_rng(1).standard_normal(track.position.shape)
    noisy = replace(track, position=track.position + noise, truth=track.position)
    axis = timing(noisy)
    choice = choose(noisy, axis)
    summary = summarise(noisy, run(noisy, axis, choice.motion))
    assert summary.filtered_rmse < 0.95 * summary.raw_rmse
    assert np.sqrt(choice.motion.r) == pytest.approx(5.0, rel=0.25)
