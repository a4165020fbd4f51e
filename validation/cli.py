"""`python -m validation`: run items, write the report, say by the exit status whether the claims hold."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markdown import Markdown
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from validation.claims import Verdict
from validation.item import Item
from validation.registry import all_items
from validation.report import write_report
from validation.report.markdown import docs_page, item_text
from validation.report.terminal import MARKS, scoreboard
from validation.results import KEPT, Summary, drift, kept, write
from validation.runner import Result, chosen, pool, run_all
from validation.study import Mode, Workers

__all__ = ["app", "main"]

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, invoke_without_command=True)

DOCS = Path(__file__).parents[1] / "docs" / "validation.md"


@app.callback()
def validate(
    context: typer.Context,
    quick: Annotated[bool, typer.Option("--quick", help="Few runs: about two minutes on two cores.")] = False,
    full: Annotated[bool, typer.Option("--full", help="Many runs, small standard errors.")] = False,
    only: Annotated[list[str] | None, typer.Option(help="Items by id, beginning or shell pattern.")] = None,
    list_items: Annotated[bool, typer.Option("--list", help="Print the items and stop.")] = False,
    out: Annotated[Path, typer.Option(help="Folder for the report.")] = Path("out/validation"),
    jobs: Annotated[
        int | None,
        typer.Option(min=1, help="Processes, default one a core; numbers do not depend on it."),
    ] = None,
    keep: Annotated[
        bool, typer.Option(help="Keep the results: drift is shown against what is kept.")
    ] = False,
) -> None:
    """Reproduce every table and figure of the four papers, claim by claim.

    Without --quick or --full the quick form. The exit status is 1 if a claim differs without an explanation
    or was not run.
    """
    if context.invoked_subcommand is not None:
        return
    console = _console()
    items = _items(only or [])
    if list_items:
        for item in items:
            console.print(f"{item.id:24} {item.title}  ({len(item.claims)} claims)", highlight=False)
        return
    if quick and full:
        raise typer.BadParameter("--quick and --full exclude each other")
    mode: Mode = "full" if full else "quick"
    before = kept(mode)
    with pool(jobs or os.cpu_count() or 1) as workers:
        results = _run(items, mode, workers, console)
        summary = Summary.of(results, mode)
        moved = drift(before, summary, [item.id for item in items]) if before else []
        with console.status("the report"):
            pages = write_report(results, summary, moved, out, workers)
    console.print(scoreboard(results, moved, since=before.date if before else ""))
    for page in pages:
        console.print(f"Report: {page}", soft_wrap=True, highlight=False)
    if keep:
        _keep(summary, before)
    raise typer.Exit(int(any(result.fails for result in results)))


@app.command()
def explain(item: Annotated[str, typer.Argument(help="Id of an item, as --list prints it.")]) -> None:
    """Say what an item does, what its paper leaves open, what is assumed, and what came out last."""
    for found in _items([item]):
        last = kept("full") or kept("quick")
        _console().print(Markdown(item_text(found, last)))


@app.command()
def docs(page: Annotated[Path, typer.Option(help="The page to write.")] = DOCS) -> None:
    """Write the page of the documentation from the results that are kept."""
    found = [summary for summary in (kept("full"), kept("quick")) if summary is not None]
    if not found:
        raise typer.BadParameter("no results are kept; run with --keep first")
    page.write_text(docs_page(all_items(), found), encoding="utf-8")
    _console().print(f"Wrote {page}", highlight=False)


def _keep(summary: Summary, before: Summary | None) -> None:
    """Write what later runs are held against: claims that were run, and none that fails.

    Items that did not run now keep the results they have, if those are of the same versions.
    """
    lacking = [c.key for c in summary.claims if c.verdict.fails or c.verdict is Verdict.CANNOT_RUN]
    if lacking:
        raise typer.BadParameter(f"not kept, for these fail or cannot be run: {', '.join(lacking)}")
    items = [item.id for item in all_items()]
    others = [name for name in items if name not in summary.seconds]
    if others and before is not None and before.versions != summary.versions:
        raise typer.BadParameter(
            "not kept: what is kept has other versions, so keep all items; leave --only out"
        )
    write(summary if before is None else before.updated(summary, items), KEPT / f"{summary.mode}.json")


def main() -> None:
    """Entry of ``python -m validation``."""
    app(prog_name="python -m validation")


def _console() -> Console:
    console = Console()
    if not console.is_terminal:
        console.width = 120  # into a file or a pipe: no name is cut
    return console


def _items(patterns: list[str]) -> list[Item]:
    try:
        return chosen(all_items(), patterns)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error


def _run(items: list[Item], mode: Mode, workers: Workers | None, console: Console) -> list[Result]:
    results: list[Result] = []
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("", total=len(items))

        def watch(item: Item, share: float) -> None:
            progress.update(task, description=item.id, completed=len(results) + share)

        for result in run_all(items, mode, workers, watch):
            results.append(result)
            counts = ", ".join(f"{MARKS[v]}{result.count(v)} {v}[/]" for v in Verdict if result.count(v))
            progress.update(task, completed=len(results))
            progress.console.print(f"{result.item.id:24} {result.seconds:6.1f} s  {counts}", highlight=False)
    return results
