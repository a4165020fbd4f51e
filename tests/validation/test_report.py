"""The report holds what was found and needs nothing beside it."""

from __future__ import annotations

import re
from functools import partial
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from tests.validation.items import claim, crashing, item, renamed
from validation.claims import AtMost, Claim, Tolerance, absolute, printed, relative, sampling
from validation.figures import INK, new_figure
from validation.item import Outcome
from validation.report import write_report
from validation.report.markdown import docs_page, item_text
from validation.report.words import allowed, number, ours, reported, unavailable
from validation.results import Drift, Summary
from validation.runner import Result, run_item
from validation.study import Study


def picture() -> Figure:
    figure = new_figure(4, 3)
    axes = figure.subplots()
    axes.plot(np.arange(3), color=INK)
    axes.set_xlabel("step")
    return figure


def mixed(study: Study) -> Outcome:
    explained = claim("b", 2.0, because="a <reason> & more", expected=2.0)
    return Outcome([claim("a", 1.0), explained], figure=picture, notes=["A note."])


def results() -> list[Result]:
    runs = {"s3-try": mixed, "s3-good": partial(renamed, "s3-good"), "s3-bad": crashing}
    return [run_item(item(run, name=name), Study(name)) for name, run in runs.items()]


def written(folder: Path) -> tuple[str, str]:
    found = results()
    moved = [Drift("s3-try: a", None, claim("a", 1.0))]
    page, text = write_report(found, Summary.of(found, "quick"), moved, folder)
    return page.read_text(encoding="utf-8"), text.read_text(encoding="utf-8")


class Outline(HTMLParser):
    """Which elements are opened and never closed, ids, and what is loaded from elsewhere."""

    def __init__(self) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.links: list[str] = []
        self.loaded: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        if tag == "article" or tag.startswith("h"):
            self.ids += filter(None, [values.get("id")])
        if tag == "a":
            self.links.append(values["href"] or "")
        self.loaded += filter(None, [values.get("src")])
        if tag == "link":
            self.loaded.append(values["href"] or "")


def test_the_page_needs_nothing_beside_it_and_its_links_arrive(tmp_path: Path) -> None:
    page, _ = written(tmp_path)
    outline = Outline()
    outline.feed(page)
    assert not outline.loaded
    assert "@import" not in page
    assert {link.removeprefix("#") for link in outline.links} <= set(outline.ids)
    assert {"s3-try", "s3-good", "s3-bad", "failed", "scoreboard", "reasons", "drift"} <= set(outline.ids)


def test_the_page_takes_the_readers_colours(tmp_path: Path) -> None:
    page, _ = written(tmp_path)
    assert "prefers-color-scheme: dark" in page
    svg = page[page.index("<svg") : page.index("</svg>")]
    assert "currentColor" in svg
    assert INK.lower() not in svg


def test_both_forms_hold_every_claim_its_verdict_and_its_reason(tmp_path: Path) -> None:
    page, text = written(tmp_path)
    for form in (page, text):
        for words in (
            "reproduced",
            "differs, explained",
            "not run",
            "ZeroDivisionError: by zero",
            "A note.",
        ):
            assert words in form
    assert "A &lt;reason&gt; &amp; more" in page
    assert "![A small <item> & a title](s3-try.png)" in text
    assert (tmp_path / "s3-try.png").exists()
    assert (tmp_path / "results.json").exists()


def test_tables_in_markdown_have_as_many_cells_as_columns(tmp_path: Path) -> None:
    _, text = written(tmp_path)
    for block in re.findall(r"(?:^\|.*\n)+", text, flags=re.MULTILINE):
        assert len({len(re.findall(r"(?<!\\)\|", line)) for line in block.splitlines()}) == 1


def test_the_documentation_page_links_its_items() -> None:
    found = results()
    page = docs_page([r.item for r in found], [Summary.of(found, "full")])
    for link in re.findall(r"\]\(#([^)]+)\)", page):
        assert f"({link})=" in page


def test_an_item_is_explained_with_and_without_kept_results() -> None:
    found = results()
    assert "Claims" in item_text(found[0].item, None)
    assert "Last kept, quick" in item_text(found[0].item, Summary.of(found, "quick"))


def test_numbers_in_words() -> None:
    cases = {0.047712: "0.04771", 12345.6: "1.235e4", 0.0: "0", float("inf"): "∞", 15: "15"}
    assert {value: number(value) for value in cases} == cases
    assert (number(-0.0), number(float("nan"))) == ("0", "–")
    assert reported(AtMost(1.0)) == "≤ 1"
    assert reported(AtMost(1.0, "better")) == "better"
    assert reported(None) == "–"


def test_what_cannot_be_run_here_is_said_once_for_each_reason() -> None:
    claims = [claim(name, None, because="no tracks") for name in "abc"] + [claim("d", 1.0)]
    assert unavailable(claims) == ["3 claims cannot be run here. No tracks."]


def test_tolerances_in_words() -> None:
    assert allowed(Tolerance()) == "exact"
    assert allowed(printed(4) + sampling(2)) == "5e-5 + 2 s.e."
    assert allowed(relative(0.05) + absolute(1.0)) == "1 + 5 %"
    assert allowed(relative(1e-9)) == "1e-9 relative"
    measured = Claim("s3", "s3-try", "a", 1.0, 1.25, sampling(1), 0.5, unit="m")
    assert ours(measured) == "1.25 ± 0.5 m"
