"""Every kind of track can be drawn, and what is drawn is named."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="pip install ufirext[plot]")
pytest.importorskip("pymap3d", reason="pip install ufirext[cli]")

from dataclasses import replace

from matplotlib.colors import to_hex

from ufirext.track.figure import DARK, LIGHT, draw, write_picture
from ufirext.track.run import Motion, run
from ufirext.track.timing import timing

from .tracks import noisy, recorded


def drawn(track, motion, theme=LIGHT):
    axis = timing(track)
    return draw(track, axis, run(track, axis, motion), theme, "a drive").axes


def example(rows=200):
    seconds = np.arange(float(rows))
    return recorded(seconds, noisy(np.random.default_rng(1), seconds, 3.0))


def titles(panels):
    return [panel.get_title(loc="left").split(":")[0] for panel in panels]


def test_the_last_panel_shows_the_error_the_speed_or_the_distance_moved():
    track = example()
    known = replace(track, truth=track.position + 1.0)
    assert titles(drawn(known, Motion(1, 8))) == ["Track", "Closer", "Residuals", "Distance to the truth"]
    assert titles(drawn(track, Motion(1, 8)))[3] == "Estimated speed"
    assert titles(drawn(track, Motion(0, 8)))[3] == "Estimate to measurement"


@pytest.mark.parametrize("theme", [LIGHT, DARK])
def test_every_axis_has_a_unit_and_colours_that_stand_out(theme):
    for panel in drawn(example(), Motion(1, 8), theme):
        for label in (panel.xaxis.label, panel.yaxis.label):
            assert label.get_text().split()[-1] in ("m", "s", "m/s")
            assert label.get_color() == theme.ink != theme.ground
        assert all(to_hex(text.get_color()) == theme.ink for text in panel.get_legend().get_texts())


@pytest.mark.parametrize("rows", [2, 3, 60, 25_000])
def test_short_and_long_tracks_can_be_drawn(rows, tmp_path):
    track = example(rows)
    axis = timing(track)
    write_picture(tmp_path / "a.png", track, axis, run(track, axis, Motion(1, 6)), "a drive", [])
    assert (tmp_path / "a.png").stat().st_size > 10_000


def test_lines_are_not_drawn_across_a_fresh_start():
    seconds = np.array([*range(50), *range(500, 550)], dtype=float)
    track = recorded(seconds, noisy(np.random.default_rng(2), seconds, 1.0))
    estimated = next(line for line in drawn(track, Motion(1, 8))[0].lines if line.get_label() == "estimated")
    assert np.isnan(estimated.get_xdata()).sum() == 1


def test_the_closer_look_is_where_estimate_and_measurement_differ_most():
    track = example()
    track.position[120] += 40.0
    measured = drawn(track, Motion(1, 8))[1].lines[0].get_xdata()
    place = np.flatnonzero(measured == track.position[120, 0])
    assert 20 <= place[0] <= 40


def test_the_closer_look_does_not_reach_across_a_fresh_start():
    seconds = np.array([*range(100), *range(500, 600)], dtype=float)
    track = recorded(seconds, noisy(np.random.default_rng(3), seconds, 1.0))
    track.position[[98, 103]] += 40.0
    measured = drawn(track, Motion(1, 8))[1].lines[0].get_xdata()
    rows = np.flatnonzero(np.isin(track.position[:, 0], measured))
    assert len(rows) == 60
    assert rows.max() < 100 or rows.min() >= 100


def test_a_page_escapes_what_it_says(tmp_path):
    track = example(60)
    axis = timing(track)
    lines = [("left out", "line 3 (<b>)")]
    write_picture(tmp_path / "a.html", track, axis, run(track, axis, Motion(1, 6)), "<a & b>.csv", lines)
    page = (tmp_path / "a.html").read_text()
    assert "&lt;a &amp; b&gt;.csv" in page
    assert "line 3 (&lt;b&gt;)" in page


def marked(panel):
    return [line for line in panel.lines if line.get_marker() in ("^", "v")]


@pytest.mark.parametrize("rows", [3000, 50_000])
def test_values_that_a_panel_is_too_small_for_are_marked_at_its_edge_and_counted(rows):
    track = example(rows)
    track.position[[1501, 2201]] += [[500.0, 0.0], [-500.0, 0.0]]
    panels = drawn(track, Motion(1, 8, q=0.01, r=9.0))
    for panel in panels[2:]:
        low, high = panel.get_ylim()
        drawn_at = np.concatenate([line.get_ydata() for line in marked(panel)])
        assert all(min(abs(each - low), abs(each - high)) < 0.05 * high for each in drawn_at)
        said = [text.get_text() for text in panel.get_legend().get_texts()]
        assert sum("outside" in each for each in said) == 1
    times = np.concatenate([line.get_xdata() for line in marked(panels[2])])
    scale = (rows - 1) / drawn_time(panels[2])
    assert {1501, 2201} <= set(np.rint(times * scale).astype(int).tolist())


def drawn_time(panel):
    """The last time that is drawn, in the unit of the panel."""
    return max(np.nanmax(line.get_xdata()) for line in panel.lines)


def test_a_panel_that_shows_everything_marks_nothing():
    seconds = np.arange(200.0)
    track = recorded(seconds, noisy(np.random.default_rng(1), seconds, 0.0))
    assert marked(drawn(track, Motion(1, 8, r=9.0))[2]) == []
