"""Stamps of every usual kind become seconds; as few rows as possible are out of order."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("pandas", reason="pip install ufirext[cli]")

from ufirext.track.stamps import Clock, in_order


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
