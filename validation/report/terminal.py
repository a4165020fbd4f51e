"""The scoreboard on the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Group
from rich.table import Table as RichTable
from rich.text import Text

from validation.claims import Verdict
from validation.papers import GROUPS
from validation.report.words import counted, number, ours, reported, shift
from validation.results import Drift
from validation.runner import Result

__all__ = ["MARKS", "scoreboard"]

MARKS = {
    Verdict.REPRODUCED: "[green]",
    Verdict.SAMPLING: "[green]",
    Verdict.EXPLAINED: "[yellow]",
    Verdict.DIFFERS: "[bold red]",
    Verdict.CANNOT_RUN: "[blue]",
    Verdict.NOT_RUN: "[bold red]",
}


def scoreboard(results: Sequence[Result], moved: Sequence[Drift], since: str) -> Group:
    """Verdicts by source, what fails, and what moved since the results that are kept."""
    parts: list[RichTable | Text] = [_totals(results)]
    failed = [c for r in results for c in r.outcome.claims if c.verdict.fails]
    for claim in failed:
        words = f"{claim.key}: reported {reported(claim.reported)}, ours {ours(claim)}. {claim.because}"
        parts.append(Text.from_markup(f"{MARKS[claim.verdict]}{claim.verdict}[/] ").append(words))
    for change in moved:
        before, after = shift(change)
        parts.append(Text(f"drift since {since}  {change.key}: {before} -> {after}"))
    if since and not moved:
        parts.append(Text(f"No claim moved since {since}."))
    return Group(*parts)


def _totals(results: Sequence[Result]) -> RichTable:
    table = RichTable("source", *(str(verdict) for verdict in Verdict), "seconds", box=None)
    for column in table.columns[1:]:
        column.justify = "right"
    for paper in GROUPS:
        here = [r for r in results if r.item.paper == paper]
        if here:
            table.add_row(paper.key, *_cells(here))
    table.add_section()
    table.add_row("all", *_cells(results))
    return table


def _cells(results: Sequence[Result]) -> list[str]:
    counts = counted(claim for result in results for claim in result.outcome.claims)
    cells = [f"{MARKS[v]}{counts[v]}[/]" if v in counts else "·" for v in Verdict]
    return [*cells, number(sum(r.seconds for r in results), 3)]
