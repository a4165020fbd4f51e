"""Items are run, timed, and held to what they promised."""

from __future__ import annotations

import math
import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from fnmatch import fnmatch
from functools import partial
from time import perf_counter
from typing import Any, TypeVar

from validation.claims import Claim, Tolerance, Verdict
from validation.item import CannotRun, Item, Outcome
from validation.study import Mode, Study, Workers

__all__ = ["Processes", "Result", "chosen", "pool", "run_all", "run_item"]

T = TypeVar("T")


@dataclass(frozen=True)
class Result:
    """What became of an item.

    Attributes
    ----------
    item : Item
    outcome : Outcome
        Its claims are those that the item promised, in that order; the ones it did not keep were not run.
    seconds : float
    """

    item: Item
    outcome: Outcome
    seconds: float = field(compare=False)

    def count(self, verdict: Verdict) -> int:
        """How many of its claims got that verdict."""
        return sum(claim.verdict is verdict for claim in self.outcome.claims)

    @property
    def fails(self) -> bool:
        """Whether a claim differs without explanation or was not run."""
        return any(claim.verdict.fails for claim in self.outcome.claims)


def run_item(item: Item, study: Study) -> Result:
    """Run one item; what it raises becomes the verdict of its claims, so that the others still run."""
    start = perf_counter()
    try:
        outcome = _held(item, item.run(study))
    except CannotRun as reason:
        outcome = Outcome([_unkept(item, name, str(reason), ran=True) for name in item.claims])
    except Exception as error:
        because = f"{type(error).__name__}: {error}"
        outcome = Outcome([_unkept(item, name, because, ran=False) for name in item.claims])
    return Result(item, outcome, perf_counter() - start)


def chosen(items: Sequence[Item], patterns: Sequence[str]) -> list[Item]:
    """The items whose id is one of the patterns, begins with one, or matches one as a shell pattern."""
    found = [i for i in items if not patterns or any(_named(i.id, p) or fnmatch(i.id, p) for p in patterns)]
    if not found:
        names = ", ".join(item.id for item in items)
        raise ValueError(f"no item matches {', '.join(patterns)}; there are {names}")
    return found


class Processes:
    """Processes that share runs; where one dies, its item fails and the next item gets new ones."""

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self._executor: ProcessPoolExecutor | None = None

    def map(self, call: Callable[[Any], T], values: Sequence[Any]) -> Iterator[T]:
        """Results in the order of the values."""
        if self._executor is None:
            # Spawned, not forked: the same on all systems, and safe beside threads of numerical libraries.
            context = multiprocessing.get_context("spawn")
            self._executor = ProcessPoolExecutor(self._jobs, mp_context=context)
        try:
            yield from self._executor.map(call, values, chunksize=max(1, len(values) // 16))
        except BrokenProcessPool:
            self.close()
            raise

    def close(self) -> None:
        """End the processes."""
        if self._executor is not None:
            self._executor.shutdown(cancel_futures=True)
            self._executor = None


@contextmanager
def pool(jobs: int) -> Iterator[Processes | None]:
    """So many processes for the runs; None for one, which needs no other."""
    if jobs < 2:
        yield None
        return
    workers = Processes(jobs)
    try:
        yield workers
    finally:
        workers.close()


def run_all(
    items: Sequence[Item],
    mode: Mode,
    workers: Workers | None,
    watch: Callable[[Item, float], None],
) -> Iterator[Result]:
    """Run items one after the other; `watch` is told the finished share of the one at work."""
    for item in items:
        yield run_item(item, Study(item.id, mode, workers, partial(watch, item)))


def _named(name: str, pattern: str) -> bool:
    """Whether the pattern is the id or its beginning up to a dash: s3-fig-1 is not meant by s3-fig-10."""
    return name == pattern or name.startswith(f"{pattern.rstrip('-')}-")


def _held(item: Item, outcome: Outcome) -> Outcome:
    """The outcome with one claim for each promise."""
    found = {claim.name: claim for claim in outcome.claims}
    extra = [claim.key for claim in outcome.claims if claim.name not in item.claims or claim.item != item.id]
    if extra or len(found) < len(outcome.claims):
        raise ValueError(f"claims must be those that {item.id} promises, once each; got also {extra}")
    claims = [
        found.get(name) or _unkept(item, name, "promised, not returned", ran=False) for name in item.claims
    ]
    return replace(outcome, claims=claims)


def _unkept(item: Item, name: str, because: str, *, ran: bool) -> Claim:
    return Claim(item.paper.key, item.id, name, math.nan, None, Tolerance(), because=because, ran=ran)
