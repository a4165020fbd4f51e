"""The numbers and words of the table, against the same by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pymap3d", reason="pip install ufirext[cli]")

from ufirext.track.motion import Wish, choose
from ufirext.track.run import Motion, run
from ufirext.track.series import LeftOut
from ufirext.track.summary import duration, facts, summarise
from ufirext.track.timing import timing

from .tracks import noisy, recorded


@pytest.fixture
def example():
    seconds = np.arange(200.0)
    truth = noisy(np.random.default_rng(0), seconds, 0.0)
    track = recorded(
        seconds, truth + 2.0 * np.random.default_rng(1).standard_normal(truth.shape), truth=truth
    )
    return track, run(track, timing(track), Motion(1, 8, q=0.02, r=4.0))


def test_statistics_are_those_of_the_rows_with_a_whole_window_behind_them(example):
    track, estimates = example
    summary = summarise(track, estimates)
    y = estimates.innovation[8:]
    assert summary.judged == 192
    assert summary.innovation_std == pytest.approx(np.sqrt(np.mean(y**2)))
    pairs = np.sum(y[1:] * y[:-1]) / (0.5 * np.sum(y[1:] ** 2) + 0.5 * np.sum(y[:-1] ** 2))
    assert summary.autocorrelation == pytest.approx(pairs)
    assert summary.nis == pytest.approx(estimates.nis[8:].mean())


def test_errors_are_taken_where_the_truth_is_known(example):
    track, estimates = example
    truth = track.truth.copy()
    truth[::2] = np.nan
    summary = summarise(replace(track, truth=truth), estimates)
    assert summary.true_rows == 100
    off = estimates.position[1::2] - truth[1::2]
    assert summary.filtered_rmse == pytest.approx(np.sqrt(np.mean(np.sum(off**2, axis=1))))
    nowhere = summarise(replace(track, truth=np.full_like(truth, np.nan)), estimates)
    assert (nowhere.raw_rmse, nowhere.filtered_rmse) == (None, None)


def test_no_pair_of_innovations_reaches_across_a_fresh_start():
    seconds = np.concatenate([1000.0 * piece + np.arange(5.0) for piece in range(40)])
    track = recorded(seconds, noisy(np.random.default_rng(2), seconds, 2.0))
    estimates = run(track, timing(track), Motion(1, 6, r=4.0))
    assert np.isnan(estimates.innovation[estimates.starts]).all()


def test_the_table_groups_what_was_left_out_and_counts_the_gaps(example):
    track, _ = example
    keep = np.ones(200, dtype=bool)
    keep[[50, 51, 90, *range(120, 160)]] = False
    left_out = [LeftOut(line, "no time", "t is ''") for line in range(2, 9)] + [
        LeftOut(9, "time repeats", "5 s")
    ]
    short = replace(
        track,
        seconds=track.seconds[keep],
        position=track.position[keep],
        truth=None,
        lines=track.lines[keep],
        left_out=left_out,
        notes=["a note"],
    )
    axis = timing(short)
    choice = choose(short, axis, Wish(order=1, horizon=8))
    estimates = run(short, axis, choice.motion)
    lines = facts(short, axis, choice, estimates, summarise(short, estimates))
    left = [text for heading, text in lines if heading == "left out"]
    assert left[0].startswith("7: no time: line 2 (t is ''); line 3")
    assert left[0].endswith("and 2 more")
    assert left[1] == "1: time repeats: line 9 (5 s)"
    table = dict(lines)
    assert table["gaps"] == "3, the longest 41 s; 1 longer than a window, a fresh start after each"
    assert table["time"] == "3.3 min, nominally 1 Hz, on a grid"
    assert table["note"] == "a note"


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.25, "0.25 s"), (119, "119 s"), (600, "10.0 min"), (86400, "24.0 h")]
)
def test_spans_are_said_for_people(seconds, text):
    assert duration(seconds) == text
