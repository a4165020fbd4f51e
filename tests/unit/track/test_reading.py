"""Whatever a table looks like, its good rows are read and its bad ones are named."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("pymap3d", reason="pip install ufirext[cli]")

from ufirext.track.columns import find_columns
from ufirext.track.csvfile import read_table
from ufirext.track.reading import read_track
from ufirext.track.series import UnusableTrack

from .tracks import write_table

SECONDS = list(range(12))
X = [3 * s for s in SECONDS]
Y = [-s for s in SECONDS]


def lines_of(track, fault):
    return [each.line for each in track.left_out if each.fault == fault]


@pytest.mark.parametrize(
    ("time", "x", "y"),
    [
        ("t", "x", "y"),
        ("T_S", "East_m", "North_m"),
        ("Time (s)", "Easting [m]", "Northing [m]"),
        ("elapsed", "X", "Y"),
    ],
)
def test_columns_are_found_by_their_usual_names(tmp_path, time, x, y):
    track = read_track(write_table(tmp_path / "a.csv", {time: SECONDS, "speed": X, x: X, y: Y}))
    np.testing.assert_array_equal(track.seconds, SECONDS)
    np.testing.assert_array_equal(track.position, np.column_stack([X, Y]))
    assert track.rows_read == len(SECONDS)
    assert track.left_out == []


def test_columns_are_found_by_the_names_that_are_told(tmp_path):
    path = write_table(tmp_path / "a.csv", {"tick": SECONDS, "x": Y, "a": X, "b": Y, "y": X})
    track = read_track(path, {"time": "tick", "x": "a", "y": "b"})
    np.testing.assert_array_equal(track.position, np.column_stack([X, Y]))


@pytest.mark.parametrize(
    ("header", "told", "message"),
    [
        (["x", "y"], {}, "no time column; it has 'x', 'y'; name it with --time"),
        (["t", "speed"], {}, "no position columns"),
        (["t", "lat"], {}, "no position columns"),
        (["t", "x", "X", "y"], {}, "two columns are named 'x'"),
        (["t", "x", "y"], {"x": "east"}, "no column 'east' for x"),
        (["t", "x", "y"], {"delay": "late"}, "no column 'late' for delay"),
        (["t", "lat", "lon", "a"], {"truth_x": "a"}, "--truth-x without a column for truth_y"),
    ],
)
def test_a_header_that_does_not_do_is_refused_with_advice(header, told, message):
    with pytest.raises(UnusableTrack, match=message):
        find_columns(header, told, "a.csv")


@pytest.mark.parametrize("separator", [",", ";", "\t", "|"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
def test_separator_encoding_and_line_ends_do_not_matter(tmp_path, separator, encoding, newline):
    path = tmp_path / "a.csv"
    rows = [("t", "x", "y"), *zip(SECONDS, X, Y, strict=True)]
    path.write_text(
        "\n".join(separator.join(map(str, row)) for row in rows), encoding=encoding, newline=newline
    )
    track = read_track(path)
    np.testing.assert_array_equal(track.position, np.column_stack([X, Y]))
    np.testing.assert_array_equal(track.lines, np.arange(2, 14))


def test_decimal_commas_are_read_where_the_comma_does_not_separate(tmp_path):
    columns = {"t": ["0,5", "1,5", "2,5"], "x": ["1,25", "-2,5", "3"], "y": ["1", "2", "3e1"]}
    track = read_track(write_table(tmp_path / "a.csv", columns, ";"))
    np.testing.assert_array_equal(track.seconds, [0.5, 1.5, 2.5])
    np.testing.assert_array_equal(track.position, [[1.25, 1], [-2.5, 2], [3, 30]])


def test_comments_and_empty_lines_are_no_rows_but_count_as_lines(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("# from a phone\n\nt,x,y\n0,1,2\n\n# pause\n1,2,oops\n2,3,4\n")
    track = read_track(path)
    assert track.lines.tolist() == [4, 8]
    assert track.rows_read == 3
    assert [(each.line, each.fault, each.found) for each in track.left_out] == [
        (7, "second coordinate is not a number", "y is 'oops'")
    ]


@pytest.mark.parametrize(
    ("row", "fault"),
    [
        ("5,15", "wrong number of fields"),
        ("5,15,-5,9", "wrong number of fields"),
        ("soon,15,-5", "time is not a number"),
        (",15,-5", "no time"),
        ("5,,-5", "no first coordinate"),
        ("5,nan,-5", "no first coordinate"),
        ("5,inf,-5", "first coordinate is not a number"),
        ("5,15,1e300", "second coordinate out of range"),
        ("1e300,15,-5", "time out of range"),
        ('5,"15,-5', "wrong number of fields"),
    ],
)
def test_a_broken_row_is_named_with_its_line_and_costs_only_itself(tmp_path, row, fault):
    path = write_table(tmp_path / "a.csv", {"t": SECONDS, "x": X, "y": Y})
    lines = path.read_text().splitlines()
    lines[6] = row
    path.write_text("\n".join(lines))
    track = read_track(path)
    assert lines_of(track, fault) == [7]
    assert len(track) == len(SECONDS) - 1
    assert track.rows_read == len(SECONDS)


LETTERS = st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"]) | st.sampled_from('",;#\t\r ')


@given(st.lists(st.text(LETTERS, max_size=30), max_size=30))
def test_no_table_is_so_broken_that_rows_vanish_unreported(tmp_path_factory, rows):
    path = tmp_path_factory.mktemp("broken") / "a.csv"
    path.write_text("t,x,y\n0,1,2\n" + "\n".join(rows) + "\n1,2,3\n", encoding="utf-8")
    table = read_table(path, {})
    assert len(table.lines) + len(table.left_out) == table.rows_read
    assert table.rows_read >= 2


def test_stamps_that_repeat_or_run_backward_or_leap_ahead_are_left_out(tmp_path):
    stamps = [0, 1, 2, 2, 3, 1, 4, 5e8, 5, 6]
    track = read_track(write_table(tmp_path / "a.csv", {"t": stamps, "x": range(10), "y": range(10)}))
    assert track.seconds.tolist() == [0, 1, 2, 3, 4, 5, 6]
    assert lines_of(track, "time repeats") == [5]
    assert lines_of(track, "time runs backward") == [7]
    assert lines_of(track, "time leaps ahead") == [9]


def test_times_of_day_go_on_past_midnight(tmp_path):
    stamps = ["23:59:58", "23:59:59", "00:00:00", "00:00:01.5"]
    track = read_track(write_table(tmp_path / "a.csv", {"time": stamps, "x": range(4), "y": range(4)}))
    assert (track.seconds - track.seconds[0]).tolist() == [0, 1, 2, 3.5]
    assert track.left_out == []


def test_a_file_that_runs_backward_is_read_from_its_end(tmp_path):
    track = read_track(write_table(tmp_path / "a.csv", {"t": SECONDS[::-1], "x": X, "y": Y}))
    assert track.seconds.tolist() == SECONDS
    assert track.position[0].tolist() == [X[-1], Y[-1]]
    assert "runs backward" in track.notes[0]


def test_several_rows_may_arrive_at_once_when_they_carry_delays(tmp_path):
    columns = {"t": [0, 1, 2, 2, 2], "x": [0, 1, 2, 1, 1], "y": [0, 0, 0, 0, 0], "delay": [0, 0, 0, 1, 1]}
    track = read_track(write_table(tmp_path / "a.csv", columns))
    assert track.lines.tolist() == [2, 3, 4, 5]  # the last says what the one before it said
    assert lines_of(track, "time repeats") == [6]


@pytest.mark.parametrize(
    ("name", "told", "unit"), [("delay", "", "s"), ("delay_steps", "", "steps"), ("age", "steps", "steps")]
)
def test_delays_are_seconds_unless_their_name_or_the_user_says_steps(tmp_path, name, told, unit):
    columns = {"t": [0, 1, 2], "x": [0, 1, 2], "y": [0, 0, 0], name: [0, 1, 0.5]}
    track = read_track(write_table(tmp_path / "a.csv", columns), delay_unit=told)
    assert track.age_unit == unit
    assert track.age.tolist() == [0, 1, 0.5]


def test_a_negative_delay_is_no_delay(tmp_path):
    columns = {"t": [0, 1, 2], "x": [0, 1, 2], "y": [0, 0, 0], "delay": [0, -1, 0]}
    assert lines_of(read_track(write_table(tmp_path / "a.csv", columns)), "negative delay") == [3]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "the file is empty"),
        (b"\n\n \n", "the file is empty"),
        (b"# only\n# comments\n", "no header"),
        (b"t,x,y\n", "only a header"),
        (b"0,1,2\n1,2,3\n", "line 1 must name the columns, got '0,1,2'"),
        (b"t,x,y\n0,a,2\n1,b,3\n", "none of its 2 rows can be used; the first, line 2: first coordinate"),
        (b"t,x,y\n0,nan,nan\n1,nan,nan\n", "none of its 2 rows can be used"),
        (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "a binary file"),
        (bytes(range(256)) * 20, "a binary file"),
        (b"<?xml version='1.0'?><kml></kml>", "XML, but not GPX"),
        (b"<gpx><trk><trkseg><trkpt lat='1'", "not a GPX file"),
        (b"t,lat,lon\n0,95,10\n1,0,0\n", "latitude out of range"),
    ],
)
def test_an_unusable_file_is_refused_with_the_reason(tmp_path, content, message):
    path = tmp_path / "a.csv"
    path.write_bytes(content)
    with pytest.raises(UnusableTrack, match=message):
        read_track(path)


def test_a_missing_file_and_a_directory_are_refused(tmp_path):
    with pytest.raises(UnusableTrack, match="no such file"):
        read_track(tmp_path / "none.csv")
    with pytest.raises(UnusableTrack, match="a directory"):
        read_track(tmp_path)


def test_degrees_become_metres_east_and_north(tmp_path):
    columns = {"t": [0, 1, 2], "lat": [50, 50.0001, 50.0001], "lon": [10, 10, 10.0001]}
    track = read_track(write_table(tmp_path / "a.csv", columns))
    # lengths of a second of arc on the WGS 84 ellipsoid at 50 degrees
    np.testing.assert_allclose(track.position, [[0, 0], [0, 11.1229], [7.1696, 11.1229]], atol=2e-3)
    assert track.axes == ("east", "north")
    np.testing.assert_allclose(track.latlon(track.position)[:, 0], columns["lat"], atol=1e-12)


def test_metres_win_over_degrees_that_agree_with_them(tmp_path):
    columns = {"t": [0, 1, 2], "lat": [50, 50.0001, 50.0002], "lon": [10, 10, 10]}
    metres = {"east_m": [5, 5, 5], "north_m": [7, 18.12, 29.25]}
    truth = {"truth_east_m": [5, 5, 5], "truth_north_m": [7, 18, 29]}
    track = read_track(write_table(tmp_path / "a.csv", columns | metres | truth))
    np.testing.assert_array_equal(track.position[:, 1], metres["north_m"])
    np.testing.assert_array_equal(track.truth[:, 1], truth["truth_north_m"])
    np.testing.assert_allclose(track.latlon(track.position)[:, 0], columns["lat"], atol=1e-7)


def test_metres_that_disagree_with_degrees_are_not_used_and_neither_is_their_truth(tmp_path):
    columns = {"t": [0, 1, 2], "lat": [50, 50.001, 50.002], "lon": [10, 10, 10]}
    sensor = {"x": [0.1, 0.2, 9.8], "y": [0.3, 0.1, 9.7], "truth_x": [0, 0, 0], "truth_y": [0, 0, 0]}
    track = read_track(write_table(tmp_path / "a.csv", columns | sensor))
    assert track.position[2, 1] == pytest.approx(222.46, abs=0.1)
    assert track.truth is None
    assert len(track.notes) == 2


def test_true_degrees_are_laid_in_the_plane_of_the_measured_ones(tmp_path):
    columns = {
        "t": [0, 1],
        "lat": [50, 50.0001],
        "lon": [10, 10],
        "true_lat": [50.0001, 50.0001],
        "true_lon": [10, 10],
    }
    track = read_track(write_table(tmp_path / "a.csv", columns))
    np.testing.assert_allclose(track.truth[1], track.position[1], atol=1e-9)


def test_a_track_across_the_date_line_has_no_leap(tmp_path):
    lon = [179.9998, 179.9999, -180, -179.9999]
    track = read_track(write_table(tmp_path / "a.csv", {"t": range(4), "lat": [10] * 4, "lon": lon}))
    np.testing.assert_allclose(np.diff(track.position[:, 0]), 10.96, atol=0.01)
    np.testing.assert_allclose(np.abs(track.latlon(track.position)[:, 1]), np.abs(lon), atol=1e-9)


def test_a_row_on_the_other_side_of_the_globe_is_left_out_even_if_it_is_the_first(tmp_path):
    columns = {"t": range(5), "lat": [-50, 50, 50, 50, 50], "lon": [10, 10, 10.0001, 10.0002, 10.0003]}
    track = read_track(write_table(tmp_path / "a.csv", columns))
    assert lines_of(track, "too far away for one plane") == [2]
    assert np.abs(track.position).max() < 30


def test_zero_zero_is_no_fix(tmp_path):
    columns = {"t": range(4), "lat": [50, 0, 50, 50], "lon": [10, 0, 10, 10]}
    track = read_track(write_table(tmp_path / "a.csv", columns))
    assert lines_of(track, "no fix (latitude and longitude both 0)") == [3]


def test_columns_that_are_named_win_over_degrees_and_need_none(tmp_path):
    metres = {"ref_e": [0, 50, 100, 150], "ref_n": [3, 3, 3, 3]}
    columns = {"t": range(4), "lat": [50, "", 50.001, 95], "lon": [10, 10, "", 10], **metres}
    path = write_table(tmp_path / "a.csv", columns)
    track = read_track(path, {"x": "ref_e", "y": "ref_n"})
    np.testing.assert_array_equal(track.position[:, 0], metres["ref_e"])
    assert track.frame is not None  # the first row alone ties it to the globe
    assert track.left_out == []
    path = write_table(tmp_path / "b.csv", columns | {"lat": [50, 50.1, 50.2, 50.3], "lon": [10] * 4})
    track = read_track(path, {"x": "ref_e", "y": "ref_n"})
    np.testing.assert_array_equal(track.position[:, 0], metres["ref_e"])
    assert track.frame is None
    assert track.notes == ["latitude and longitude do not agree with the named columns and were not used"]


@pytest.mark.parametrize(
    ("told", "found"), [("x", {"truth_x", "truth_y"}), ("lat", {"truth_lat", "truth_lon"})]
)
def test_the_truth_that_is_named_wins(told, found):
    header = ["t", "x", "y", "true_x", "true_y", "true_lat", "true_lon"]
    columns = find_columns(header, {f"truth_{told}": f"true_{told}"}, "a.csv")
    assert {role for role in columns if role.startswith("truth")} == found
