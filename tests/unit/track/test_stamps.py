"""Stamps of every usual kind become seconds; as few rows as possible are out of order."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("pymap3d", reason="pip install ufirext[cli]")

from ufirext.track.reading import read_track
from ufirext.track.series import UnusableTrack
from ufirext.track.stamps import Clock, in_order

from .tracks import write_table


@pytest.mark.parametrize(
    ("name", "texts", "seconds", "epoch"),
    [
        ("t", ["0", "0.5", "1e1"], [0, 0.5, 10], False),
        ("t_ms", ["0", "500"], [0, 0.5], False),
        ("timestamp", ["1700000000", "1700000001"], [1.7e9, 1.7e9 + 1], True),
        ("timestamp", ["1700000000000", "1700000000500"], [1.7e9, 1.7e9 + 0.5], True),
        ("timestamp", ["1700000000000000", "1700000000500000"], [1.7e9, 1.7e9 + 0.5], True),
        ("time", ["1970-01-01T00:00:01Z", "1970-01-01T02:00:02.25+02:00"], [1, 2.25], True),
        ("time", ["1970-01-02", "1970-01-02 00:00:01"], [86400, 86401], True),
        ("time", ["09:59:59.5", "10:00:00"], [35999.5, 36000], False),
        ("t", ["1000", "1001", "2024"], [1000, 1001, 2024], False),
    ],
)
def test_stamps_become_seconds(name, texts, seconds, epoch):
    clock = Clock.recognised(texts, name, decimal_comma=False)
    np.testing.assert_allclose(clock.seconds(texts, decimal_comma=False), seconds, rtol=1e-15)
    assert clock.epoch is epoch


def test_what_is_no_stamp_is_nan():
    clock = Clock.recognised(["2024-05-01T00:00:00Z"] * 3, "time", decimal_comma=False)
    assert np.isnan(clock.seconds(["", "soon", "12", "2024-13-01T00:00:00Z"], decimal_comma=False)).all()


def _longest_by_hand(stamps, strictly):
    """The size of the largest set of rows in order: try all sets, from the largest."""
    for size in range(len(stamps), 0, -1):
        for rows in combinations(range(len(stamps)), size):
            steps = np.diff([stamps[row] for row in rows])
            if np.all(steps > 0 if strictly else steps >= 0):
                return size
    return 0


@given(st.lists(st.integers(0, 6), min_size=1, max_size=9), st.booleans())
def test_as_many_rows_as_possible_are_kept_in_order(stamps, strictly):
    seconds = np.array(stamps, dtype=float)
    keep = in_order(seconds, strictly=strictly)
    steps = np.diff(seconds[keep])
    assert np.all(steps > 0 if strictly else steps >= 0)
    assert keep.sum() == _longest_by_hand(stamps, strictly)


@given(st.lists(st.integers(0, 4), min_size=1, max_size=12))
def test_of_rows_that_share_a_stamp_the_first_is_kept(stamps):
    stamps = sorted(stamps)
    keep = in_order(np.array(stamps, dtype=float), strictly=True)
    assert np.flatnonzero(keep).tolist() == [stamps.index(each) for each in sorted(set(stamps))]


# -- as a file writes them ---------------------------------------------------------------


def stamped(path, stamps, **more):
    columns = {**more, "time": stamps, "lat": [51.0] * len(stamps), "lon": 13 + 1e-4 * np.arange(len(stamps))}
    return read_track(write_table(path / "a.csv", columns))


def test_a_date_and_a_time_of_day_in_two_columns_are_one_stamp(tmp_path):
    dates = ["2024-05-01"] * 3 + ["2024-05-03"] * 3
    times = ["12:00:00", "12:00:01", "12:00:02.5", "9:00:00", "09:00:01", "09:00:02"]
    track = stamped(tmp_path, times, date=dates)
    together = stamped(tmp_path, [f"{d}T{t:0>8}" for d, t in zip(dates, times, strict=True)])
    np.testing.assert_array_equal(track.seconds, together.seconds)
    assert track.dates
    assert track.epoch
    assert track.left_out == []
    assert track.notes == ["time stamps without a zone are taken as UTC"]
    zoned = stamped(tmp_path, [f"{time:0>8}+02:00" for time in times], Date=dates)
    np.testing.assert_array_equal(zoned.seconds, track.seconds - 7200)
    assert zoned.notes == []


@pytest.mark.parametrize(
    ("date", "stamps", "why"),
    [
        ("01.05.2024", ["10:00:00", "10:00:01"], "its dates are not ISO 8601"),
        ("2024-05-01", ["12", "13"], "the stamps are no times of day"),
    ],
)
def test_a_date_that_cannot_be_joined_is_noted(tmp_path, date, stamps, why):
    track = stamped(tmp_path, stamps, date=[date] * 2)
    assert not track.dates
    assert len(track.notes) == 1
    assert why in track.notes[0]


def test_a_date_beside_whole_stamps_is_not_needed(tmp_path):
    stamps = ["2024-05-01T10:00:00Z", "2024-05-01T10:00:01Z"]
    assert stamped(tmp_path, stamps, date=["01.05.2024"] * 2).notes == []


@pytest.mark.parametrize(
    ("stamps", "note"),
    [
        (["2024-05-01T10:00:00Z", "2024-05-01T10:00:01+00:00"], []),
        (["2024-05-01 10:00:00", "2024-05-01T10:00:01"], ["time stamps without a zone are taken as UTC"]),
        (["2024-05-01", "2024-05-02"], ["time stamps without a zone are taken as UTC"]),
        (
            ["2024-05-01T10:00:00Z", "2024-05-01T10:00:01", "2024-05-01 10:00:02.5-0700"],
            ["1 of 3 time stamps without a zone are taken as UTC"],
        ),
        (["10:00:00", "10:00:01"], []),
    ],
)
def test_stamps_without_a_zone_are_noted(tmp_path, stamps, note):
    assert stamped(tmp_path, stamps).notes == note


def test_an_hour_that_comes_twice_hints_at_daylight_saving(tmp_path):
    minutes = [f"2024-10-27 02:{each:02d}:00" for each in range(30, 60)]
    track = stamped(tmp_path, [*minutes, *(f"2024-10-27 02:{each:02d}:00" for each in range(60))])
    assert "at line 32 the time goes back by one hour" in track.notes[1]
    assert "daylight saving" in track.notes[1]
    assert track.left_out
    for row in track.left_out:
        assert "2024-10-27 02:" in row.found
    back = [*range(40), *range(20, 60)]  # twenty minutes are no daylight saving
    assert len(stamped(tmp_path, [f"2024-10-27 02:{each:02d}:00" for each in back]).notes) == 1


def test_a_leap_second_and_stamps_of_another_kind_are_named(tmp_path):
    track = stamped(tmp_path, ["2016-12-31T23:59:59Z", "2016-12-31T23:59:60Z", "2017-01-01T00:00:01Z", "5"])
    assert [(each.line, each.fault) for each in track.left_out] == [
        (3, "a leap second, which seconds since 1970 do not count"),
        (5, "time is not ISO 8601 (2024-05-01T10:00:00Z), as the others are"),
    ]
    expected = "neither a number, nor ISO 8601 .2024-05-01T10:00:00Z., nor hours:minutes:seconds"
    with pytest.raises(UnusableTrack, match=expected):
        stamped(tmp_path, ["27.10.2024 10:00:00", "27.10.2024 10:00:01"])
