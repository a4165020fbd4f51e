"""The segments of a GPX file are tracks of their own: nothing is known of the way from one to the next."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from itertools import zip_longest
from xml.sax.saxutils import escape

import numpy as np
import pytest

pytest.importorskip("pymap3d", reason="pip install ufirext[cli]")
pytest.importorskip("gpxpy", reason="pip install ufirext[cli]")

import gpxpy

from ufirext.track.motion import Wish, choose
from ufirext.track.reading import read_track
from ufirext.track.run import Motion, run
from ufirext.track.series import UnusableTrack
from ufirext.track.summary import facts, summarise
from ufirext.track.timing import timing
from ufirext.track.writing import write_track

START = datetime(2024, 5, 1, 12, tzinfo=UTC)


def write_gpx(path, tracks, names=()):
    """Tracks of segments of (seconds, metres to the north) each."""
    text = '<gpx version="1.1" creator="a" xmlns="http://www.topografix.com/GPX/1/1">'
    for segments, name in zip_longest(tracks, names):
        text += "<trk>" + ("" if name is None else f"<name>{escape(name)}</name>")
        for points in segments:
            rows = (
                f'<trkpt lat="{51 + metres / 111_000:.9f}" lon="13">'
                f"<time>{(START + timedelta(seconds=second)).isoformat()}</time></trkpt>"
                for second, metres in points
            )
            text += f"<trkseg>{''.join(rows)}</trkseg>"
        text += "</trk>"
    path.write_text(text + "</gpx>", encoding="utf-8")
    return path


def leg(first, rows, jump=0.0, speed=12.0):
    noise = np.random.default_rng(first).normal(0, 3, rows)
    return [(first + row, speed * (first + row) + jump + noise[row]) for row in range(rows)]


@pytest.mark.parametrize("pause", [1, 5, 5.3, 5000])
def test_a_jump_between_segments_does_not_touch_the_filter(tmp_path, pause):
    first, second = leg(0, 100), leg(0, 100)
    moved = [(100 + pause + s, m + 4000.0) for s, m in second]
    track = read_track(write_gpx(tmp_path / "a.gpx", [[first, moved]]))
    axis = timing(track)
    assert axis.regular
    assert track.breaks.tolist() == [100]
    estimates = run(track, axis, Motion(1, 12))
    assert estimates.starts.tolist() == [0, 100]
    alone = read_track(write_gpx(tmp_path / "b.gpx", [[second]]))
    expected = run(alone, timing(alone), Motion(1, 12))
    np.testing.assert_allclose(estimates.velocity[100:, 1], expected.velocity[:, 1], atol=1e-3)
    np.testing.assert_allclose(estimates.velocity[:100, 1], expected.velocity[:, 1], atol=1e-3)


def test_a_jump_between_segments_does_not_touch_the_choice_of_the_horizon(tmp_path):
    parts = [leg(0, 200), [(s, m + 3000.0) for s, m in leg(205, 200)], leg(410, 200)]
    straight = choose_of(write_gpx(tmp_path / "a.gpx", [[parts[0], leg(205, 200), parts[2]]]))
    jumping = choose_of(write_gpx(tmp_path / "b.gpx", [parts[:1], parts[1:]]))
    assert jumping.motion.horizon == straight.motion.horizon
    assert jumping.motion.r == pytest.approx(straight.motion.r, rel=1e-4)


def choose_of(path):
    track = read_track(path)
    return choose(track, timing(track), Wish(order=1))


def test_tracks_and_segments_come_out_as_they_came_in_and_are_counted(tmp_path):
    track = read_track(write_gpx(tmp_path / "a.gpx", [[leg(0, 40), leg(50, 40)], [leg(95, 25)]]))
    axis = timing(track)
    choice = choose(track, axis, Wish(order=1, horizon=8))
    estimates = run(track, axis, choice.motion)
    write_track(tmp_path / "out.gpx", track, estimates)
    content = gpxpy.parse((tmp_path / "out.gpx").read_text())
    assert [[len(each.points) for each in part.segments] for part in content.tracks] == [[40, 40], [25]]
    table = dict(facts(track, axis, choice, estimates, summarise(track, estimates)))
    assert table["segments"] == "3, up to 11 s apart; a fresh start in each"
    assert table["gaps"] == "none"
    assert track.notes == []


def test_the_names_of_tracks_stay_with_their_points(tmp_path):
    """Out of order in the file, interleaved in time, with a gap that no window spans, and one unnamed."""
    there, back, later = "There & <back>", "Zurück", None
    tracks = [[leg(100, 30)], [leg(0, 30), leg(200, 30) + leg(400, 30)], [leg(600, 30)]]
    track = read_track(write_gpx(tmp_path / "a.gpx", tracks, [there, back, later]))
    estimates = run(track, timing(track), Motion(1, 12))
    write_track(tmp_path / "out.gpx", track, estimates)
    content = gpxpy.parse((tmp_path / "out.gpx").read_text(encoding="utf-8"))
    assert [each.name for each in content.tracks] == [back, there, back, later]
    assert [[len(each.points) for each in part.segments] for part in content.tracks] == [
        [30],
        [30],
        [30, 30],
        [30],
    ]
    assert [(part.segments[0].points[0].time - START).seconds for part in content.tracks] == [
        0,
        100,
        200,
        600,
    ]


def test_a_table_becomes_one_track_without_a_name(tmp_path):
    rows = "".join(f"{second},51.{second:03d},13\n" for second in range(30))
    (tmp_path / "a.csv").write_text(f"time,lat,lon\n{rows}", encoding="utf-8")
    track = read_track(tmp_path / "a.csv")
    write_track(tmp_path / "out.gpx", track, run(track, timing(track), Motion(1, 12)))
    (written,) = gpxpy.parse((tmp_path / "out.gpx").read_text()).tracks
    assert (written.name, len(written.segments)) == (None, 1)


def test_segments_are_put_in_order_of_time(tmp_path):
    track = read_track(write_gpx(tmp_path / "a.gpx", [[leg(200, 30)], [leg(100, 30), leg(0, 30)]]))
    assert len(track) == 90
    assert track.lines[[0, 30, 60]].tolist() == [61, 31, 1]
    assert track.notes == ["the segments of the file were put in order of time"]


def test_tracks_that_overlap_in_time_are_reported(tmp_path):
    track = read_track(write_gpx(tmp_path / "a.gpx", [[leg(0, 100)], [leg(50, 100)]]))
    assert len(track) == 150
    assert {each.fault for each in track.left_out} == {"time overlaps another segment"}
    assert len(track.left_out) == 50
    assert "segment 2 of the file overlaps an earlier one in time" in track.notes[0]
    assert "50 points were left out" in track.notes[0]


def test_segments_of_a_single_point_are_a_track_nevertheless(tmp_path):
    track = read_track(write_gpx(tmp_path / "a.gpx", [[[(s, 5.0 * s)] for s in range(10)]]))
    assert run(track, timing(track), Motion(1, 6)).starts.tolist() == list(range(10))


def test_routes_and_waypoints_are_no_recordings_whether_they_carry_times_or_not(tmp_path):
    path = tmp_path / "a.gpx"
    path.write_text(
        '<gpx version="1.1" creator="a" xmlns="http://www.topografix.com/GPX/1/1">'
        '<wpt lat="51" lon="13"><time>2024-01-01T00:00:00Z</time></wpt></gpx>'
    )
    with pytest.raises(UnusableTrack, match=r"no track points .*0 routes and 1 waypoints") as caught:
        read_track(path)
    assert "no time" not in str(caught.value)
