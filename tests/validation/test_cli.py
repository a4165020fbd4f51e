"""`python -m validation` from end to end on small items and on one real one."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.validation.items import claim, good, item, renamed
from validation import cli
from validation.claims import Verdict
from validation.item import Item, Outcome
from validation.registry import all_items
from validation.results import read

RUN = CliRunner()


@pytest.fixture
def only(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[Item]:
    """A registry of one's own, and results that are kept in a folder of one's own."""
    items: list[Item] = []
    monkeypatch.setattr(cli, "all_items", lambda: tuple(items))
    monkeypatch.setattr(cli, "KEPT", tmp_path / "kept")
    monkeypatch.setattr("validation.results.KEPT", tmp_path / "kept")
    return items


def test_all_well_is_zero(only: list[Item], tmp_path: Path) -> None:
    only.append(item(good))
    found = RUN.invoke(cli.app, ["--out", str(tmp_path), "--jobs", "1"])
    assert found.exit_code == 0
    assert "2 reproduced" in found.output


def test_an_unexplained_difference_is_one_and_is_named(only: list[Item], tmp_path: Path) -> None:
    only.append(item(lambda study: Outcome([claim("a", 1.5), claim("b", 1.0)])))
    found = RUN.invoke(cli.app, ["--out", str(tmp_path), "--jobs", "1"])
    assert found.exit_code == 1
    assert "differs s3-try: a: reported 1, ours 1.5" in found.output


def test_a_claim_that_nobody_ran_is_one(only: list[Item], tmp_path: Path) -> None:
    only.append(item(lambda study: Outcome([claim("a", 1.0)])))
    found = RUN.invoke(cli.app, ["--out", str(tmp_path), "--jobs", "1"])
    assert found.exit_code == 1
    assert "not run s3-try: b" in found.output


def test_drift_is_shown_against_what_is_kept(only: list[Item], tmp_path: Path) -> None:
    only.append(item(good))
    arguments = ["--out", str(tmp_path), "--jobs", "1"]
    assert RUN.invoke(cli.app, [*arguments, "--keep"]).exit_code == 0
    assert "No claim moved since" in RUN.invoke(cli.app, arguments).output
    only[0] = item(lambda study: Outcome([claim("a", 1.0), claim("b", 2.0)]))
    assert "s3-try: b: 1 (reproduced) -> 2 (differs)" in RUN.invoke(cli.app, arguments).output


def test_what_fails_is_not_kept(only: list[Item], tmp_path: Path) -> None:
    only.append(item(lambda study: Outcome([claim("a", 1.0), claim("b", None, because="no tracks")])))
    found = RUN.invoke(cli.app, ["--out", str(tmp_path), "--jobs", "1", "--keep"], env={"COLUMNS": "200"})
    assert found.exit_code == 2
    assert "not kept" in found.output
    assert not (tmp_path / "kept").exists()


def test_some_items_are_kept_beside_the_others(only: list[Item], tmp_path: Path) -> None:
    only += [item(good), item(partial(renamed, "s3-other"), name="s3-other")]
    arguments = ["--out", str(tmp_path), "--jobs", "1", "--keep"]
    assert RUN.invoke(cli.app, arguments).exit_code == 0
    only[0] = item(lambda study: Outcome([claim("a", 1.0)]), claims=["a"])
    assert RUN.invoke(cli.app, [*arguments, "--only", "s3-try"]).exit_code == 0
    found = read(tmp_path / "kept" / "quick.json")
    assert [c.key for c in found.claims] == ["s3-try: a", "s3-other: a", "s3-other: b"]
    assert list(found.seconds) == ["s3-try", "s3-other"]


def test_results_of_other_versions_are_not_mixed(
    only: list[Item], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    only += [item(good), item(partial(renamed, "s3-other"), name="s3-other")]
    arguments = ["--out", str(tmp_path), "--jobs", "1", "--keep"]
    RUN.invoke(cli.app, arguments)
    monkeypatch.setattr("validation.results.versions", lambda: {"python": "0"})
    found = RUN.invoke(cli.app, [*arguments, "--only", "s3-try"], env={"COLUMNS": "200"})
    assert found.exit_code == 2
    assert "other versions" in found.output


def test_the_documentation_is_written_from_what_is_kept(only: list[Item], tmp_path: Path) -> None:
    only.append(item(good))
    page = tmp_path / "validation.md"
    assert RUN.invoke(cli.app, ["docs", "--page", str(page)]).exit_code == 2
    RUN.invoke(cli.app, ["--out", str(tmp_path), "--jobs", "1", "--keep"])
    assert RUN.invoke(cli.app, ["docs", "--page", str(page)]).exit_code == 0
    assert "(s3-try)=" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--only", "nothing"], "no item matches nothing"),
        (["--quick", "--full"], "exclude each other"),
        (["--jobs", "0"], "jobs"),
        (["explain", "nothing"], "no item matches nothing"),
    ],
)
def test_bad_options_say_what_is_wrong(only: list[Item], arguments: list[str], message: str) -> None:
    only.append(item(good))
    found = RUN.invoke(cli.app, arguments, env={"COLUMNS": "200"})
    assert found.exit_code == 2
    assert message in found.output


def test_items_are_listed_and_explained() -> None:
    listed = RUN.invoke(cli.app, ["--list"]).output
    assert all(found.id in listed for found in all_items())
    explained = RUN.invoke(cli.app, ["explain", "s3-table-2"]).output
    assert "not documented by the author" in " ".join(explained.split())


def test_two_processes_find_what_one_finds(tmp_path: Path) -> None:
    for jobs in ("1", "2"):
        RUN.invoke(cli.app, ["--only", "s3-fig-3", "--out", str(tmp_path / jobs), "--jobs", jobs])
    one, two = (read(tmp_path / jobs / "results.json").claims for jobs in ("1", "2"))
    assert one == two
    assert len(one) > 3


def test_a_figure_of_a_paper_from_end_to_end(tmp_path: Path) -> None:
    found = RUN.invoke(cli.app, ["--only", "s3-fig-1", "--out", str(tmp_path), "--jobs", "1"])
    assert found.exit_code == 0, found.output
    assert (tmp_path / "s3-fig-1.png").stat().st_size > 50_000
    claims = {claim.name: claim for claim in read(tmp_path / "results.json").claims}
    assert claims["steps until the FMS filter has forgotten a jump"].ours == 15
    assert all(claim.verdict in (Verdict.REPRODUCED, Verdict.SAMPLING) for claim in claims.values())
    assert json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))["versions"]["numpy"]
