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
_OVERLAP = "time overlaps another segment"


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
    segments: Integers | None = None
    owners: list[tuple[int, str | None]] = field(default_factory=list)
    zoneless: int = 0
    notes: list[str] = field(default_factory=list)

    def keep(self, rows: Mask | Integers) -> None:
        """Reduce to `rows`, in their order."""
        self.seconds, self.position = self.seconds[rows], self.position[rows]
        self.lines, self.stamps = self.lines[rows], self.stamps[rows]
        self.age = None if self.age is None else self.age[rows]
        self.truth = None if self.truth is None else self.truth[rows]
        self.segments = None if self.segments is None else self.segments[rows]

    def said(self, row: int) -> str:
        """The stamp of a row as the file writes it."""
        return str(self.stamps[row].decode(errors="replace"))


def ordered(path: Path, parts: Parts) -> Track:
    """The track with its rows in order of time; the others join those left out."""
    steps = np.diff(parts.seconds)
    if (steps < 0).sum() > 2 * (steps > 0).sum():
        parts.keep(np.arange(len(parts.seconds))[::-1])
        parts.notes.append("the file runs backward in time; it was read from its end")
    if parts.segments is not None:
        _order_segments(parts, parts.segments)
    if parts.zoneless:
        parts.notes += _about_zones(parts)
    keep = in_order(parts.seconds, strictly=parts.age is None)
    if parts.age is not None:
        keep &= ~_repeats(np.column_stack([parts.seconds, parts.age, parts.position]))
    disorder = _disorder(parts, keep)
    parts.notes += _overlaps(parts, sum(each.fault == _OVERLAP for each in disorder))
    left_out = parts.left_out + disorder
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
        breaks=_breaks(parts.segments),
        tracks=_tracks(parts),
        notes=parts.notes,
    )


def _order_segments(parts: Parts, segments: Integers) -> None:
    """Put the segments of a file in order of their first stamps."""
    _, first, inverse = np.unique(segments, return_index=True, return_inverse=True)
    order = np.lexsort([segments, parts.seconds[first][inverse]])
    if np.any(np.diff(order) != 1):
        parts.keep(order)
        parts.notes.append("the segments of the file were put in order of time")


def _breaks(segments: Integers | None) -> Integers:
    """Rows at which another segment begins."""
    if segments is None:
        return np.zeros(0, dtype=np.int64)
    return 1 + np.flatnonzero(np.diff(segments))


def _tracks(parts: Parts) -> dict[int, str | None]:
    """Rows at which another track begins, with its name."""
    if parts.segments is None:
        return {}
    found: dict[int, str | None] = {}
    before = None
    for row in (0, *_breaks(parts.segments).tolist()):
        owner = parts.owners[parts.segments[row] - 1]
        if owner != before:
            before, found[row] = owner, owner[1]
    return found


def _overlaps(parts: Parts, lost: int) -> list[str]:
    """A note of the segments that run at the same time as one before them, where that cost rows."""
    if parts.segments is None or not lost:
        return []
    starts = np.concatenate([[0], _breaks(parts.segments)])
    newest = np.maximum.accumulate(np.maximum.reduceat(parts.seconds, starts))
    oldest = np.minimum.reduceat(parts.seconds, starts)
    numbers = parts.segments[starts[1:]][oldest[1:] <= newest[:-1]].tolist()
    which = ", ".join(map(str, numbers[:5])) + (f" and {len(numbers) - 5} more" if len(numbers) > 5 else "")
    return [
        f"segment {which} of the file overlaps an earlier one in time: a track is in one place at a time, "
        f"and {lost:,} points were left out; recordings of their own belong in files of their own"
    ]


def _repeats(table: Array) -> Mask:
    """Mask of the rows that say exactly what an earlier row said."""
    _, first = np.unique(table, axis=0, return_index=True)
    mask = np.ones(len(table), dtype=bool)
    mask[first] = False
    return mask


def _disorder(parts: Parts, keep: Mask) -> list[LeftOut]:
    """Why the rows that are not kept are out of order, in the words of the file."""
    found: list[LeftOut] = []
    kept = np.flatnonzero(keep)
    after = np.searchsorted(kept, np.flatnonzero(~keep)).tolist()  # place of the next row that is kept
    for row, place in zip(np.flatnonzero(~keep).tolist(), after, strict=True):
        line, stamp, said = int(parts.lines[row]), parts.seconds[row], parts.said(row)
        last, following = int(kept[max(place - 1, 0)]), int(kept[min(place, len(kept) - 1)])
        before = parts.seconds[last] if place else -np.inf
        other = last if stamp <= before else following
        if parts.segments is not None and parts.segments[row] != parts.segments[other]:
            which = f"{said}, but segment {parts.segments[other]} is at {parts.said(other)} by then"
            found.append(LeftOut(line, _OVERLAP, which))
        elif stamp == before:
            found.append(LeftOut(line, "time repeats", f"{said}, as the row before"))
        elif stamp < before:
            found.append(LeftOut(line, "time runs backward", f"{said} after {parts.said(last)}"))
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
