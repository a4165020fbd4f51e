"""`ufirext demo [FILE]`: run the comparison, print the table, write the report."""

from __future__ import annotations

from pathlib import Path
from shutil import copyfile
from typing import Annotated

import numpy as np
import typer
from rich import box
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from ..errors import UfirextError
from .compare import CONTENDERS, SCENARIOS, compare
from .report import Scores, cell, exhibit, picture, write_report
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
    console = Console()
    rng = np.random.default_rng(seed)
    try:
        scene = city(rng, noise) if file is None else recorded(file, rng, noise)
    except UfirextError as error:
        Console(stderr=True, soft_wrap=True).print(f"[red]error:[/] {error}", highlight=False)
        raise typer.Exit(1) from error
    runs = runs or scene.runs
    scores = _scores(scene, rng, runs, console)
    figure = picture(exhibit(scene.trial(rng), rng), scores, scene.title)
    notes = [*scene.notes, *_reading()]
    paths = write_report(out, figure, scores, scene.title, notes, runs)
    console.print(_table(scene.title, scores, runs))
    for note in notes:
        console.print(f"- {note}", highlight=False, soft_wrap=True)
    if image is not None:
        copyfile(paths["picture.png"], image)
        console.print(f"Picture: {image}", soft_wrap=True)
    console.print(f"Report: {paths['report.html'].resolve()}", highlight=False, soft_wrap=True)


def _scores(scene: Scene, rng: np.random.Generator, runs: int, console: Console) -> Scores:
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task(f"{len(CONTENDERS)} filters, {runs} runs", total=runs * len(SCENARIOS))
        return compare(scene.trial, rng, runs, lambda: progress.advance(task))


def _table(title: str, scores: Scores, runs: int) -> Table:
    words = "one run" if runs == 1 else f"mean of {runs} runs ± standard error"
    table = Table(title=f"{title}: RMSE of the position, m\n{words}", box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("filter", no_wrap=True)
    for scenario in SCENARIOS:
        table.add_column(scenario.replace(", ", ",\n"), justify="right", no_wrap=True)
    for name, row in scores.items():
        table.add_row(name, *(cell(row.get(scenario)) for scenario in SCENARIOS))
    return table


def _reading() -> list[str]:
    late = next(link for link in SCENARIOS.values() if link.late)
    return [
        f"Late packets are 1 to {late.longest} steps late. KalmanFilter has no place for them: it takes "
        "them as new or not at all. The others are told the delay.",
        "With the right Q and R a Kalman filter is the yardstick and not to be beaten, with late packets one "
        "that knows delays; finite memory and H-infinity are for when Q and R are not right.",
        "Kalman is filterpy's KalmanFilter, UFIR is UFIRFilter: its horizon auto is chosen from the model's "
        "Q and R, adaptive from the data alone. FMS is FMSFilterSmoother, minimum variance over a window "
        "half as long again as that of UFIR auto; Delay Kalman and H-infinity are DelayKalmanFilter and "
        "DelayHInfinityFilter, which bounds the errors of the position.",
    ]
