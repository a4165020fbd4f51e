"""The benchmark counts right and every row does its work; no time is asserted."""

from __future__ import annotations

import json
import platform
import re
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rich", reason="pip install ufirext[bench]")

from typer.testing import CliRunner

from benchmarks.cli import app
from benchmarks.harness import (
    EXCESS,
    MILLISECONDS,
    SPEEDUP,
    Contest,
    MissingPeerError,
    Row,
    Run,
    measure,
    worst_step,
)
from benchmarks.memory import JOBS, peak_of
from benchmarks.report import as_json, as_markdown
from benchmarks.rows import GROUPS, all_rows

ROWS = {row.name: row for row in all_rows()}
ON_ONE_PATH = [name for name in ROWS if name.split("/")[0] in ("lti", "edits", "holes", "varying")]


class Clock:
    """A clock that only moves when work is done."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 0.0
        for name in ("process_time", "perf_counter"):
            monkeypatch.setattr(time, name, lambda: self.now)

    def work(self, seconds: float, estimate: float = 0.0) -> Callable[[], Run]:
        def run() -> object:
            self.now += seconds
            return estimate

        return lambda: run


def row(contest: Contest, **options: object) -> Row:
    return Row("fake/row", "work", "peer", 2.0, lambda steps: contest, **options)  # type: ignore[arg-type]


def test_a_round_is_the_ratio_of_the_peers_time_to_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock(monkeypatch)
    result = measure(row(Contest(clock.work(2.0), clock.work(5.0), 100)), steps=100, rounds=3)
    assert result.rounds == pytest.approx([2.5, 2.5, 2.5])
    assert (result.ours_s, result.peer_s) == pytest.approx((0.02, 0.05))
    assert result.met


def test_sides_take_turns_ours_peer_peer_ours() -> None:
    order: list[str] = []

    def side(name: str) -> Callable[[], Run]:
        return lambda: lambda: order.append(name) or 0.0  # type: ignore[func-returns-value]

    measure(row(Contest(side("ours"), side("peer"), 1)), steps=1, rounds=2)
    assert order == ["ours", "peer", "peer", "ours"] * 2


def test_the_median_over_rounds_shrugs_off_one_disturbed_round(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock(monkeypatch)
    delays = iter([1.0, 1.0, 50.0, 1.0, 1.0, 1.0])

    def ours() -> Run:
        return clock.work(next(delays))()

    result = measure(row(Contest(ours, clock.work(3.0), 1)), steps=1, rounds=3)
    assert result.median == pytest.approx(3.0)
    assert min(result.rounds) == pytest.approx(3.0 / 25.5)


@pytest.mark.parametrize(("metric", "value", "met"), [(SPEEDUP, 2.5, True), (EXCESS, -3000.0, True)])
def test_metrics_of_two_seconds_against_five(
    metric: object, value: float, met: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Clock(monkeypatch)
    result = measure(row(Contest(clock.work(2.0), clock.work(5.0), 1), metric=metric), steps=1, rounds=1)
    assert result.median == pytest.approx(value)
    assert result.met is met


def test_a_time_above_its_limit_is_not_met(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock(monkeypatch)
    result = measure(row(Contest(clock.work(3e-3), None, 1), metric=MILLISECONDS), steps=1, rounds=1)
    assert result.median == pytest.approx(3.0)
    assert not result.met


def test_worst_step_sees_a_rare_slow_step_and_not_the_rarest(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock(monkeypatch)

    def steps() -> object:
        for index in range(10_000):
            clock.now += 100.0 if index == 17 else 5.0 if index % 500 == 0 else 1.0
            yield index

    seconds, _ = worst_step(steps, 10_000)
    assert seconds == pytest.approx(5.0)


def test_an_estimate_that_is_not_finite_is_an_error() -> None:
    contest = Contest(lambda: lambda: np.array([1.0, np.nan]), None, 1)
    with pytest.raises(ArithmeticError, match="fake/row, ours"):
        measure(row(contest), steps=1, rounds=1)


def test_reports_name_row_target_and_outcome(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock(monkeypatch)
    result = measure(row(Contest(clock.work(2.0), clock.work(3.0), 1)), steps=1, rounds=3)
    absent = (row(Contest(clock.work(1.0), None, 1)), "pip install something")
    text = as_markdown([result, absent], "3 rounds")
    assert "| fake/row | work | peer | >= 2x | 1.5x | 1.5x .. 1.5x | not met |" in text
    assert "not run: pip install something" in text
    first, second = json.loads(as_json([result, absent], "3 rounds"))["rows"]
    assert first["rounds"] == [1.5, 1.5, 1.5]
    assert second["not_run"] == "pip install something"


def test_the_results_file_says_what_it_was_measured_on(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock(monkeypatch)
    result = measure(row(Contest(clock.work(2.0), clock.work(5.0), 1)), steps=1, rounds=1)
    text = as_markdown([result, (result.row, "pip install something")], "1 round of 1 step")
    assert text.startswith("# Measured ratios\n")
    assert "\n## fake\n" in text
    assert "- 1 of 1 targets met; 1 rows could not run" in text
    assert re.search(r"^- .*\d+ cores?.*", text, flags=re.MULTILINE)
    assert f"Python {platform.python_version()}" in text
    assert f"numpy {np.__version__}" in text


@pytest.mark.parametrize(
    ("options", "written"),
    [([], True), (["--quick"], False), (["--only", "gains"], False), (["--quick", "--markdown", "R"], True)],
)
def test_only_a_whole_run_writes_the_results(
    options: list[str], written: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    target = tmp_path / "RESULTS.md"
    monkeypatch.setattr("benchmarks.cli.RESULTS", target)
    monkeypatch.setattr("benchmarks.cli._run", lambda *arguments: [])
    options = [str(target) if option == "R" else option for option in options]
    assert CliRunner().invoke(app, options).exit_code == 0
    assert target.exists() is written


@pytest.mark.parametrize("job", JOBS)
def test_every_memory_job_runs_and_tells_its_peak(job: str) -> None:
    pytest.importorskip("resource", reason="this system does not tell peaks")
    data, grown, whole = peak_of(job, 2_000)
    assert data > 2_000 * 16
    assert 0 <= grown < whole


def test_names_are_unique_and_every_group_has_rows() -> None:
    assert len(ROWS) == len(all_rows())
    assert len({name.split("/")[0] for name in ROWS}) == len(GROUPS)


@pytest.mark.parametrize("name", ROWS)
def test_every_row_runs_and_ends_in_finite_estimates(name: str) -> None:
    try:
        result = measure(ROWS[name], steps=30, rounds=1)
    except MissingPeerError as missing:
        pytest.skip(str(missing))
    assert all(np.isfinite(result.rounds))
    assert result.ours_s > 0


@pytest.mark.parametrize("name", ON_ONE_PATH)
def test_both_sides_of_a_stream_follow_the_same_path(name: str) -> None:
    """Otherwise the times of two different jobs would be compared."""
    try:
        contest = ROWS[name].setup(50)
    except MissingPeerError as missing:
        pytest.skip(str(missing))
    assert contest.peer is not None
    ours, peer = (np.ravel(_last(make(), contest.units)) for make in (contest.ours, contest.peer))
    assert ours.shape == peer.shape
    assert abs(ours[0] - peer[0]) < 5.0, f"positions {ours[0]:.2f} and {peer[0]:.2f} m, noise 1 m"


def _last(run: Run, units: int) -> np.ndarray:
    outcome = run()
    if hasattr(outcome, "__next__"):
        for _ in range(units):
            estimate = next(outcome)
        return np.asarray(estimate, dtype=float)
    return np.asarray(outcome, dtype=float)
