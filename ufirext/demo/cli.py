"""`ufirext demo [FILE]`: run the comparison, print the table, write the report."""

from __future__ import annotations

from pathlib import Path
from shutil import copyfile
from typing import Annotated, NoReturn

import numpy as np
import typer
from rich import box
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from ..errors import UfirextError
from .compare import CONTENDERS, SCENARIOS, compare
from .reading import reading
from .report import REPORT, Scores, cell, exhibit, picture, write_report
from .scene import Scene, city, recorded

__all__ = ["demo"]


def demo(
    file: Annotated[
        Path | None, typer.Argument(help="A recorded track, CSV or GPX, in place of the simulated drive.")
    ] = None,
    runs: Annotated[
        int | None, typer.Option(min=1, help="Monte-Carlo runs: 20, on long or irregular tracks fewer.")
    ] = None,
    noise: Annotated[float, typer.Option(min=0.01, help="Standard deviation of the added noise, m.")] = 3.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of every random number.")] = 1,
    out: Annotated[Path, typer.Option(help="Folder of the report.")] = Path("ufirext-demo"),
    image: Annotated[Path | None, typer.Option("--picture", help="Write the picture here as well.")] = None,
) -> None:
    """Lose and delay packets of a drive with known truth; compare filterpy's KalmanFilter and ours."""
    _check_targets(file, out, image)
    console = Console()
    rng = np.random.default_rng(seed)
    try:
        scene = city(rng, noise) if file is None else recorded(file, rng, noise)
    except UfirextError as error:
        _fail(error)
    runs = runs or scene.runs
    scores = _scores(scene, rng, runs, console)
    figure = picture(exhibit(scene.trial(rng), rng), scores, scene.title)
    notes = [*scene.notes, *reading(scores)]
    try:
        paths = write_report(out, figure, scores, scene.title, notes, runs)
        if image is not None and image.resolve() != paths["picture.png"].resolve():
            copyfile(paths["picture.png"], image)
    except OSError as error:
        _fail(f"{error.filename}: cannot be written: {error.strerror or error}")
    console.print(_table(scene.title, scores, runs))
    for note in notes:
        console.print(f"- {note}", highlight=False, soft_wrap=True)
    if image is not None:
        console.print(f"Picture: {image}", soft_wrap=True)
    console.print(f"Report: {paths['report.html'].resolve()}", highlight=False, soft_wrap=True)


def _scores(scene: Scene, rng: np.random.Generator, runs: int, console: Console) -> Scores:
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task(f"{len(CONTENDERS)} filters, {runs} runs", total=runs * len(SCENARIOS))
        return compare(scene.trial, rng, runs, lambda: progress.advance(task))


def _table(title: str, scores: Scores, runs: int) -> Table:
    words = "one run" if runs == 1 else f"mean of {runs} runs ± standard error"
    table = Table(
        title=f"{title}: RMSE of the position, m\n{words}; Q x 100 is as good as R / 100, and so on",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
    )
    table.add_column("filter", overflow="fold")  # the one that gives way on a narrow terminal
    for scenario in SCENARIOS:
        cells = [cell(row.get(scenario)) for row in scores.values()]
        heading = scenario.replace(", ", ",\n")
        table.add_column(heading, justify="right", no_wrap=True, min_width=max(map(len, cells)))
    for name, row in scores.items():
        table.add_row(name.partition(" (or ")[0], *(cell(row.get(scenario)) for scenario in SCENARIOS))
    return table


def _check_targets(source: Path | None, out: Path, image: Path | None) -> None:
    """Before any work: that what will be written can be, is what its name says, and is not the source."""
    folder = next(place for place in (out.resolve(), *out.resolve().parents) if place.exists())
    if not folder.is_dir():
        _wrong(f"{folder} is a file, not a folder", "--out")
    kept = None if source is None else source.resolve()
    if kept in [(out / name).resolve() for name in REPORT]:
        _wrong(f"the report would be written over the input {source}", "--out")
    if image is None:
        return
    if image.suffix.lower() != ".png" or image.is_dir():
        _wrong(f"must be a file that ends in .png, got {image}", "--picture")
    if image.resolve() == kept:
        _wrong(f"{image} is the input", "--picture")
    if not image.resolve().parent.is_dir() and image.resolve().parent != out.resolve():
        _wrong(f"there is no folder {image.parent}", "--picture")


def _wrong(reason: str, option: str) -> NoReturn:
    raise typer.BadParameter(reason, param_hint=option)


def _fail(reason: object) -> NoReturn:
    Console(stderr=True, soft_wrap=True).print(f"ufirext demo: {reason}", markup=False, highlight=False)
    raise typer.Exit(1)
