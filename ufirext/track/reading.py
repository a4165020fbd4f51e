"""A file to a Track: whichever format it has, in order, in metres."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from .._arrays import Array
from .columns import plane_is_told
from .csvfile import Table, read_table
from .frame import LocalFrame
from .gpxfile import read_gpx
from .ordering import Parts, ordered
from .series import LeftOut, Progress, Track, UnusableTrack, silent

__all__ = ["read_track"]

_WIDEST = 3e6  # m from the middle row; farther out one plane cannot stand for the globe
_WIDE = 9e5  # m; from here on the plane shortens lengths by more than 0.3 %


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
        "lat", "lon", "delay", "truth_x", "truth_y", "truth_lat", "truth_lon". A name that ends in a unit
        (t_ms, east_km, lat_rad) is heeded: values are converted, and a note says so.
    progress : Progress, optional
    delay_unit : {"", "s", "ms", "us", "ns", "min", "h", "steps"}
        Unit of the delay column; "" reads it off the end of the name, seconds where that says none.

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
        if _is_gpx(path):
            parts = _from_gpx(path)
        else:
            told = columns or {}
            table = read_table(path, told, progress, delay_unit=delay_unit)
            parts = _from_table(table, path, plane_is_told(told))
    except OSError as error:
        raise UnusableTrack(f"{path}: {error.strerror or error}") from error
    return ordered(path, parts)


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


def _require_rows(rows: int, path: Path, rows_read: int, left_out: list[LeftOut], counted: str) -> None:
    if rows:
        return
    first = min(left_out)
    raise UnusableTrack(
        f"{path}: none of its {rows_read} rows can be used; "
        f"the first, {counted} {first.line}: {first.fault} ({first.found})"
    )


def _from_gpx(path: Path) -> Parts:
    points = read_gpx(path)
    _require_rows(len(points.seconds), path, points.total, points.left_out, "point")
    frame = _frame(points.latlon)
    parts = Parts(
        seconds=points.seconds,
        position=frame.to_plane(points.latlon),
        axes=("east", "north"),
        lines=points.numbers,
        stamps=points.stamps,
        frame=frame,
        epoch=True,
        dates=True,
        counted="point",
        rows_read=points.total,
        left_out=points.left_out,
        segments=points.segments,
        owners=points.owners,
    )
    _leave_out_far(parts, points.latlon)
    return parts


def _from_table(table: Table, path: Path, plane_told: bool) -> Parts:
    values = table.columns
    _require_rows(len(table.lines), path, table.rows_read, table.left_out, "line")
    latlon, plane = _pair(values, "lat", "lon"), _pair(values, "x", "y")
    frame: LocalFrame | None = None
    notes = list(table.notes)
    if plane is not None and latlon is not None:
        # columns in metres win where both say the same: truth, if any, is in their frame
        frame = _common(latlon, plane)
        if frame is None and plane_told:
            notes.append("latitude and longitude do not agree with the named columns and were not used")
        elif frame is None:
            notes.append("the columns in metres do not agree with latitude and longitude and were not used")
            plane = None
    if plane is None and latlon is not None:
        frame = _frame(latlon)
    metric = plane is not None
    if plane is None:
        if frame is None or latlon is None:
            raise UnusableTrack(f"{path}: no position columns")
        plane = frame.to_plane(latlon)
    truth, truth_notes = _truth(values, frame, metric)
    parts = Parts(
        seconds=values["time"],
        position=plane,
        axes=("x", "y") if frame is None and table.names["x"][0] in "xp" else ("east", "north"),
        lines=table.lines,
        stamps=table.stamps,
        zoneless=table.zoneless,
        frame=frame,
        epoch=table.clock.epoch,
        dates=table.clock.kind == "date",
        counted="line",
        rows_read=table.rows_read,
        left_out=table.left_out,
        age=values.get("delay"),
        age_unit=table.age_unit,
        truth=truth,
        notes=notes + truth_notes,
    )
    if latlon is not None and not metric:
        _leave_out_far(parts, latlon)
    return parts


def _pair(values: Mapping[str, Array], first: str, second: str) -> Array | None:
    return np.column_stack([values[first], values[second]]) if first in values else None


def _frame(latlon: Array) -> LocalFrame:
    """The plane at the first row that is not far from the middle one."""
    middle = LocalFrame(*latlon[len(latlon) // 2].tolist())
    near = np.flatnonzero(middle.distance(latlon) <= _WIDEST)
    return LocalFrame(*latlon[near[0]].tolist())


def _leave_out_far(parts: Parts, latlon: Array) -> None:
    """Rows too far from the others to share a plane with them, and a note where it is a wide one."""
    middle = LocalFrame(*latlon[len(latlon) // 2].tolist())
    distance = middle.distance(latlon)
    for row in np.flatnonzero(distance > _WIDEST).tolist():
        found = f"{distance[row] / 1000:.0f} km from the middle row"
        parts.left_out.append(LeftOut(int(parts.lines[row]), "too far away for one plane", found))
    near = distance <= _WIDEST
    parts.keep(near)
    if (width := float(distance[near].max())) > _WIDE:
        parts.notes.append(f"{width / 1000:.0f} km wide: the local plane shortens lengths far out")


def _common(latlon: Array, plane: Array) -> LocalFrame | None:
    """The frame in which degrees and metres say the same, where there is one."""
    fix = (np.abs(latlon) <= [90.0, 360.0]).all(axis=1) & (latlon != 0.0).any(axis=1)
    if not fix.any():
        return None
    latlon, plane = latlon[fix], plane[fix]
    frame = LocalFrame.through(latlon[0], plane[0])
    apart = float(np.median(np.linalg.norm(frame.to_plane(latlon) - plane, axis=1)))
    return frame if apart <= 1.0 + 0.01 * float(np.ptp(plane, axis=0).max()) else None


def _truth(
    values: Mapping[str, Array], frame: LocalFrame | None, metric: bool
) -> tuple[Array | None, list[str]]:
    """True positions in the plane of the measured ones."""
    truth, latlon = _pair(values, "truth_x", "truth_y"), _pair(values, "truth_lat", "truth_lon")
    if truth is not None and metric:
        return truth, []
    if latlon is not None and frame is not None:
        return frame.to_plane(latlon), []
    if truth is not None:
        return None, ["truth in metres was not used: the measured positions are in degrees"]
    if latlon is not None:
        return None, ["truth in degrees was not used: the measured positions are in metres"]
    return None, []
