"""Series larger than memory: from a file to a file, part by part, and on again after a kill."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from dataclasses import dataclass
from multiprocessing import get_context
from os import PathLike
from pathlib import Path
from typing import Any

from .._arrays import integer
from ..errors import ShapeError
from ..model import Model
from ..series.progress import Progress, ticking
from .journal import Journal
from .part import Task, checked, chunk_length
from .storage import Storage, storage_of

__all__ = ["filter_file"]


@dataclass(frozen=True)
class Unit:
    """A part of the file: some series, some rows, and where its overlap begins."""

    first: int
    last: int
    begin: int
    start: int
    stop: int

    @property
    def rows(self) -> int:
        """Rows of all its series together."""
        return (self.last - self.first) * (self.stop - self.start)


def filter_file(
    model: Model,
    source: str | PathLike[str],
    target: str | PathLike[str],
    horizon: int | str,
    *,
    lag: int = 0,
    missing: str = "extend",
    noise: tuple[Any, Any] | None = None,
    chunk: int | None = None,
    overlap: int | None = None,
    beyond: str = "raise",
    workers: int = 1,
    progress: Progress = False,
) -> Path:
    """Filter a file of measurements into a file of estimates, neither of which need fit into memory.

    Parts are read, filtered and written one by one, and each is noted once it is on the disk. If the run is
    killed, the same call goes on after the last whole part. Until the end the estimates lie in
    ``target + ".part"``.

    Parameters
    ----------
    model, horizon, lag, missing, noise
        As in `ufirext.filter_series`; missing="predict" remembers everything and is refused.
    source : path-like
        ``.npy`` or ``.zarr``, (T, dim_z) or (S, T, dim_z), or (T,) where dim_z is 1; NaN is missing.
    target : path-like
        ``.npy`` or ``.zarr``, (T, dim_x) or (S, T, dim_x) in float64; NaN where a row is not ready. An older
        file is replaced at the end.
    chunk : int, optional
        Rows of a part; default `chunk_length`. Memory grows with it and with nothing else.
    overlap : int, optional
        Rows of the past each part sees; default horizon - 1 + lag.
    beyond : {"raise", "warn"}
        What is done where rows are missing and an estimate depends on what lies before the overlap.
    workers : int, optional
        Processes. They are sent places in the files, no data. A script that asks for more than one needs
        ``if __name__ == "__main__":`` around the call, because they are started afresh.
    progress : bool or callable
        True shows a bar (needs rich); a callable is called with (rows done, rows in all).

    Returns
    -------
    Path
        The target.

    Raises
    ------
    BeyondOverlap
        See `beyond`.
    UfirextError
        If a run that was broken off had other arguments, or another source.

    Examples
    --------
    >>> import numpy as np
    >>> from ufirext import kinematic
    >>> from ufirext.distributed import filter_file
    >>> np.save("measured.npy", 0.5 * np.arange(40_000.0))
    >>> path = filter_file(kinematic(1, 1, 0.1), "measured.npy", "estimated.npy", horizon=50, chunk=10_000)
    >>> np.load(path, mmap_mode="r")[-1].round(6)
    array([1.99995e+04, 5.00000e+00])
    """
    task = checked(
        model,
        horizon,
        overlap,
        lag=lag,
        missing=missing,
        noise=noise,
        window="arrivals",
        longest_delay=0,
        beyond=beyond,
    )
    workers = integer(workers, "workers", 1)
    length = chunk_length(model, task.horizon, lag=task.lag, overlap=task.overlap)
    length = length if chunk is None else integer(chunk, "chunk", 1)
    inward, outward, goal = storage_of(source), storage_of(target, ".part"), storage_of(target)
    shape = _shape(inward, model)
    units = list(_units(shape, length, task.overlap))
    result = (*shape[:2], model.dim_x) if len(inward.shape) == 3 else (shape[1], model.dim_x)
    journal = Journal(Path(f"{goal.path}.journal"), _terms(task, inward, length))
    done = journal.begin(fresh=not outward.exists())
    if not done:
        outward.create(result, length)
    with journal, ticking(progress, sum(unit.rows for unit in units)) as tick:
        tick(sum(units[number].rows for number in done))
        left = {number: unit for number, unit in enumerate(units) if number not in done}
        for number in _run(task, inward, outward, left, workers):
            journal.note(number)
            tick(units[number].rows)
    _finish(outward, goal, journal)
    return goal.path


def _shape(source: Storage, model: Model) -> tuple[int, int, int]:
    """(S, T, dim_z) of a source."""
    shape = source.shape if len(source.shape) > 1 or model.dim_z > 1 else (*source.shape, 1)
    if len(shape) not in (2, 3) or shape[-1] != model.dim_z:
        raise ShapeError(
            f"{source.path} must have shape (T, {model.dim_z}) or (S, T, {model.dim_z}), got {source.shape}"
        )
    return shape[0] if len(shape) == 3 else 1, shape[-2], shape[-1]


def _units(shape: tuple[int, int, int], length: int, overlap: int) -> Iterator[Unit]:
    """Parts of `length` rows; of short series, as many together as have so many rows."""
    series, steps = shape[:2]
    together = max(1, length // max(steps, 1))
    for first in range(0, series, together):
        for start in range(0, steps, length):
            stop = min(start + length, steps)
            yield Unit(first, min(first + together, series), max(0, start - overlap), start, stop)


def _terms(task: Task, source: Storage, length: int) -> dict[str, Any]:
    """What a broken run must have in common with the one that goes on."""
    model = task.model
    return {
        "model": {n: None if a is None else a.tolist() for n in "FHQRB" for a in [getattr(model, n)]},
        "task": [task.horizon, task.lag, task.missing, repr(task.noise), task.overlap, task.beyond],
        "chunk": length,
        "source": [str(source.path.resolve()), list(source.shape), str(source.dtype), source.modified()],
    }


def _run(task: Task, source: Storage, target: Storage, units: dict[int, Unit], workers: int) -> Iterator[int]:
    """Numbers of the units as they get done."""
    if workers == 1 or len(units) < 2:
        for number, unit in units.items():
            _filter_unit(task, source, target, unit)
            yield number
        return
    # Processes are started afresh: forking copies locks of whatever threads the caller has.
    with ProcessPoolExecutor(min(workers, len(units)), mp_context=get_context("spawn")) as pool:
        waiting = {pool.submit(_filter_unit, task, source, target, unit): n for n, unit in units.items()}
        try:
            while waiting:
                for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                    future.result()
                    yield waiting.pop(future)
        finally:
            for future in waiting:
                future.cancel()


def _filter_unit(task: Task, source: Storage, target: Storage, unit: Unit) -> None:
    z = source.read(unit.first, unit.last, unit.begin, unit.stop)
    x = task.run(z.reshape(z.shape[0], z.shape[1], -1), unit.start, unit.start - unit.begin)
    target.write(unit.first, unit.last, unit.start, unit.stop, x)


def _finish(part: Storage, goal: Storage, journal: Journal) -> None:
    if goal.path.is_dir():
        shutil.rmtree(goal.path)
    os.replace(part.path, goal.path)
    journal.remove()
