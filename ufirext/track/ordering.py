"""The rows of a file put in order of time, those that cannot be left out with the reason."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .._arrays import Array
from .frame import LocalFrame
from .series import Integers, LeftOut, Mask, Texts, Track
from .stamps import in_order

__all__ = ["Parts", "ordered"]

_HOUR = 3600.0  # s


@dataclass
class Parts:
    """A track before its rows are put in order; `stamps` as the file writes them, the rest as in Track."""

    seconds: Array
    position: Array
    axes: tuple[str, str]
    lines: Integers
    stamps: Texts
    frame: LocalFrame | None
    epoch: bool
    dates: bool
    counted: str
    rows_read: int
    left_out: list[LeftOut]
    age: Array | None = None
    age_unit: str = "s"
    truth: Array | None = None
    zoneless: int = 0
    notes: list[str] = field(default_factory=list)

    def keep(self, rows: Mask | Integers) -> None:
        """Reduce to `rows`, in their order."""
        self.seconds, self.position = self.seconds[rows], self.position[rows]
        self.lines, self.stamps = self.lines[rows], self.stamps[rows]
        self.age = None if self.age is None else self.age[rows]
        self.truth = None if self.truth is None else self.truth[rows]

    def said(self, row: int) -> str:
        """The stamp of a row as the file writes it."""
        return str(self.stamps[row].decode(errors="replace"))


def ordered(path: Path, parts: Parts) -> Track:
    """The track with its rows in order of time; the others join those left out."""
    steps = np.diff(parts.seconds)
    if (steps < 0).sum() > 2 * (steps > 0).sum():
        parts.keep(np.arange(len(parts.seconds))[::-1])
        parts.notes.append("the file runs backward in time; it was read from its end")
    if parts.zoneless:
        parts.notes += _about_zones(parts)
    keep = in_order(parts.seconds, strictly=parts.age is None)
    if parts.age is not None:
        keep &= ~_repeats(np.column_stack([parts.seconds, parts.age, parts.position]))
    left_out = parts.left_out + _disorder(parts, keep)
    parts.keep(keep)
    return Track(
        path=path,
        seconds=parts.seconds,
        position=parts.position,
        axes=parts.axes,
        lines=parts.lines,
        age=parts.age,
        age_unit=parts.age_unit,
        truth=parts.truth,
        frame=parts.frame,
        epoch=parts.epoch,
        dates=parts.dates,
        counted=parts.counted,
        rows_read=parts.rows_read,
        left_out=sorted(left_out),
        notes=parts.notes,
    )


def _repeats(table: Array) -> Mask:
    """Mask of the rows that say exactly what an earlier row said."""
    _, first = np.unique(table, axis=0, return_index=True)
    mask = np.ones(len(table), dtype=bool)
    mask[first] = False
    return mask


def _disorder(parts: Parts, keep: Mask) -> list[LeftOut]:
    """Why the rows that are not kept are out of order, in the words of the file."""
    found: list[LeftOut] = []
    kept = np.where(keep, parts.seconds, -np.inf)
    newest = np.maximum.accumulate(kept)
    last = np.maximum.accumulate(np.where(keep, np.arange(len(keep)), 0))
    for row in np.flatnonzero(~keep).tolist():
        stamp, before, line = parts.seconds[row], newest[row], int(parts.lines[row])
        said = parts.said(row)
        if stamp == before:
            found.append(LeftOut(line, "time repeats", f"{said}, as the row before"))
        elif stamp < before:
            found.append(LeftOut(line, "time runs backward", f"{said} after {parts.said(int(last[row]))}"))
        else:
            found.append(LeftOut(line, "time leaps ahead", f"{said}, later than the rows that follow"))
    return found


def _about_zones(parts: Parts) -> list[str]:
    """Notes of stamps without a zone, and of an hour that comes twice among them."""
    rows = len(parts.seconds)
    some = "time stamps" if parts.zoneless >= rows else f"{parts.zoneless:,} of {rows:,} time stamps"
    notes = [f"{some} without a zone are taken as UTC"]
    steps = np.diff(parts.seconds)
    forward = steps[steps > 0]
    usual = float(np.median(forward)) if len(forward) else 0.0
    # the clock went back by an hour between two rows that are a usual step apart
    back = np.flatnonzero((steps < 0) & (np.abs(steps - usual + _HOUR) <= max(0.5 * usual, 1.0)))
    if usual < _HOUR / 2 and len(back):
        row = int(back[0]) + 1
        between = f"{parts.said(row - 1)}, then {parts.said(row)}"
        notes.append(
            f"at {parts.counted} {parts.lines[row]} the time goes back by one hour ({between}): local time "
            "at the end of daylight saving? Stamps in UTC would lose no rows"
        )
    return notes
