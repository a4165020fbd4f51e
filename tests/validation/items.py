"""Small items to test the frame with."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from validation.claims import Claim, Tolerance
from validation.item import Item, Outcome, Table
from validation.papers import S3
from validation.study import Study


def claim(name: str, ours: float | None, item: str = "s3-try", **rest: object) -> Claim:
    return Claim("s3", item, name, 1.0, ours, Tolerance(), **rest)  # type: ignore[arg-type]


def item(run: Callable[[Study], Outcome], claims: Sequence[str] = ("a", "b"), name: str = "s3-try") -> Item:
    return Item(name, S3, "A small <item> & a title", run, claims, {"N": "5"}, ["open?"], ["assumed"])


def good(study: Study) -> Outcome:
    table = Table("numbers", ("name", "value"), [("one", 1.0), ("none", float("nan"))])
    return Outcome([claim("b", 1.0), claim("a", 1.0)], [table], notes=["a note"])


def crashing(study: Study) -> Outcome:
    raise ZeroDivisionError("by zero")


def renamed(name: str, study: Study) -> Outcome:
    """`good` under another name."""
    found = good(study)
    claims = [claim(c.name, c.ours, item=name) for c in found.claims]
    return Outcome(claims, found.tables, notes=found.notes)
