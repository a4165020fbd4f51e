"""What a recorded track is once it has been read: plain values, no file format."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from .._arrays import Array
from ..errors import UfirextError
from .frame import LocalFrame

__all__ = ["Integers", "LeftOut", "Mask", "Progress", "Texts", "Track", "UnusableTrack", "silent"]

Mask = NDArray[np.bool_]
Integers = NDArray[np.int64]
Texts = NDArray[np.bytes_]


class UnusableTrack(UfirextError):
    """A file from which no track can be read, or to which none can be written."""


class LeftOut(NamedTuple):
    """A row that was not used: where it stands in the file, the kind of fault, and what was found."""

    line: int
    fault: str
    found: str


class Progress(Protocol):
    """Told now and then how far a long piece of work has come."""

    def __call__(self, stage: str, done: int, total: int) -> None:
        """`done` of `total` units of `stage` are behind us."""


def silent(stage: str, done: int, total: int) -> None:
    """The Progress that says nothing."""


@dataclass(frozen=True)
class Track:
    """Positions over time, in order of arrival.

    Attributes
    ----------
    path : Path
    seconds : ndarray, (n,)
        Time of arrival, s; strictly increasing, or not decreasing where rows carry a delay.
    position : ndarray, (n, 2)
        m, in the plane named by `axes`.
    axes : tuple of str
        ("east", "north") or ("x", "y").
    lines : ndarray, (n,)
        Line in the file (GPX: number of the point), from 1.
    age : ndarray, (n,), or None
        How old each measurement was on arrival, in `age_unit`.
    age_unit : {"s", "steps"}
    truth : ndarray, (n, 2), or None
        Reference positions in the same plane, NaN where there is none.
    frame : LocalFrame or None
        Ties the plane to latitude and longitude, where the file does.
    breaks : ndarray of int
        Rows, past the first, at which a new segment of the file begins: nothing is known of the way there.
    tracks : dict
        Row at which a track of a GPX file begins -> its name, None where it has none.
    epoch : bool
        Whether `seconds` count from 1970-01-01T00:00:00Z.
    dates : bool
        Whether the file writes its stamps as dates.
    counted : {"line", "point"}
        What `lines` counts.
    rows_read : int
    left_out : list of LeftOut
    notes : list of str
        What a reader of the result ought to know about the file.
    """

    path: Path
    seconds: Array
    position: Array
    axes: tuple[str, str]
    lines: Integers
    age: Array | None = None
    age_unit: str = "s"
    truth: Array | None = None
    frame: LocalFrame | None = None
    breaks: Integers = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    tracks: dict[int, str | None] = field(default_factory=dict)
    epoch: bool = False
    dates: bool = False
    counted: str = "line"
    rows_read: int = 0
    left_out: list[LeftOut] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.seconds)

    def latlon(self, position: Array) -> Array | None:
        """Latitude and longitude (n, 2), degrees, of positions in the plane; None without a frame."""
        return None if self.frame is None else self.frame.to_latlon(np.asarray(position, dtype=float))
