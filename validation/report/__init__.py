"""The report: one self-contained page, and Markdown with pictures beside it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from validation.figures import png, style, svg
from validation.report.markdown import report_text
from validation.report.page import report_page
from validation.results import Drift, Summary, write
from validation.runner import Result
from validation.study import Workers

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["write_report"]


def write_report(
    results: Sequence[Result],
    summary: Summary,
    moved: Sequence[Drift],
    folder: Path,
    workers: Workers | None = None,
) -> list[Path]:
    """Write report.html, report.md with its pictures, and results.json; returns the pages."""
    folder.mkdir(parents=True, exist_ok=True)
    figures = {r.item.id: r.outcome.figure for r in results if r.outcome.figure is not None}
    share = map if workers is None else workers.map
    drawn = dict(zip(figures, share(_drawn, list(figures.values())), strict=True))
    for name, (_, picture) in drawn.items():
        (folder / f"{name}.png").write_bytes(picture)
    page, text = folder / "report.html", folder / "report.md"
    vectors = {name: vector for name, (vector, _) in drawn.items()}
    page.write_text(report_page(results, summary, moved, vectors), encoding="utf-8")
    pictures = {name: f"{name}.png" for name in drawn}
    text.write_text(report_text(results, summary, moved, pictures), encoding="utf-8")
    write(summary, folder / "results.json")
    return [page, text]


def _drawn(figure: Callable[[], Figure]) -> tuple[str, bytes]:
    """A picture as SVG for the page and as PNG for a file."""
    with style():
        picture = figure()
        return svg(picture), png(picture)
