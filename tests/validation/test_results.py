"""Results survive being written, and drift is seen."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

from tests.validation.items import claim, good, item
from validation.claims import AtLeast, Claim, Interval, Verdict, absolute, printed, sampling
from validation.results import Summary, drift, read, write
from validation.runner import run_item
from validation.study import Study

CLAIMS = [
    Claim("s3", "s3-try", "a", 0.0477, 0.0475, printed(4) + sampling(2), 1e-3),
    Claim("s3", "s3-try", "b", AtLeast(1e3, "diverges"), math.inf, absolute(0.0)),
    Claim("s3", "s3-try", "c", 1.0, 2.0, absolute(0.1), because="so", expected=Interval(1.9, 2.1)),
    Claim("s3", "s3-try", "d", math.nan, None, absolute(0.0), because="no data"),
]


def summary(claims: list[Claim]) -> Summary:
    return Summary("quick", 1, "2026-01-01", {"python": "3"}, {"s3-try": 0.1}, claims)


def test_results_are_read_as_they_were_written(tmp_path: Path) -> None:
    write(summary(CLAIMS), tmp_path / "folder" / "quick.json")
    found = read(tmp_path / "folder" / "quick.json")
    assert repr(found) == repr(summary(CLAIMS))
    assert [c.verdict for c in found.claims] == [c.verdict for c in CLAIMS]


def test_the_same_numbers_do_not_drift() -> None:
    assert drift(summary(CLAIMS), summary(CLAIMS), ["s3-try"]) == []


def test_rounding_is_no_drift() -> None:
    moved = [replace(CLAIMS[0], ours=0.0475 * (1 + 1e-12)), *CLAIMS[1:]]
    assert drift(summary(CLAIMS), summary(moved), ["s3-try"]) == []


def test_changed_new_and_lost_claims_drift() -> None:
    after = [replace(CLAIMS[0], ours=0.0476), *CLAIMS[2:], claim("new", 1.0)]
    found = drift(summary(CLAIMS), summary(after), ["s3-try"])
    assert [(d.key, d.before is None, d.after is None) for d in found] == [
        ("s3-try: a", False, False),
        ("s3-try: new", True, False),
        ("s3-try: b", False, True),
    ]


def test_another_verdict_drifts_though_the_number_is_the_same() -> None:
    after = [replace(CLAIMS[0], tolerance=printed(4)), *CLAIMS[1:]]
    (found,) = drift(summary(CLAIMS), summary(after), ["s3-try"])
    assert found.after is not None
    assert found.after.verdict is Verdict.DIFFERS


def test_what_cannot_be_run_here_does_not_drift() -> None:
    after = [replace(CLAIMS[0], ours=None, because="no tracks"), *CLAIMS[1:]]
    assert drift(summary(CLAIMS), summary(after), ["s3-try"]) == []


def test_items_that_did_not_run_do_not_drift() -> None:
    assert drift(summary(CLAIMS), summary([]), ["s3-other"]) == []


def test_a_summary_is_of_all_claims_of_a_run() -> None:
    found = Summary.of([run_item(item(good), Study("s3-try"))], "quick")
    assert [c.name for c in found.claims] == ["a", "b"]
    assert found.versions["numpy"]
