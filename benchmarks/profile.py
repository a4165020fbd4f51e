"""`python -m benchmarks.profile ROW`: where the time of our side of a row goes."""

from __future__ import annotations

import cProfile
import pstats
from typing import Annotated

import typer

from benchmarks.cli import chosen

__all__ = ["profile"]


def profile(
    name: Annotated[str, typer.Argument(help="A row, as `python -m benchmarks --list` prints it.")],
    steps: Annotated[int, typer.Option(min=200)] = 20_000,
    lines: Annotated[int, typer.Option(min=1, help="How many functions to show.")] = 25,
) -> None:
    """Profile ufirext's side of one row by function."""
    contest = chosen([name])[0].setup(steps)
    run = contest.ours()
    profiler = cProfile.Profile()
    profiler.enable()
    outcome = run()
    if hasattr(outcome, "__next__"):
        for _ in range(contest.units):
            next(outcome)
    profiler.disable()
    pstats.Stats(profiler).strip_dirs().sort_stats("tottime").print_stats(lines)


if __name__ == "__main__":
    typer.run(profile)
