"""The command line answers with a result or with one clear message, and exits accordingly."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("typer", reason="pip install ufirext[cli]")
pytest.importorskip("pymap3d", reason="pip install ufirext[cli]")

import pandas as pd
from typer.testing import CliRunner

import ufirext
from ufirext.cli import build

from .track.tracks import noisy, write_table


def invoke(*arguments):
    return CliRunner().invoke(
        build(), [str(each) for each in arguments], env={"COLUMNS": "200", "NO_COLOR": "1"}
    )


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """The current folder, to which results go when nobody says where."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def late(tmp_path):
    """The same drive over a network: some rows come one to three steps late, some never."""
    rng, seconds = np.random.default_rng(3), np.arange(200.0)
    measured = noisy(np.random.default_rng(0), seconds, 3.0)
    age = np.where(rng.random(200) < 0.3, rng.integers(1, 4, 200), 0)
    order = np.argsort(seconds + age, kind="stable")
    order = order[rng.random(200)[order] > 0.1]
    truth = noisy(rng, seconds + age, 0.0)
    columns = {
        "t": (seconds + age)[order],
        "delay_steps": age[order],
        "x": measured[order, 0],
        "y": measured[order, 1],
        "truth_x": truth[order, 0],
        "truth_y": truth[order, 1],
    }
    return write_table(tmp_path / "late.csv", columns)


@pytest.fixture
def drive(tmp_path):
    """A drive of five minutes with truth, and how far its measurements are off."""
    seconds = np.arange(300.0)
    truth = noisy(np.random.default_rng(0), seconds, 0.0)
    measured = truth + 3.0 * np.random.default_rng(1).standard_normal(truth.shape)
    columns = {
        "t": seconds,
        "x": measured[:, 0],
        "y": measured[:, 1],
        "truth_x": truth[:, 0],
        "truth_y": truth[:, 1],
    }
    return write_table(tmp_path / "drive.csv", columns)


@pytest.fixture
def ride(tmp_path):
    """A ride in degrees, dated."""
    stamps = [f"2024-05-01T10:{row // 60:02d}:{row % 60:02d}Z" for row in range(120)]
    noise = 1e-5 * np.random.default_rng(2).standard_normal((120, 2))
    columns = {"time": stamps, "lat": 51 + 3e-5 * np.arange(120) + noise[:, 0], "lon": 13.7 + noise[:, 1]}
    return write_table(tmp_path / "ride.csv", columns)


def test_help_and_version():
    assert "track" in invoke("--help").output
    assert "--horizon" in invoke("track", "--help").output
    assert invoke("--version").output.strip() == f"ufirext {ufirext.__version__}"


def test_a_track_is_filtered_to_the_current_folder_and_its_file_stays_as_it_was(drive, here):
    before = drive.read_bytes()
    result = invoke("track", drive)
    assert result.exit_code == 0, result.output
    assert drive.read_bytes() == before
    assert [each.name for each in drive.parent.iterdir() if each.is_file()] == [drive.name]
    written = pd.read_csv(here / "drive_filtered.csv")
    source = pd.read_csv(drive)
    assert written["line"].tolist() == list(range(2, 302))
    np.testing.assert_array_equal(written["t_s"], source["t"])
    truth = source[["truth_x", "truth_y"]].to_numpy()
    raw, filtered = (
        np.sqrt(np.mean(np.sum((table - truth) ** 2, axis=1)))
        for table in (source[["x", "y"]].to_numpy(), written[["x_m", "y_m"]].to_numpy())
    )
    assert f"raw {raw:.3f} m, filtered {filtered:.3f} m" in result.output
    assert filtered < 0.9 * raw
    for heading in (
        "rows read",
        "left out",
        "gaps",
        "motion model",
        "horizon",
        "sigma",
        "innovations",
        "NIS mean",
    ):
        assert heading in result.output


def test_what_was_written_can_be_read_again(drive, here):
    invoke("track", drive)
    again = invoke("track", "drive_filtered.csv")
    assert again.exit_code == 0, again.output
    assert (here / "drive_filtered_filtered.csv").exists()


def test_a_told_motion_horizon_lag_and_sigma_are_used(drive):
    result = invoke("track", drive, "--order", 2, "--horizon", 15, "--lag", 7, "--sigma", 2.5)
    assert result.exit_code == 0, result.output
    for text in (
        "constant acceleration (as told)",
        "15 (as told)",
        "7 steps, 7 s",
        "2.5 m per coordinate (as told)",
    ):
        assert text in result.output


def test_the_horizon_can_adapt(drive):
    result = invoke("track", drive, "--horizon", "adaptive")
    assert result.exit_code == 0, result.output
    assert "adaptive (chosen on the way" in result.output


