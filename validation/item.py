"""An item of the suite: one table or figure of a paper, one fact, one study."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from validation.claims import Claim
from validation.papers import Paper
from validation.study import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["CannotRun", "Item", "Outcome", "Table", "recorded_tracks"]


class CannotRun(Exception):
    """Raised by `Item.run` where it cannot run at all: all its claims get that verdict, with the message."""


@dataclass(frozen=True)
class Table:
    """Numbers for the report, by row and column.

    Attributes
    ----------
    title : str
    columns : sequence of str
        The first one names the rows.
    rows : sequence of sequences
        Strings as they are, numbers with four significant digits.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str | float]]


@dataclass(frozen=True)
class Outcome:
    """What an item found.

    Attributes
    ----------
    claims : sequence of Claim
        One for each name that the item promises.
    tables : sequence of Table
    figure : callable or None
        Draws the picture, with `validation.figures`; called when there is a report to write, maybe in another
        process: a `functools.partial` of a function at the top of a module and the data.
    notes : sequence of str
        What the reader of the picture should know, one paragraph each.
    """

    claims: Sequence[Claim]
    tables: Sequence[Table] = ()
    figure: Callable[[], Figure] | None = None
    notes: Sequence[str] = ()


@dataclass(frozen=True)
class Item:
    """One table or figure, and how it is reproduced.

    Attributes
    ----------
    id : str
        "s3-table-2": the paper's key first.
    paper : Paper
    title : str
    run : callable
        Study -> Outcome.
    claims : sequence of str
        Names of the claims that `run` must return: one that is missing was not run, and fails the suite.
    parameters : mapping of str to str
        As printed in the paper.
    open_questions : sequence of str
        What the paper leaves open.
    assumptions : sequence of str
        What was assumed instead.
    """

    id: str
    paper: Paper
    title: str
    run: Callable[[Study], Outcome]
    claims: Sequence[str]
    parameters: Mapping[str, str] = field(default_factory=dict)
    open_questions: Sequence[str] = ()
    assumptions: Sequence[str] = ()

    def __post_init__(self) -> None:
        if not self.id.startswith(f"{self.paper.key}-"):
            raise ValueError(f"id must begin with the key of its paper, {self.paper.key}-, got {self.id!r}")
        if not self.claims or len(set(self.claims)) != len(self.claims):
            raise ValueError(f"{self.id}: claims must be distinct names, at least one, got {self.claims!r}")


def recorded_tracks() -> Path:
    """The folder of recorded tracks that UFIREXT_DATA names; CannotRun without one."""
    folder = os.environ.get("UFIREXT_DATA")
    if not folder:
        raise CannotRun("UFIREXT_DATA is not set: it names the folder of recorded tracks")
    path = Path(folder)
    if not path.is_dir():
        raise CannotRun(f"UFIREXT_DATA names {path.name!r}, which is not a folder")
    return path
