"""Random numbers depend on the item, the stream and the run, and on nothing else."""

from __future__ import annotations

import os
from concurrent.futures.process import BrokenProcessPool

import numpy as np
import pytest

from validation.runner import pool
from validation.study import Study


def draw(rng: np.random.Generator, scale: float) -> float:
    return scale * float(rng.standard_normal())


def cube(value: float, shift: float) -> float:
    return value**3 + shift


def test_serial_and_parallel_give_the_same_numbers_in_the_same_order() -> None:
    with pool(2) as workers:
        parallel = Study("s3-x", workers=workers)
        assert parallel.runs(draw, 40, 2.0) == Study("s3-x").runs(draw, 40, 2.0)
        assert parallel.sweep(cube, range(10), 1.0) == [n**3 + 1.0 for n in range(10)]


def die(value: int) -> int:
    os._exit(1)


def test_where_a_process_dies_the_next_item_gets_new_ones() -> None:
    with pool(2) as workers:
        with pytest.raises(BrokenProcessPool):
            Study("s3-x", workers=workers).sweep(die, range(4))
        assert Study("s3-y", workers=workers).sweep(cube, range(4), 0.0) == [0.0, 1.0, 8.0, 27.0]


def test_runs_have_common_random_numbers_whatever_is_done_with_them() -> None:
    study = Study("s3-x")
    assert np.allclose(study.runs(draw, 5, 3.0), 3.0 * np.array(study.runs(draw, 5, 1.0)))


def test_few_runs_are_the_first_of_many() -> None:
    quick, full = Study("s3-x", "quick"), Study("s3-x", "full")
    assert full.runs(draw, 9, 1.0)[:4] == quick.runs(draw, 4, 1.0)


def test_items_streams_and_runs_have_different_random_numbers() -> None:
    runs = Study("s3-x").runs(draw, 20, 1.0) + Study("s3-y").runs(draw, 20, 1.0)
    streams = [float(Study("s3-x").rng(name).standard_normal()) for name in ("", "a", "b", "runs")]
    assert len({*runs, *streams}) == 44


def test_the_mode_chooses() -> None:
    assert (Study("a", "quick").choose(1, 2), Study("a", "full").choose(1, 2)) == (1, 2)


def test_progress_ends_at_one() -> None:
    shares: list[float] = []
    Study("s3-x", watch=shares.append).runs(draw, 4, 1.0)
    assert shares == [0.25, 0.5, 0.75, 1.0]