def test_dates_stay_dates_and_degrees_degrees(ride, here):
    assert invoke("track", ride).exit_code == 0
    written = pd.read_csv(here / "ride_filtered.csv")
    assert written["time"][1] == "2024-05-01T10:00:01.000000Z"
    source = pd.read_csv(ride)
    assert np.abs(written["lat"] - source["lat"]).max() < 5e-5


def test_gpx_goes_out_and_comes_in(ride, here, tmp_path):
    gpxpy = pytest.importorskip("gpxpy")
    first = invoke("track", ride, "--output", tmp_path / "out.gpx")
    assert first.exit_code == 0, first.output
    points = gpxpy.parse((tmp_path / "out.gpx").read_text()).tracks[0].segments[0].points
    assert len(points) == 120
    assert points[5].time.isoformat() == "2024-05-01T10:00:05+00:00"
    names = {element.tag.rpartition("}")[2] for element in points[5].extensions}
    assert {"north_std_m", "velocity_north_mps", "velocity_north_std_mps"} <= names
    second = invoke("track", tmp_path / "out.gpx")
    assert second.exit_code == 0, second.output
    assert (here / "out_filtered.gpx").exists()


def test_pictures_are_written(drive, tmp_path):
    pytest.importorskip("matplotlib", reason="pip install ufirext[plot]")
    result = invoke("track", drive, "--plot", tmp_path / "a.png")
    assert result.exit_code == 0, result.output
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    result = invoke("track", drive, "--plot", tmp_path / "a.html")
    page = (tmp_path / "a.html").read_text()
    assert page.count("data:image/svg+xml;base64,") == 2
    assert "prefers-color-scheme: dark" in page
    assert "NIS mean" in page
    assert 'src="http' not in page
    assert "<link" not in page


def test_every_row_left_out_can_be_listed(drive, tmp_path):
    lines = drive.read_text().splitlines()
    lines[5:45:4] = ["oops"] * 10
    drive.write_text("\n".join(lines))
    result = invoke("track", drive, "--left-out", tmp_path / "left.csv")
    assert "10: wrong number of fields: line 6" in result.output
    assert "and 5 more" in result.output
    listed = pd.read_csv(tmp_path / "left.csv")
    assert listed["line"].tolist() == list(range(6, 46, 4))


@pytest.mark.parametrize("name", ["ufir", "fms", "kalman"])
def test_rows_too_late_for_the_filter_are_left_out_and_listed(late, tmp_path, name):
    source = pd.read_csv(late)
    source.loc[[100, 130], "delay_steps"] = [5000, 700]
    source.to_csv(late, index=False)
    result = invoke("track", late, "--filter", name, "--left-out", tmp_path / "left.csv")
    assert result.exit_code == 0, result.output
    listed = pd.read_csv(tmp_path / "left.csv")
    assert {102, 132} <= set(listed["line"])
    assert set(listed["fault"]) == {"too late for the filter, or from before its start"}
    assert listed.set_index("line")["found"][102] == "5000 steps old on arrival"
    assert f"{len(source)}; {len(source) - len(listed)} used" in result.output
    # the first row to arrive is late: a filter without a window cannot go back to before its start
    assert len(listed) == (3 if name == "kalman" else 2)


def test_a_delay_in_milliseconds_is_no_delay_in_seconds(late, tmp_path):
    source = pd.read_csv(late)
    source = source.assign(delay_ms=1000 * source.pop("delay_steps"))
    source.to_csv(tmp_path / "ms.csv", index=False)
    results = [invoke("track", late), invoke("track", tmp_path / "ms.csv")]
    errors = [
        next(line for line in each.output.splitlines() if line.startswith("RMSE to truth"))
        for each in results
    ]
    assert errors[0] == errors[1]
    assert "delay_ms from ms to s" in results[1].output


UNUSABLE = {
    "empty": "",
    "header only": "t,x,y\n",
    "one row": "t,x,y\n0,1,2\n",
    "text in numbers": "t,x,y\n0,a,b\n1,c,d\n",
    "all stamps equal": "t,x,y\n" + "".join(f"5,{row},0\n" for row in range(20)),
    "nan everywhere": "t,x,y\n" + "nan,nan,nan\n" * 20,
    "no time": "x,y\n1,2\n2,3\n",
    "no positions": "t,speed\n1,2\n2,3\n",
    "no header": "0,1,2\n1,2,3\n",
    "xml": "<kml></kml>",
    "half a gpx": "<gpx><trk>",
}


