"""The measured table: on a terminal, as JSON, as Markdown with the machine it was measured on."""

from __future__ import annotations

import json
import platform
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from rich.table import Table

from benchmarks.harness import Result, Row

__all__ = ["as_json", "as_markdown", "machine", "one_line", "table"]

PACKAGES = ("ufirext", "numpy", "scipy", "filterpy", "fast-kalman", "norfair", "motpy", "ocsort")
HEADINGS = ("row", "work", "against", "target", "measured", "rounds", "")

Outcome = Result | tuple[Row, str]
"""A result, or a row that could not run and why."""


def table(outcomes: Sequence[Outcome], title: str) -> Table:
    """A rich table, one row a line."""
    view = Table(*HEADINGS, title=title, caption="measured: median over the rounds (lowest .. highest)")
    view.columns[0].no_wrap = view.columns[4].no_wrap = True
    for column in (3, 4, 5):
        view.columns[column].justify = "right"
    for outcome in outcomes:
        cells = _cells(outcome)
        style = {"met": "green", "not met": "red", "not run": "yellow"}.get(cells[-1].split(":")[0], "")
        view.add_row(*cells[:-1], f"[{style}]{cells[-1]}[/]" if style else cells[-1])
    return view


def one_line(outcome: Outcome) -> str:
    """What is said of a row as soon as it is done."""
    name, _, _, bound, measured, _, verdict = _cells(outcome)
    return f"{name:24} {measured:>9} ({bound}) {verdict}"


def as_markdown(outcomes: Sequence[Outcome], settings: str) -> str:
    """The same table for a file, under a line on the machine and the settings."""
    lines = ["# Measured ratios", "", f"{machine()}. {settings}.", "", "| " + " | ".join(HEADINGS) + " |"]
    lines.append("|" + "---|" * len(HEADINGS))
    lines += ["| " + " | ".join(_cells(outcome)) + " |" for outcome in outcomes]
    return "\n".join(lines) + "\n"


def as_json(outcomes: Sequence[Outcome], settings: str) -> str:
    """Every round of every row."""
    rows = []
    for outcome in outcomes:
        row = outcome.row if isinstance(outcome, Result) else outcome[0]
        entry: dict[str, object] = {"row": row.name, "target": row.target, "unit": row.metric.symbol.strip()}
        entry["stretch"] = row.stretch
        if isinstance(outcome, Result):
            entry |= {"median": outcome.median, "rounds": outcome.rounds, "met": outcome.met}
            entry |= {"ours_s": outcome.ours_s, "peer_s": outcome.peer_s}
        else:
            entry["not_run"] = outcome[1]
        rows.append(entry)
    return json.dumps({"machine": machine(), "settings": settings, "rows": rows}, indent=1) + "\n"


def machine() -> str:
    """Processor, Python and the versions of every package in the comparison."""
    return f"{_processor()}, Python {platform.python_version()}; " + ", ".join(
        f"{name} {found}" for name in PACKAGES if (found := _version(name))
    )


def _processor() -> str:
    information = Path("/proc/cpuinfo")
    if information.exists():
        for line in information.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def _cells(outcome: Outcome) -> tuple[str, ...]:
    row = outcome.row if isinstance(outcome, Result) else outcome[0]
    show = row.metric.show
    bound = f"{'>=' if row.metric.higher_is_better else '<='} {show(row.target)}"
    head = (row.name, row.work, row.peer, bound + (" (stretch)" if row.stretch else ""))
    if not isinstance(outcome, Result):
        return (*head, "", "", f"not run: {outcome[1]}")
    spread = f"{show(min(outcome.rounds))} .. {show(max(outcome.rounds))}"
    return (*head, show(outcome.median), spread, "met" if outcome.met else "not met")
