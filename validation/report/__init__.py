"""The report: one self-contained page, and Markdown with pictures beside it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from validation import figures
from validation.report.markdown import report_text
from validation.report.page import report_page
from validation.results import Drift, Summary, write
from validation.runner import Result

__all__ = ["write_report"]


def write_report(
    results: Sequence[Result], summary: Summary, moved: Sequence[Drift], folder: Path
) -> list[Path]:
    """Write report.html, report.md with its pictures, and results.json; returns the pages."""
    folder.mkdir(parents=True, exist_ok=True)
    vectors: dict[str, str] = {}
    pictures: dict[str, str] = {}
    for result in results:
        if result.outcome.figure is None:
            continue
        with figures.style():
            figure = result.outcome.figure()
            vectors[result.item.id] = figures.svg(figure)
            pictures[result.item.id] = f"{result.item.id}.png"
            (folder / pictures[result.item.id]).write_bytes(figures.png(figure))
    page, text = folder / "report.html", folder / "report.md"
    page.write_text(report_page(results, summary, moved, vectors), encoding="utf-8")
    text.write_text(report_text(results, summary, moved, pictures), encoding="utf-8")
    write(summary, folder / "results.json")
    return [page, text]
