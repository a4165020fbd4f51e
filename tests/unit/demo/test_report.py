"""The report says what was measured, in three forms that agree, and the command reaches it."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("typer", reason="pip install ufirext[cli]")
pytest.importorskip("matplotlib", reason="pip install ufirext[plot]")

import typer
from rich.console import Console
from typer.testing import CliRunner

from ufirext.demo.cli import _table, demo
from ufirext.demo.compare import SCENARIOS, Score, compare
from ufirext.demo.report import cell, score_limits

from .test_compare import short_trial, write

app = typer.Typer()
app.command()(demo)


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    """One run of the command on a small file: what it printed, and its folder."""
    folder = tmp_path_factory.mktemp("demo")
    track = write(folder / "track.csv", np.arange(160.0))
    arguments = [
        str(track),
        "--runs",
        "2",
        "--out",
        str(folder / "out"),
        "--picture",
        str(folder / "copy.png"),
    ]
    result = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output, folder


def test_the_command_prints_table_and_where_the_report_is(ran: tuple[str, Path]) -> None:
    output, folder = ran
    assert "Kalman, right" in output
    assert "UFIR adaptive" in output
    assert str(folder / "out" / "report.html") in output


def test_page_and_csv_give_the_same_scores(ran: tuple[str, Path]) -> None:
    _, folder = ran
    page = (folder / "out" / "report.html").read_text(encoding="utf-8")
    with (folder / "out" / "table.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 46  # fifteen filters in three scenarios, one in one
    for row in rows:
        assert f"{float(row['rmse_m']):.2f} ± {float(row['standard_error_m']):.2f}" in page
        assert row["runs"] == "2"


def test_the_markdown_table_is_the_csv_table(ran: tuple[str, Path]) -> None:
    lines = (ran[1] / "out" / "table.md").read_text(encoding="utf-8").splitlines()
    cells = [[part.strip() for part in line.strip("|").split("|")] for line in lines]
    shown = {
        (row[0], packets): row[i] for row in cells[2:] for i, packets in enumerate(cells[0]) if i and row[i]
    }
    with (ran[1] / "out" / "table.csv").open(encoding="utf-8") as file:
        assert shown == {
            (row["filter"], row["packets"]): cell(Score(float(row["rmse_m"]), float(row["standard_error_m"])))
            for row in csv.DictReader(file)
        }


def test_the_page_needs_no_other_file(ran: tuple[str, Path]) -> None:
    page = (ran[1] / "out" / "report.html").read_text(encoding="utf-8")
    assert re.findall(r"(?:src|href)=\"(?!data:)", page) == []
    assert "data:image/png;base64," in page


def test_pictures_are_png_and_the_copy_is_the_same(ran: tuple[str, Path]) -> None:
    original, copy = ran[1] / "out" / "picture.png", ran[1] / "copy.png"
    assert original.read_bytes().startswith(b"\x89PNG")
    assert copy.read_bytes() == original.read_bytes()


def test_a_seed_fixes_every_number() -> None:
    first, second = (compare(short_trial, np.random.default_rng(1), 1) for _ in range(2))
    assert {n: {s: v.rmse for s, v in r.items()} for n, r in first.items()} == {
        n: {s: v.rmse for s, v in r.items()} for n, r in second.items()
    }


def test_a_file_that_is_no_track_is_a_clear_error(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, [str(tmp_path / "absent.csv")])
    assert result.exit_code == 1
    assert result.output.startswith("ufirext demo: ")
    assert "no such file" in result.output


@pytest.mark.parametrize(
    ("option", "target", "words"),
    [
        ("--picture", "nodir/x.png", "there is no folder"),
        ("--picture", "x.pdf", "must be a file that ends in .png"),
        ("--picture", "x.foo", "must be a file that ends in .png"),
        ("--picture", "folder.png", "must be a file that ends in .png"),
        ("--picture", "input.png", "is the input"),
        ("--out", "file", "is a file, not a folder"),
        ("--out", "file/below", "is a file, not a folder"),
        ("--out", ".", "written over the input"),
    ],
)
def test_results_that_cannot_be_written_are_refused_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, option: str, target: str, words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("ufirext.demo.cli.compare", lambda *_: pytest.fail("the filters ran"))
    Path("folder.png").mkdir()
    Path("file").touch()
    track = write(Path("table.csv"), np.arange(160.0))
    if target == "input.png":
        track = track.rename(target)
    result = CliRunner().invoke(app, [str(track), option, target], catch_exceptions=False)
    assert result.exit_code == 2
    assert words in " ".join(re.sub(r"[│╭╮╰╯─]", " ", result.output).split())


def test_a_folder_that_cannot_be_written_to_is_a_clear_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ufirext.demo.cli.compare", lambda *_: SCORES)
    monkeypatch.setattr("ufirext.demo.cli.reading", lambda _: [])
    track = write(tmp_path / "track.csv", np.arange(160.0))
    (tmp_path / "out" / "picture.png").mkdir(parents=True)
    result = CliRunner().invoke(app, [str(track), "--runs", "1", "--out", str(tmp_path / "out")])
    assert result.exit_code == 1
    assert "ufirext demo: " in result.output
    assert "cannot be written" in result.output


SCORES = {
    "Delay Kalman, Q / 100 (or R x 100)": {s: Score(123.45, 10.06) for s in SCENARIOS},
    "Kalman, right Q, R": {s: Score(100.0, 0.5) for s in SCENARIOS},
}


def test_the_printed_table_shows_scores_and_errors_whole() -> None:
    console = Console(width=80, file=io.StringIO())
    console.print(_table("A track", SCORES, 3))
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert text.count("123.45 ± 10.06") == text.count("100.00 ± 0.50") == len(SCENARIOS)
    assert "…" not in text


def test_scores_that_lie_close_together_get_an_axis_of_their_own() -> None:
    low, high = score_limits(SCORES)
    assert 90.0 < low < 99.5
    assert 133.51 < high < 140.0
    spread = {**SCORES, "best": {s: Score(3.0, float("nan")) for s in SCENARIOS}}
    assert score_limits(spread)[0] == 0.0
    assert score_limits({"one": {"all": Score(2.0, float("nan"))}}) == pytest.approx((1.9, 2.1))


def test_cells_show_the_mean_and_its_error_where_there_is_one() -> None:
    assert cell(Score(3.14159, 0.0271)) == "3.14 ± 0.03"
    assert cell(Score(3.14159, float("nan"))) == "3.14"
    assert cell(None) == ""
