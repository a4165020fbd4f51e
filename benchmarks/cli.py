"""`python -m benchmarks`: choose rows, run them, print and write the table."""

from __future__ import annotations

from fnmatch import fnmatch
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress

from benchmarks.harness import MissingPeerError, Result, Row, measure
from benchmarks.report import Outcome, as_json, as_markdown, one_line, table
from benchmarks.rows import all_rows

__all__ = ["RESULTS", "app", "chosen"]

# What a whole run writes.
RESULTS = Path(__file__).with_name("RESULTS.md")

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


def chosen(patterns: list[str]) -> list[Row]:
    """The rows whose name matches one of the patterns (all without any).

    A pattern is a shell pattern or the beginning of a name.
    """
    rows = all_rows()
    found = [
        r for r in rows if not patterns or any(fnmatch(r.name, p) or r.name.startswith(p) for p in patterns)
    ]
    if not found:
        names = ", ".join(row.name for row in rows)
        raise typer.BadParameter(f"no row matches {', '.join(patterns)}; there are {names}")
    return found


@app.command()
def bench(
    only: Annotated[list[str] | None, typer.Option(help="Rows by name, beginning or shell pattern.")] = None,
    list_rows: Annotated[bool, typer.Option("--list", help="Print the names and stop.")] = False,
    rounds: Annotated[int, typer.Option(min=1, help="Rounds of ours, peer, peer, ours.")] = 5,
    steps: Annotated[int, typer.Option(min=200, help="Steps in one turn, all of them distinct.")] = 20_000,
    quick: Annotated[bool, typer.Option(help="3 rounds of 3000 steps, for a first look.")] = False,
    json: Annotated[Path | None, typer.Option(help="Write every round to this file.")] = None,
    markdown: Annotated[
        Path | None,
        typer.Option(help="Write the table to this file; default: RESULTS.md, of all rows and not --quick."),
    ] = None,
) -> None:
    """Time ufirext against its peers, turn by turn on one thread, and print the ratios.

    A run of all rows, not --quick, writes benchmarks/RESULTS.md.
    """
    console = Console()
    if not console.is_terminal:
        console.width = 150  # into a file or a pipe: no name is cut
    rows = chosen(only or [])
    if list_rows:
        for row in rows:
            console.print(row.name, highlight=False)
        return
    if quick:
        rounds, steps = 3, 3_000
    if markdown is None and not (only or quick):
        markdown = RESULTS
    outcomes = _run(rows, steps, rounds, console)
    settings = f"{rounds} rounds of {steps} steps, one thread, float64"
    console.print(table(outcomes, settings))
    missed = sum(isinstance(o, Result) and not o.met and not o.row.stretch for o in outcomes)
    console.print(f"{missed} target(s) not met, stretch targets not counted")
    if json is not None:
        json.write_text(as_json(outcomes, settings), encoding="utf-8")
    if markdown is not None:
        markdown.write_text(as_markdown(outcomes, settings), encoding="utf-8")


def _run(rows: list[Row], steps: int, rounds: int, console: Console) -> list[Outcome]:
    outcomes: list[Outcome] = []
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("", total=len(rows) * rounds)
        for index, row in enumerate(rows):
            progress.update(task, description=row.name, completed=index * rounds)
            try:
                outcomes.append(measure(row, steps, rounds, lambda: progress.advance(task)))
            except MissingPeerError as missing:
                outcomes.append((row, str(missing)))
            progress.console.print(one_line(outcomes[-1]), highlight=False)
    return outcomes