@pytest.mark.parametrize("name", UNUSABLE)
def test_an_unusable_file_gives_one_message_and_exit_code_1(tmp_path, name):
    path = tmp_path / "a.csv"
    path.write_text(UNUSABLE[name])
    result = invoke("track", path)
    assert result.exit_code == 1
    assert isinstance(result.exception, SystemExit)
    assert result.stdout == ""
    assert result.stderr.startswith(f"ufirext track: {path}: ")
    assert result.stderr.count("\n") == 1
    assert sorted(tmp_path.rglob("*.*")) == [path]


def test_a_binary_file_a_missing_one_and_a_directory_give_exit_code_1(tmp_path):
    (tmp_path / "a.csv").write_bytes(np.random.default_rng(0).bytes(5000))
    for path in (tmp_path / "a.csv", tmp_path / "b.csv", tmp_path):
        result = invoke("track", path, "-o", tmp_path / "out.csv")
        assert result.exit_code == 1
        assert result.stderr.startswith("ufirext track: ")


@pytest.mark.parametrize("position", ["5,5", "{0},{0}", "{1},5"])
def test_data_without_noise_give_a_result(tmp_path, position):
    rows = "".join(f"{row},{position.format(row, row * row)}\n" for row in range(40))
    (tmp_path / "a.csv").write_text("t,x,y\n" + rows)
    result = invoke("track", tmp_path / "a.csv")
    assert result.exit_code == 0, result.output
    written = pd.read_csv("a_filtered.csv")
    assert np.isfinite(written[["x_m", "y_m", "x_std_m", "y_std_m"]].to_numpy()).all()


@pytest.mark.parametrize("name", ["ufir", "fms", "kalman", "hinf"])
def test_every_filter_takes_files_with_and_without_delays(drive, late, name):
    said = {
        "ufir": "unbiased FIR",
        "fms": "minimum variance over a window",
        "kalman": "Kalman, late rows",
        "hinf": "H-infinity, a-posteriori form",
    }
    for file in (drive, late):
        result = invoke("track", file, "--filter", name)
        assert result.exit_code == 0, result.output
        table = {line[:24].strip(): line[24:].strip() for line in result.output.splitlines()}
        assert said[name] in table["filter"]
        assert "the one for which a window of" in table["density"]
        assert ("horizon" in table) == (name in ("ufir", "fms"))
        assert ("guarantee" in table) == (name == "hinf")
        assert ("delays" in table) == (file is late)
        raw, filtered = (float(table["RMSE to truth"].split()[at]) for at in (1, 4))
        assert filtered < 0.85 * raw


def test_a_lag_helps_every_filter_that_takes_one(late):
    errors = {}
    for name in ("ufir", "fms", "kalman"):
        for lag in (0, 3):
            result = invoke("track", late, "--filter", name, "--lag", lag, "--order", 1)
            assert result.exit_code == 0, result.output
            line = next(each for each in result.output.splitlines() if each.startswith("RMSE to truth"))
            errors[lag] = float(line.split(" filtered ")[1].split()[0])
        assert errors[3] < 0.8 * errors[0]


def test_a_told_density_and_theta_are_used(drive):
    result = invoke("track", drive, "--filter", "hinf", "--order", 1, "--density", 0.5, "--theta", 0.001)
    assert result.exit_code == 0, result.output
    assert "0.5 m^2/s^3 (as told)" in result.output
    assert "0.001 per m^2 (as told; smallest limit" in result.output


def test_what_a_filter_cannot_do_is_said_with_the_reason(drive):
    for options, reason in (
        (("--filter", "hinf", "--lag", 2), "the error of the present state"),
        (("--filter", "kalman", "--horizon", 8), "kalman forgets nothing"),
        (("--filter", "hinf", "--theta", 10), "theta must be below theta_max"),
        (("--filter", "kalman", "--lag", 300), "lag must be at most 200 steps for kalman"),
    ):
        result = invoke("track", drive, *options)
        assert result.exit_code == 2
        assert reason in " ".join(result.output.replace("│", " ").split())


@pytest.mark.parametrize("bad", ["-1", "inf", "nan", "soon", ""])
@pytest.mark.parametrize("name", ["ufir", "kalman"])
def test_a_row_with_an_impossible_delay_is_left_out_and_reported(late, name, bad):
    lines = late.read_text().splitlines()
    cells = lines[20].split(",")
    cells[1] = bad
    lines[20] = ",".join(cells)
    late.write_text("\n".join(lines))
    result = invoke("track", late, "--filter", name)
    assert result.exit_code == 0, result.output
    assert "line 21" in result.output


