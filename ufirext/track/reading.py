"""A file to a Track: whichever format it has, in order, in metres."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .._arrays import Array
from .csvfile import Table, read_table
from .frame import LocalFrame
from .gpxfile import read_gpx
from .series import Integers, LeftOut, Mask, Progress, Track, UnusableTrack, silent
from .stamps import in_order

__all__ = ["read_track"]


def read_track(
    path: str | Path,
    columns: Mapping[str, str] | None = None,
    progress: Progress = silent,
    *,
    delay_unit: str = "",
) -> Track:
    """Read a recorded track from a CSV or GPX file.

    Rows that cannot be used are left out, each with its line and the reason in `left_out`; rows whose stamps
    repeat or run backward are among them.

    Parameters
    ----------
    path : path
        A GPX file by its suffix or its first bytes, else a table of delimited text with named columns.
    columns : mapping, optional
        Names of columns where they should not be found by their usual names: the keys "time", "x", "y",
        "lat", "lon", "delay", "truth_x", "truth_y", "truth_lat", "truth_lon".
    progress : Progress, optional
    delay_unit : {"", "s", "steps"}
        Unit of the delay column; "" reads it off the name, seconds unless that ends in "steps".

    Returns
    -------
    Track

    Raises
    ------
    UnusableTrack
        When there is no such file, it cannot be read, or no row of it can be used.
    """
    path = Path(path)
    _require_file(path)
    try:
        parts = (
            _from_gpx(path) if _is_gpx(path) else _from_table(read_table(path, columns or {}, progress), path)
        )
    except OSError as error:
        raise UnusableTrack(f"{path}: {error.strerror or error}") from error
    parts.age_unit = delay_unit or parts.age_unit
    return _ordered(path, parts)


@dataclass
class _Parts:
    """A track before its rows are put in order."""

    seconds: Array
    position: Array
    axes: tuple[str, str]
    lines: Integers
    frame: LocalFrame | None
    epoch: bool
    dates: bool
    rows_read: int
    left_out: list[LeftOut]
    age: Array | None = None
    age_unit: str = "s"
    truth: Array | None = None
    notes: list[str] = field(default_factory=list)


def _require_file(path: Path) -> None:
    if path.is_dir():
        raise UnusableTrack(f"{path}: a directory, not a file")
    if not path.exists():
        raise UnusableTrack(f"{path}: no such file")


def _is_gpx(path: Path) -> bool:
    if path.suffix.lower() == ".gpx":
        return True
    with path.open("rb") as file:
        return b"<gpx" in file.read(2048)


def _from_gpx(path: Path) -> _Parts:
    seconds, latlon, lines, rows_read, left_out = read_gpx(path)
    _require_rows(seconds, path, rows_read, left_out)
    frame = LocalFrame(float(latlon[0, 0]), float(latlon[0, 1]))
    position = frame.to_plane(latlon)
    return _Parts(seconds, position, ("east", "north"), lines, frame, True, True, rows_read, left_out)


def _from_table(table: Table, path: Path) -> _Parts:
    values = table.columns
    _require_rows(values["time"], path, table.rows_read, table.left_out)
    position, frame, notes = _plane(values)
    truth, truth_notes = _truth(values, frame)
    return _Parts(
        seconds=values["time"],
        position=position,
        axes=("x", "y") if frame is None and table.names["x"][0] in "xp" else ("east", "north"),
        lines=table.lines,
        frame=frame,
        epoch=table.clock.epoch,
        dates=table.clock.kind == "date",
        rows_read=table.rows_read,
        left_out=table.left_out,
        age=values.get("delay"),
        age_unit="steps" if table.names.get("delay", "").endswith("steps") else "s",
        truth=truth,
        notes=notes + truth_notes,
    )


def _require_rows(seconds: Array, path: Path, rows_read: int, left_out: list[LeftOut]) -> None:
    if len(seconds):
        return
    first = min(left_out)
    raise UnusableTrack(
        f"{path}: none of its {rows_read} rows can be used; "
        f"the first, line {first.line}: {first.fault} ({first.found})"
    )


def _pair(values: Mapping[str, Array], first: str, second: str) -> Array | None:
    return np.column_stack([values[first], values[second]]) if first in values else None


def _plane(values: Mapping[str, Array]) -> tuple[Array, LocalFrame | None, list[str]]:
    """Positions in metres; columns in metres win over degrees where both say the same."""
    latlon, plane = _pair(values, "lat", "lon"), _pair(values, "x", "y")
    if latlon is None and plane is not None:
        return plane, None, []
    if latlon is not None and plane is not None:
        frame = LocalFrame.through(latlon[0], plane[0])
        apart = np.linalg.norm(frame.to_plane(latlon) - plane, axis=1)
        span = float(np.ptp(plane, axis=0).max())
        if float(np.median(apart)) <= 1.0 + 0.01 * span:
            return plane, frame, []
    if latlon is None:  # for the type checker: find_columns has made sure of one pair
        raise UnusableTrack("no position columns")
    frame = LocalFrame(float(latlon[0, 0]), float(latlon[0, 1]))
    note = "the columns in metres do not agree with latitude and longitude; these were used"
    return frame.to_plane(latlon), frame, [note] if plane is not None else []


def _truth(values: Mapping[str, Array], frame: LocalFrame | None) -> tuple[Array | None, list[str]]:
    truth = _pair(values, "truth_x", "truth_y")
    if truth is not None:
        if "x" in values or frame is None:
            return truth, []
        return None, ["truth in metres was not used: the measured positions are in degrees only"]
    latlon = _pair(values, "truth_lat", "truth_lon")
    if latlon is None:
        return None, []
    if frame is None:
        return None, ["truth in degrees was not used: the measured positions are in metres only"]
    return frame.to_plane(latlon), []


def _ordered(path: Path, parts: _Parts) -> Track:
    """The track with its rows in order of time; the others join those left out."""
    seconds, notes = parts.seconds, list(parts.notes)
    rows = np.arange(len(seconds))
    steps = np.diff(seconds)
    if (steps < 0).sum() > 2 * (steps > 0).sum():
        rows = rows[::-1]
        notes.append("the file runs backward in time; it was read from its end")
    keep = in_order(seconds[rows], strictly=parts.age is None)
    if parts.age is not None:
        keep &= ~_repeats(np.column_stack([seconds, parts.age, parts.position])[rows])
    left_out = parts.left_out + _disorder(seconds[rows], parts.lines[rows], keep)
    rows = rows[keep]
    return Track(
        path=path,
        seconds=seconds[rows],
        position=parts.position[rows],
        axes=parts.axes,
        lines=parts.lines[rows],
        age=None if parts.age is None else parts.age[rows],
        age_unit=parts.age_unit,
        truth=None if parts.truth is None else parts.truth[rows],
        frame=parts.frame,
        epoch=parts.epoch,
        dates=parts.dates,
        rows_read=parts.rows_read,
        left_out=sorted(left_out),
        notes=notes,
    )


def _repeats(table: Array) -> Mask:
    """Mask of the rows that say exactly what an earlier row said."""
    _, first = np.unique(table, axis=0, return_index=True)
    mask = np.ones(len(table), dtype=bool)
    mask[first] = False
    return mask


def _disorder(seconds: Array, lines: Integers, keep: Mask) -> list[LeftOut]:
    """Why the rows that are not kept are out of order."""
    found: list[LeftOut] = []
    newest = np.maximum.accumulate(np.where(keep, seconds, -np.inf))
    for row in np.flatnonzero(~keep).tolist():
        stamp, before = float(seconds[row]), float(newest[row])
        line = int(lines[row])
        if stamp == before:
            found.append(LeftOut(line, "time repeats", f"{stamp:.15g} s, as the row before"))
        elif stamp < before:
            found.append(LeftOut(line, "time runs backward", f"{stamp:.15g} s after {before:.15g} s"))
        else:
            found.append(
                LeftOut(line, "time leaps ahead", f"{stamp:.15g} s, later than the rows that follow")
            )
    return found
