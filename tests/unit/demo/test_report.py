"""The report says what was measured, in three forms that agree, and the command reaches it."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("typer", reason="pip install ufirext[cli]")
pytest.importorskip("matplotlib", reason="pip install ufirext[plot]")

import typer
from typer.testing import CliRunner

from ufirext.demo.cli import demo
from ufirext.demo.compare import Score, compare
from ufirext.demo.report import cell

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
    assert "no such file" in result.output


def test_cells_show_the_mean_and_its_error_where_there_is_one() -> None:
    assert cell(Score(3.14159, 0.0271)) == "3.14 ± 0.03"
    assert cell(Score(3.14159, float("nan"))) == "3.14"
    assert cell(None) == ""