@pytest.mark.parametrize(
    "options",
    [
        ("--horizon", "long"),
        ("--horizon", "0"),
        ("--horizon", "1", "--order", "1"),
        ("--horizon", "10001"),
        ("--lag", "5000"),
        ("--horizon", "8", "--lag", "8"),
        ("--order", "3"),
        ("--lag", "-1"),
        ("--sigma", "0"),
        ("--sigma", "nan"),
        ("--delay-unit", "weeks"),
        ("--filter", "ekf"),
        ("--filter", "kalman", "--horizon", "8"),
        ("--filter", "hinf", "--horizon", "8"),
        ("--filter", "fms", "--horizon", "adaptive"),
        ("--filter", "kalman", "--horizon", "adaptive"),
        ("--filter", "hinf", "--lag", "2"),
        ("--filter", "kalman", "--lag", "300"),
        ("--filter", "fms", "--horizon", "8", "--lag", "8"),
        ("--filter", "kalman", "--theta", "0.1"),
        ("--theta", "0.1"),
        ("--filter", "hinf", "--theta", "-1"),
        ("--filter", "hinf", "--theta", "nan"),
        ("--filter", "hinf", "--theta", "10"),
        ("--density", "-1"),
        ("--density", "inf"),
        ("--density", "1e19"),
        ("--sigma", "1e-10"),
        ("--sigma", "1e10"),
        ("--output", "a.txt"),
        ("--plot", "a.pdf"),
        ("--output", "nowhere/a.csv"),
        ("--nonsense",),
    ],
)
def test_wrong_usage_gives_exit_code_2(drive, options):
    result = invoke("track", drive, *options)
    assert result.exit_code == 2, result.output
    assert "Traceback" not in result.output


def test_the_input_is_never_overwritten(drive, tmp_path):
    before = drive.read_bytes()
    (tmp_path / "link.csv").symlink_to(drive)
    for target in (drive, tmp_path / "link.csv"):
        assert invoke("track", drive, "--output", target).exit_code == 2
    assert drive.read_bytes() == before


def test_an_output_that_cannot_be_written_is_said(drive, ride, tmp_path):
    (tmp_path / "dir.csv").mkdir()
    result = invoke("track", drive, "--output", tmp_path / "dir.csv")
    assert result.exit_code == 1
    assert "cannot be written" in result.stderr
    result = invoke("track", drive, "--output", tmp_path / "a.gpx")
    assert result.exit_code == 1
    assert "GPX needs latitude and longitude" in result.stderr


def test_a_missing_extra_says_the_pip_command():
    script = "import sys; sys.modules['typer'] = None; from ufirext.cli import main; main()"
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert result.returncode == 1
    assert "pip install 'ufirext[cli]'" in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize("module", ["ufirext", "ufirext.cli"])
def test_the_package_can_be_run_as_a_module(module):
    for options, said in ((["--help"], "Usage: ufirext [OPTIONS] COMMAND"), (["--version"], "ufirext ")):
        command = [sys.executable, "-m", module, *options]
        result = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "NO_COLOR": "1"})
        assert result.returncode == 0, result.stderr
        assert said in result.stdout
        assert result.stderr == ""


def test_what_runs_as_a_module_is_light_to_import():
    script = "import sys, ufirext.__main__; print('typer' in sys.modules)"
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "False"


def test_a_horizon_that_no_row_fills_is_said(drive):
    result = invoke("track", drive, "--horizon", 5000, "--order", 1)
    assert result.exit_code == 0, result.output
    said = " ".join(result.output.split())
    assert "(298 rows; none has a whole window behind it)" in said
    assert "no row has a whole window of 5000 steps behind it" in said


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("--horizon", 0), "must be at least 1 step, got 0"),
        (("--horizon", -3, "--lag", 2), "must be at least 1 step, got -3"),
        (("--lag", 10000), "lag must be at most 4999 steps where no horizon is told, got 10000"),
        (
            ("--filter", "hinf", "--theta", 1e9),
            "lower --theta, or leave it out: 0.3 of its limit at each row",
        ),
    ],
)
def test_wrong_values_are_told_in_the_words_of_the_command_line(drive, options, reason):
    result = invoke("track", drive, *options)
    assert result.exit_code == 2
    said = " ".join(result.output.replace("│", " ").split())
    assert reason in said
    for word in ("on_violation", "theta='auto'", "20001"):
        assert word not in said


def test_a_gross_outlier_is_pointed_at(drive):
    assert "out of line" not in invoke("track", drive).output
    lines = drive.read_text().splitlines()
    cells = lines[150].split(",")
    lines[150] = ",".join([cells[0], "1e6", *cells[2:]])
    drive.write_text("\n".join(lines))
    said = " ".join(invoke("track", drive).output.split())
    assert "out of line: more than 8 robust standard deviations" in said
    assert "the farthest, line 151, by 1e+06 m" in said
    assert "docs/horizon.md" in said
