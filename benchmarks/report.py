"""The measured table: on a terminal, as JSON, as Markdown with the machine it was measured on."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
from rich.table import Table

from benchmarks.harness import Result, Row

__all__ = ["as_json", "as_markdown", "machine", "one_line", "table"]

PACKAGES = (
    "ufirext",
    "numpy",
    "scipy",
    "numba",
    "filterpy",
    "fast-kalman",
    "simdkalman",
    "statsmodels",
    "norfair",
    "motpy",
    "ocsort",
    "dask",
    "torch",
)
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
    """The same for a file: the machine and the settings, then a table for each group of rows."""
    lines = ["# Measured ratios", "", "Written by `python -m benchmarks`, which `make bench` runs."]
    lines += ["Measured is the median over the rounds, then the lowest and the highest.", ""]
    lines += [f"- {fact}" for fact in (*_facts(), settings)]
    lines += [f"- {_tally(outcomes)}"]
    for group in dict.fromkeys(_row(outcome).name.partition("/")[0] for outcome in outcomes):
        lines += ["", f"## {group}", "", "| " + " | ".join(HEADINGS) + " |", "|" + "---|" * len(HEADINGS)]
        own = [outcome for outcome in outcomes if _row(outcome).name.partition("/")[0] == group]
        lines += ["| " + " | ".join(_cells(outcome)) + " |" for outcome in own]
    return "\n".join(lines) + "\n"


def _tally(outcomes: Sequence[Outcome]) -> str:
    """How many rows reach their targets."""
    results = [outcome for outcome in outcomes if isinstance(outcome, Result)]
    firm = [result for result in results if not result.row.stretch]
    hoped = [result for result in results if result.row.stretch]
    text = f"{sum(r.met for r in firm)} of {len(firm)} targets met"
    text += f", {sum(r.met for r in hoped)} of {len(hoped)} stretch targets" if hoped else ""
    absent = len(outcomes) - len(results)
    return text + (f"; {absent} rows could not run" if absent else "")


def as_json(outcomes: Sequence[Outcome], settings: str) -> str:
    """Every round of every row."""
    rows = []
    for outcome in outcomes:
        row = _row(outcome)
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
    """Processor, memory, system, Python, BLAS and the versions of every package in the comparison."""
    return "; ".join(_facts())


def _facts() -> tuple[str, ...]:
    cores = f"{os.cpu_count()} core{'s' if os.cpu_count() != 1 else ''}"
    hardware = ", ".join(filter(None, (_processor(), cores, _memory())))
    packages = ", ".join(f"{name} {found}" for name in PACKAGES if (found := _version(name)))
    return hardware, f"{platform.platform()}, Python {platform.python_version()}, {_blas()}", packages


def _memory() -> str:
    try:
        pages = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return ""
    return f"{pages / 2**30:.0f} GiB of memory"


def _blas() -> str:
    """What NumPy multiplies matrices with."""
    built: dict[str, dict[str, dict[str, str]]] = np.show_config(mode="dicts")  # type: ignore[assignment]
    found = built.get("Build Dependencies", {}).get("blas", {})
    return f"{found.get('name', 'unknown BLAS')} {found.get('version', '')}".strip()


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


def _row(outcome: Outcome) -> Row:
    return outcome.row if isinstance(outcome, Result) else outcome[0]


def _cells(outcome: Outcome) -> tuple[str, ...]:
    row = _row(outcome)
    show = row.metric.show
    bound = f"{'>=' if row.metric.higher_is_better else '<='} {show(row.target)}"
    head = (row.name, row.work, row.peer, bound + (" (stretch)" if row.stretch else ""))
    if not isinstance(outcome, Result):
        return (*head, "", "", f"not run: {outcome[1]}")
    spread = f"{show(min(outcome.rounds))} .. {show(max(outcome.rounds))}"
    return (*head, show(outcome.median), spread, "met" if outcome.met else "not met")
