"""GPX files: points in, points with their velocity and standard deviations out (by gpxpy)."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import gpxpy
import gpxpy.gpx
import numpy as np

from .._arrays import Array
from .series import Integers, LeftOut, Texts, UnusableTrack

__all__ = ["Points", "read_gpx", "write_gpx"]

_NAMESPACE = "urn:ufirext:track:1"
_START = datetime(1970, 1, 1, tzinfo=UTC)


class Points(NamedTuple):
    """The points of a file that can be used, in its order.

    Attributes
    ----------
    seconds : ndarray, (n,)
        Since 1970.
    latlon : ndarray, (n, 2)
        Degrees.
    numbers : ndarray, (n,)
        Which point of the file, from 1.
    segments : ndarray, (n,)
        Which of its segments, over all tracks, from 1.
    owners : list
        Of each segment: the number of its track, and the name of that, None where it has none.
    stamps : ndarray, (n,)
        The time in ISO 8601.
    total : int
        Points in the file.
    left_out : list of LeftOut
    """

    seconds: Array
    latlon: Array
    numbers: Integers
    segments: Integers
    owners: list[tuple[int, str | None]]
    stamps: Texts
    total: int
    left_out: list[LeftOut]


def read_gpx(path: Path) -> Points:
    """All tracks and segments, one after the other. Routes and waypoints are no tracks and are not read."""
    try:
        content = gpxpy.parse(path.read_bytes())
    except (gpxpy.gpx.GPXException, UnicodeDecodeError, ValueError) as error:
        raise UnusableTrack(f"{path}: not a GPX file: {error}") from error
    segments = [
        (number, track, each) for number, track in enumerate(content.tracks) for each in track.segments
    ]
    points: list[tuple[int, Any]] = [
        (part, point) for part, (_, _, each) in enumerate(segments, start=1) for point in each.points
    ]
    if not points:
        found = (
            f"{len(content.routes)} routes and {len(content.waypoints)} waypoints, which are not recordings"
        )
        raise UnusableTrack(f"{path}: no track points (<trkpt>); it has {found}")
    left_out: list[LeftOut] = []
    kept: list[tuple[float, float, float, int, int]] = []
    stamps: list[bytes] = []
    for number, (part, point) in enumerate(points, start=1):
        if (fault := _fault(point)) is not None:
            left_out.append(LeftOut(number, *fault))
            continue
        stamp = point.time if point.time.tzinfo is not None else point.time.replace(tzinfo=UTC)
        kept.append(((stamp - _START).total_seconds(), point.latitude, point.longitude, number, part))
        stamps.append(stamp.isoformat().replace("+00:00", "Z").encode())
    table = np.array(kept, dtype=float).reshape(-1, 5)
    numbers, parts = table[:, 3].astype(int), table[:, 4].astype(int)
    texts = np.array(stamps, dtype=np.bytes_)
    owners = [(number, track.name) for number, track, _ in segments]
    return Points(table[:, 0], table[:, 1:3], numbers, parts, owners, texts, len(points), left_out)


def _fault(point: Any) -> tuple[str, str] | None:
    """Why a point cannot be used, and what it says."""
    if point.time is None:
        return "no time", "a point without a <time>"
    if abs(point.latitude) > 90 or abs(point.longitude) > 360:
        return "out of range", f"lat {point.latitude:g}, lon {point.longitude:g}"
    if point.latitude == 0 and point.longitude == 0:
        return "no fix (latitude and longitude both 0)", "lat 0, lon 0"
    return None


def write_gpx(
    path: Path,
    seconds: Array,
    latlon: Array,
    extras: dict[str, Array],
    breaks: Integers,
    tracks: Mapping[int, str | None],
) -> None:
    """A new segment at each row of `breaks`, a new track, with its name, at each of `tracks`.

    `extras` go to each point's extensions.
    """
    content = gpxpy.gpx.GPX()
    content.creator = "ufirext"
    content.nsmap["ufirext"] = _NAMESPACE
    names = {0: None, **tracks}
    starts = {*breaks.tolist(), *names}
    for row, (stamp, (lat, lon)) in enumerate(zip(seconds.tolist(), latlon.tolist(), strict=True)):
        if row in names:
            content.tracks.append(track := gpxpy.gpx.GPXTrack(name=names[row]))
        if row in starts:
            track.segments.append(segment := gpxpy.gpx.GPXTrackSegment())
        point = gpxpy.gpx.GPXTrackPoint(lat, lon, time=_START + timedelta(seconds=stamp))
        for name, values in extras.items():
            if np.isfinite(values[row]):
                element = ElementTree.Element(f"{{{_NAMESPACE}}}{name}")
                element.text = f"{values[row]:.4f}"
                point.extensions.append(element)
        segment.points.append(point)
    path.write_text(content.to_xml(version="1.1"), encoding="utf-8")
