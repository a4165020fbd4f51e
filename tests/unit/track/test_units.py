"""What the name of a column says about its unit is heeded, converted and told."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("pymap3d", reason="pip install ufirext[cli]")

from ufirext.track.reading import read_track
from ufirext.track.series import UnusableTrack
from ufirext.track.units import split_unit

from .tracks import write_table


def delayed(path, name, ages, **more):
    columns = {"t": range(3), "x": [0, 1, 2], "y": [0, 0, 0], name: ages, **more}
    return write_table(path / "a.csv", columns)


@pytest.mark.parametrize(
    ("name", "ages"),
    [
        ("delay_s", [0, 1.5, 0.25]),
        ("delay_seconds", [0, 1.5, 0.25]),
        ("Delay (ms)", [0, 1500, 250]),
        ("delay_us", [0, 1.5e6, 2.5e5]),
        ("delay [µs]", [0, 1.5e6, 2.5e5]),
        ("age_ns", [0, 1.5e9, 2.5e8]),
        ("latency_ms", [0, 1500, 250]),
    ],
)
@pytest.mark.parametrize("told", [True, False])
def test_delays_are_in_the_unit_their_name_says(tmp_path, name, ages, told):
    track = read_track(delayed(tmp_path, name, ages), {"delay": name} if told else {})
    np.testing.assert_allclose(track.age, [0, 1.5, 0.25], rtol=1e-12)
    assert track.age_unit == "s"


@pytest.mark.parametrize(("unit", "seconds"), [("s", 250), ("ms", 0.25), ("us", 2.5e-4), ("min", 15000)])
def test_a_told_unit_of_delays_wins_over_their_name(tmp_path, unit, seconds):
    track = read_track(delayed(tmp_path, "delay_ms", [0, 0, 250]), delay_unit=unit)
    np.testing.assert_allclose(track.age, [0, 0, seconds])
    assert any("told" in note for note in track.notes) == (unit != "s")


@pytest.mark.parametrize("name", ["delay_weeks", "latency_class", "age_group", "Delayed"])
def test_a_column_that_looks_like_a_delay_and_is_not_used_is_noted(tmp_path, name):
    track = read_track(delayed(tmp_path, name, [0, 1, 2]))
    assert track.age is None
    assert len(track.notes) == 1
    assert f"{name!r} looks like a delay and was not used" in track.notes[0]
    assert "--delay" in track.notes[0]


def test_an_agent_is_no_age(tmp_path):
    assert read_track(delayed(tmp_path, "agent", [0, 1, 2])).notes == []


@pytest.mark.parametrize(
    ("unit", "metres"),
    [("km", 1000.0), ("ft", 0.3048), ("miles", 1609.344), ("cm", 0.01), ("mm", 0.001), ("m", 1.0)],
)
@pytest.mark.parametrize("told", [True, False])
def test_lengths_are_converted_by_the_unit_in_their_name_and_that_is_told(tmp_path, unit, metres, told):
    x, y = f"east_{unit}", f"north_{unit}"
    path = write_table(tmp_path / "a.csv", {"t": range(3), x: [0, 1, 2], y: [5, 6, 7]})
    track = read_track(path, {"x": x, "y": y} if told else {})
    np.testing.assert_allclose(track.position, np.column_stack([range(3), range(5, 8)]) * metres)
    said = [] if unit == "m" else [f"converted, as the names say: {x} and {y} from {unit} to m"]
    assert track.notes == said


def test_angles_and_times_are_converted_too(tmp_path):
    lat, lon = np.radians([51.0, 51.0001, 51.0002]), np.radians([13.0, 13.0001, 13.0002])
    path = write_table(tmp_path / "a.csv", {"t_min": [0, 1, 2], "lat_rad": lat, "lon_rad": lon})
    for told in ({"time": "t_min", "lat": "lat_rad", "lon": "lon_rad"}, {}):
        track = read_track(path, told)
        np.testing.assert_allclose(track.seconds, [0, 60, 120])
        np.testing.assert_allclose(track.latlon(track.position)[:, 0], [51, 51.0001, 51.0002], atol=1e-9)
        assert track.notes == [
            "converted, as the names say: t_min from min to s; lat_rad and lon_rad from rad to degrees"
        ]


def test_columns_in_the_usual_units_come_first(tmp_path):
    columns = {"t_ms": [0, 1000], "t_s": [5, 6], "x_km": [1, 2], "y_km": [1, 2], "x": [3, 4], "y": [3, 4]}
    track = read_track(write_table(tmp_path / "a.csv", columns))
    assert track.seconds.tolist() == [5, 6]
    assert track.position[:, 0].tolist() == [3, 4]


@pytest.mark.parametrize(
    ("told", "message"),
    [
        ({"x": "lon_deg", "y": "north"}, r"--x 'lon_deg': its name ends in deg; --x takes m"),
        ({"lat": "lat_m", "lon": "north"}, r"--lat 'lat_m': its name ends in m; --lat takes degrees"),
        ({"time": "way_km"}, r"--time 'way_km': its name ends in km; --time takes s"),
    ],
)
def test_a_named_column_of_another_quantity_is_refused(tmp_path, told, message):
    names = ("t", "x", "y", "lon_deg", "lat_m", "north", "way_km")
    path = write_table(tmp_path / "a.csv", {name: [1, 2, 3] for name in names})
    with pytest.raises(UnusableTrack, match=message):
        read_track(path, told)


def test_a_smallest_x_is_no_time(tmp_path):
    path = write_table(tmp_path / "a.csv", {"t": [0, 1], "x_min": [0, 1], "y_min": [0, 1]})
    assert read_track(path, {"x": "x_min", "y": "y_min"}).notes == []


def test_only_the_last_word_is_a_unit():
    assert split_unit("km_east", "x") == ("km_east", None)
    assert split_unit("delay_steps", "delay")[1] == ("steps", 1.0)
