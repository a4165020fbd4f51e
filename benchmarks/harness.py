"""Time two contenders turn by turn and keep one number a round."""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass

import numpy as np

__all__ = [
    "EXCESS",
    "MILLISECONDS",
    "SPEEDUP",
    "Contest",
    "Metric",
    "MissingPeerError",
    "Result",
    "Row",
    "measure",
    "wall_clock",
    "whole_run",
    "worst_step",
]

Run = Callable[[], object]
"""A prepared piece of work: called once, returns an estimate."""

Timer = Callable[[Run, int], tuple[float, object]]
"""Runs the work of so many units; returns seconds per unit and the estimate."""


class MissingPeerError(RuntimeError):
    """A package to compare with is not installed; the message is the command that installs it."""


@dataclass(frozen=True)
class Metric:
    """How the seconds per unit of both sides become the one number of a round."""

    symbol: str
    of: Callable[[float, float], float]
    higher_is_better: bool

    def met(self, value: float, target: float) -> bool:
        """Whether a measured value reaches the target."""
        return value >= target if self.higher_is_better else value <= target

    def show(self, value: float) -> str:
        """The value with its unit, three digits."""
        return f"{value:.3g}{self.symbol}"


SPEEDUP = Metric("x", lambda ours, peer: peer / ours, higher_is_better=True)
EXCESS = Metric(" ms", lambda ours, peer: 1e3 * (ours - peer), higher_is_better=False)
MILLISECONDS = Metric(" ms", lambda ours, _: 1e3 * ours, higher_is_better=False)


@dataclass(frozen=True)
class Contest:
    """What a row's setup prepares: for each side a function that makes fresh work, not timed itself.

    Attributes
    ----------
    ours, peer : callable
        Called without arguments; builds filters, warms them up, returns the work to be timed.
        peer is None where the target is a time and not a ratio.
    units : int
        How many steps (frames, designs, imports) one run does.
    """

    ours: Callable[[], Run]
    peer: Callable[[], Run] | None
    units: int


@dataclass(frozen=True)
class Row:
    """One line of the table: a name, a target and the setup that prepares the contest.

    Attributes
    ----------
    name : str
        Group and case, as `lti/K4-N100`.
    work, peer : str
        What is timed and against what, for the reader.
    target : float
        In the metric's unit.
    setup : callable
        setup(steps) returns a Contest of about that many steps; raises MissingPeerError.
    stretch : bool
        A target that no prototype reached with every check on.
    """

    name: str
    work: str
    peer: str
    target: float
    setup: Callable[[int], Contest]
    metric: Metric = SPEEDUP
    timer: Timer | None = None
    stretch: bool = False


@dataclass(frozen=True)
class Result:
    """The rounds of one row."""

    row: Row
    rounds: tuple[float, ...]
    ours_s: float
    peer_s: float

    @property
    def median(self) -> float:
        """Median over the rounds, in the row's metric."""
        return statistics.median(self.rounds)

    @property
    def met(self) -> bool:
        """Whether the median reaches the target."""
        return self.row.metric.met(self.median, self.row.target)


def whole_run(run: Run, units: int) -> tuple[float, object]:
    """Mean processor seconds per unit of one run: what other programs take of the machine does not count."""
    start = time.process_time()
    estimate = run()
    return (time.process_time() - start) / units, estimate


def wall_clock(run: Run, units: int) -> tuple[float, object]:
    """Mean seconds per unit by the clock on the wall, for work done in other processes."""
    start = time.perf_counter()
    estimate = run()
    return (time.perf_counter() - start) / units, estimate


def worst_step(run: Run, units: int) -> tuple[float, object]:
    """Processor seconds of the slowest step, the slowest 0.1 % left to the operating system.

    run() returns an iterator that does one step each time it is advanced and yields the estimate.
    """
    steps = run()
    if not isinstance(steps, Generator):
        raise TypeError(f"a worst-step contender must return a generator, got {type(steps).__name__}")
    durations = np.empty(units)
    estimate: object = None
    for index in range(units):
        start = time.process_time()
        estimate = next(steps)
        durations[index] = time.process_time() - start
    return float(np.quantile(durations, 0.999)), estimate


def measure(row: Row, steps: int, rounds: int, tick: Callable[[], None] = lambda: None) -> Result:
    """Run a row's contest turn by turn (ours, peer, peer, ours), one ratio a round.

    Every turn starts from fresh objects and a collected heap; the collector is off while the clock runs.

    Raises
    ------
    ArithmeticError
        A contender ends with an estimate that is not finite: its time would mean nothing.
    MissingPeerError
        A package to compare with is not installed.
    """
    contest = row.setup(steps)
    timer = row.timer or whole_run
    ours, peers = [], []
    for _ in range(rounds):
        spent = {"ours": 0.0, "peer": 0.0}
        for side, make in _turns(contest):
            spent[side] += _timed(timer, make, contest.units, f"{row.name}, {side}")
        ours.append(spent["ours"] / 2)
        peers.append(spent["peer"] / 2)
        tick()
    values = tuple(row.metric.of(a, b) for a, b in zip(ours, peers, strict=True))
    return Result(row, values, statistics.median(ours), statistics.median(peers))


def _turns(contest: Contest) -> Iterator[tuple[str, Callable[[], Run]]]:
    there = [("ours", contest.ours)]
    if contest.peer is not None:
        there.append(("peer", contest.peer))
    yield from there
    yield from reversed(there)


def _timed(timer: Timer, make: Callable[[], Run], units: int, what: str) -> float:
    run = make()
    gc.collect()
    gc.disable()
    try:
        seconds, estimate = timer(run, units)
    finally:
        gc.enable()
    if not np.all(np.isfinite(np.asarray(estimate, dtype=float))):
        raise ArithmeticError(f"{what}: the last estimate is not finite: {estimate}")
    return seconds
