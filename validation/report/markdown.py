"""The report in Markdown, the page of the documentation, and the text of one item."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files

from validation.claims import Claim
from validation.item import Item, Table
from validation.papers import GROUPS
from validation.report.words import (
    MEANING,
    allowed,
    counted,
    number,
    ours,
    reasons,
    reported,
    shift,
    unavailable,
)
from validation.results import Drift, Summary
from validation.runner import Result

__all__ = ["docs_page", "item_text", "report_text"]

SHOWN = ("claim", "reported", "ours", "allowed", "verdict")


def report_text(
    results: Sequence[Result], summary: Summary, moved: Sequence[Drift], pictures: Mapping[str, str]
) -> str:
    """The whole report; `pictures` has file names by item."""
    items = [result.item for result in results]
    parts = [
        f"# Validation, {summary.mode}",
        provenance(summary),
        *_scoreboard(items, summary),
        *_drift(moved),
    ]
    for result in results:
        item = result.item
        parts += [f"## {item.id}", f"**{item.title}**"]
        if item.id in pictures:
            parts.append(f"![{item.title}]({pictures[item.id]})")
        parts += [*result.outcome.notes, _claims(result.outcome.claims), *_reasons(result.outcome.claims)]
        parts += [part for table in result.outcome.tables for part in (f"*{table.title}*", _table(table))]
        parts += [*_background(item), f"{result.seconds:.1f} s, seed {summary.seed} with the item's name."]
    return "\n\n".join(parts) + "\n"


def docs_page(items: Sequence[Item], summaries: Sequence[Summary]) -> str:
    """The page of the documentation from the results that are kept, the best first."""
    best = summaries[0]
    parts = [
        "# Validation",
        files("validation.report").joinpath("templates/docs_intro.md").read_text(encoding="utf-8").strip(),
        "## What came out",
        *_scoreboard(items, best, link=True),
        provenance(best),
    ]
    for item in items:
        claims = [claim for claim in best.claims if claim.item == item.id]
        parts += [f"({item.id})=\n## {item.title}", f"`{item.id}`", _claims(claims), *_reasons(claims)]
        parts += _background(item)
    return "\n\n".join(parts) + "\n"


def item_text(item: Item, last: Summary | None) -> str:
    """One item for the terminal, with the results that are kept."""
    parts = [f"# {item.id}: {item.title}", item.paper.citation, *_background(item)]
    claims = [claim for claim in last.claims if claim.item == item.id] if last else []
    if last is not None and claims:
        parts += [f"## Last kept, {last.mode}, {last.date}", _claims(claims), *_reasons(claims)]
    else:
        parts += ["## Claims", _bullets(item.claims)]
    return "\n\n".join(parts)


def provenance(summary: Summary) -> str:
    """What the numbers were computed with."""
    found = ", ".join(f"{name} {value}" for name, value in summary.versions.items())
    seconds = f"{sum(summary.seconds.values()):.0f} s"
    return f"{summary.mode.capitalize()} mode, {summary.date}, {seconds}, root seed {summary.seed}. {found}."


def _scoreboard(items: Sequence[Item], summary: Summary, link: bool = False) -> list[str]:
    total = counted(summary.claims)
    verdicts = list(total)
    parts = []
    for paper in GROUPS:
        rows = []
        for item in (item for item in items if item.paper == paper):
            counts = counted(claim for claim in summary.claims if claim.item == item.id)
            cells = [str(counts.get(verdict, "")) for verdict in verdicts]
            name = f"[{item.id}](#{item.id})" if link else item.id
            rows.append((name, item.title, *cells, f"{summary.seconds.get(item.id, 0.0):.1f}"))
        if rows:
            columns = ("item", "", *(str(verdict) for verdict in verdicts), "seconds")
            parts += [f"**{paper.citation}**", paper.finding, _grid(columns, rows)]
    words = ", ".join(f"{count} {verdict}" for verdict, count in total.items())
    legend = "; ".join(f"*{verdict}*: {MEANING[verdict]}" for verdict in verdicts)
    head = f"{len(summary.claims)} claims: {words}."
    return [head, *unavailable(summary.claims), legend + ".", *parts]


def _drift(moved: Sequence[Drift]) -> list[str]:
    rows = [(change.key, *shift(change)) for change in moved]
    return ["## Moved since the results that are kept", _grid(("claim", "then", "now"), rows)] if rows else []


def _claims(claims: Sequence[Claim]) -> str:
    rows = [
        (
            c.name,
            reported(c.reported),
            ours(c),
            allowed(c.tolerance),
            f"**{c.verdict}**" if not c.agrees else c.verdict,
        )
        for c in claims
    ]
    return _grid(SHOWN, rows)


def _reasons(claims: Iterable[Claim]) -> list[str]:
    """Why claims differ or cannot be run."""
    lines = []
    for reason in reasons(claims):
        predicts = f" *Predicts {reason.predictions}.*" if reason.predictions else ""
        lines.append(f"{reason.names}: {reason.text}{predicts}")
    return [_bullets(lines)] if lines else []


def _background(item: Item) -> list[str]:
    parts = []
    if item.parameters:
        parts.append("Parameters: " + "; ".join(f"{k} = {v}" for k, v in item.parameters.items()) + ".")
    if item.open_questions:
        parts.append("What the paper leaves open:\n\n" + _bullets(item.open_questions))
    if item.assumptions:
        parts.append("What is assumed:\n\n" + _bullets(item.assumptions))
    return parts


def _table(table: Table) -> str:
    return _grid(table.columns, [[number(cell) for cell in row] for row in table.rows])


def _grid(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def _bullets(lines: Iterable[str]) -> str:
    return "\n".join(f"- {line}" for line in lines)
