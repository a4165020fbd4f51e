"""Results as JSON, and how they moved since the last ones that were kept."""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import ufirext
from validation.claims import Claim, Interval, Reported, Tolerance, Verdict
from validation.runner import Result
from validation.study import SEED, Mode

__all__ = ["KEPT", "Drift", "Summary", "drift", "kept", "read", "versions", "write"]

KEPT = Path(__file__).parent / "results"
"""The folder of the results that are checked in."""

PACKAGES = ("numpy", "scipy", "filterpy", "control", "cvxpy", "simdkalman", "matplotlib")
ROUNDING = 1e-9
"""Relative difference that another machine's arithmetic may make."""
DUST = 1e-5
"""Fraction of what a claim allows, or of its bound, that does not count as drift."""


@dataclass(frozen=True)
class Summary:
    """Results of one run of the suite, as they are kept.

    Attributes
    ----------
    mode : {"quick", "full"}
    seed : int
    date : str
        Of the run, ISO.
    versions : dict
        Package -> version.
    seconds : dict
        Item -> time it took.
    claims : list of Claim
    """

    mode: Mode
    seed: int
    date: str
    versions: dict[str, str]
    seconds: dict[str, float]
    claims: list[Claim]

    @classmethod
    def of(cls, results: Sequence[Result], mode: Mode) -> Summary:
        """What is kept of the results of a run."""
        seconds = {result.item.id: round(result.seconds, 2) for result in results}
        claims = [claim for result in results for claim in result.outcome.claims]
        return cls(mode, SEED, date.today().isoformat(), versions(), seconds, claims)

    def updated(self, newer: Summary, items: Sequence[str]) -> Summary:
        """These results with the items of `newer` in place of theirs, in the order of `items`, no others."""
        source = {name: newer if name in newer.seconds else self for name in items}
        found = {name: summary for name, summary in source.items() if name in summary.seconds}
        claims = [c for name, summary in found.items() for c in summary.claims if c.item == name]
        seconds = {name: summary.seconds[name] for name, summary in found.items()}
        return replace(newer, seconds=seconds, claims=claims)


@dataclass(frozen=True)
class Drift:
    """A claim that came out differently from the last time.

    Attributes
    ----------
    key : str
        `Claim.key`.
    before, after : Claim or None
        None where there was no such claim.
    """

    key: str
    before: Claim | None
    after: Claim | None


def versions() -> dict[str, str]:
    """What the numbers were computed with."""
    found = {"python": platform.python_version(), "ufirext": ufirext.__version__}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def write(summary: Summary, path: Path) -> None:
    """Write JSON that a person can compare line by line."""
    content = asdict(summary) | {"claims": [_encoded(claim) for claim in summary.claims]}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(
        json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8"
    )


def read(path: Path) -> Summary:
    """Results that `write` wrote."""
    content = json.loads(path.read_text(encoding="utf-8"))
    return Summary(**content | {"claims": [_decoded(claim) for claim in content["claims"]]})


def kept(mode: Mode) -> Summary | None:
    """The results that are checked in for a mode, if any are."""
    path = KEPT / f"{mode}.json"
    return read(path) if path.exists() else None


def drift(before: Summary, after: Summary, items: Sequence[str]) -> list[Drift]:
    """The claims of these items that are new, gone, or not what they were."""
    old = {claim.key: claim for claim in before.claims if claim.item in items}
    new = {claim.key: claim for claim in after.claims if claim.item in items}
    keys = [*new, *(key for key in old if key not in new)]
    return [Drift(k, old.get(k), new.get(k)) for k in keys if not _same(old.get(k), new.get(k))]


def _same(before: Claim | None, after: Claim | None) -> bool:
    if before is None or after is None:
        return False
    if Verdict.CANNOT_RUN in (before.verdict, after.verdict):
        return True  # the report says so elsewhere
    if before.verdict is not after.verdict or before.ours is None or after.ours is None:
        return before.verdict is after.verdict
    width = ROUNDING * abs(before.ours) + DUST * before.scale
    return before.ours == after.ours or abs(before.ours - after.ours) <= width


def _encoded(claim: Claim) -> dict[str, Any]:
    return asdict(claim) | {
        "reported": _plain(claim.reported),
        "expected": _plain(claim.expected),
        "ours": _plain(claim.ours),
        "verdict": claim.verdict.value,
    }


def _decoded(content: dict[str, Any]) -> Claim:
    values = {name: value for name, value in content.items() if name != "verdict"}
    values |= {name: _number(values[name]) for name in ("reported", "expected", "ours")}
    return Claim(**values | {"tolerance": Tolerance(**values["tolerance"])})


def _plain(value: Reported | None) -> Any:
    """JSON has no infinite numbers and no NaN: they become words."""
    if isinstance(value, Interval):
        return {"low": _plain(value.low), "high": _plain(value.high), "words": value.words}
    return value if value is None or math.isfinite(value) else str(value)


def _number(value: Any) -> Any:
    if isinstance(value, dict):
        return Interval(float(value["low"]), float(value["high"]), value["words"])
    return value if value is None else float(value)
