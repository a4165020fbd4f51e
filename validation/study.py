"""What an item is given to run with: its size, its random numbers, its workers, its progress."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Concatenate, Literal, ParamSpec, Protocol, TypeVar
from zlib import crc32

import numpy as np

__all__ = ["SEED", "Mode", "Study", "Workers"]

Mode = Literal["quick", "full"]
SEED = 20190104
"""Root of all random numbers of the suite."""


class Workers(Protocol):
    """What shares runs: `validation.runner.Processes`."""

    def map(self, call: Callable[[Any], Any], values: Sequence[Any]) -> Iterable[Any]:
        """Results in the order of the values."""
        ...


P = ParamSpec("P")
T = TypeVar("T")
V = TypeVar("V")


def _silent(share: float) -> None:
    """Progress that nobody watches."""


@dataclass(frozen=True)
class Study:
    """How an item is run.

    Attributes
    ----------
    item : str
        Its id: random numbers depend on it and not on what ran before.
    mode : {"quick", "full"}
    workers : Workers or None
        Processes that share the runs; None runs them here. The numbers are the same.
    watch : callable
        Told the finished share of the item, 0 to 1.
    """

    item: str
    mode: Mode = "quick"
    workers: Workers | None = field(default=None, compare=False)
    watch: Callable[[float], None] = field(default=_silent, compare=False)

    def choose(self, quick: T, full: T) -> T:
        """The value for this mode, usually a number of runs."""
        return quick if self.mode == "quick" else full

    def seed(self, stream: str = "") -> np.random.SeedSequence:
        """Root of one named stream of random numbers of this item; the same in both modes."""
        return np.random.SeedSequence([SEED, crc32(self.item.encode()), crc32(stream.encode())])

    def rng(self, stream: str = "") -> np.random.Generator:
        """Random numbers for what is drawn once."""
        return np.random.default_rng(self.seed(stream))

    def runs(
        self,
        function: Callable[Concatenate[np.random.Generator, P], T],
        count: int,
        *args: P.args,
        **kwargs: P.kwargs,
    ) -> list[T]:
        """``function(rng, *args, **kwargs)`` `count` times, each with random numbers of its own, in order.

        The run i of every call has the same random numbers whatever the arguments are (common random
        numbers), and those of the quick mode are the first ones of the full mode.

        Parameters
        ----------
        function : callable
            Defined at the top of a module, so that other processes find it.
        count : int
        """
        return self._all(partial(_seeded, function, args, kwargs), self.seed("runs").spawn(count))

    def sweep(
        self,
        function: Callable[Concatenate[V, P], T],
        values: Iterable[V],
        *args: P.args,
        **kwargs: P.kwargs,
    ) -> list[T]:
        """``function(value, *args, **kwargs)`` for each value, in order; for what is not random."""
        return self._all(partial(_called, function, args, kwargs), list(values))

    def _all(self, call: Callable[[Any], T], values: Sequence[Any]) -> list[T]:
        found: Iterable[T] = map(call, values)
        if self.workers is not None and len(values) > 1:
            found = self.workers.map(call, values)
        results: list[T] = []
        for result in found:
            results.append(result)
            self.watch(len(results) / len(values))
        return results


def _called(function: Callable[..., T], args: tuple[Any, ...], kwargs: dict[str, Any], value: Any) -> T:
    return function(value, *args, **kwargs)


def _seeded(
    function: Callable[..., T], args: tuple[Any, ...], kwargs: dict[str, Any], seed: np.random.SeedSequence
) -> T:
    return function(np.random.default_rng(seed), *args, **kwargs)
