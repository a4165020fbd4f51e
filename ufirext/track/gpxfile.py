"""GPX files: points in, points with their velocity and standard deviations out (by gpxpy)."""

from __future__ import annotations

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
    stamps: Texts
    total: int
    left_out: list[LeftOut]


def read_gpx(path: Path) -> Points:
    """All tracks and segments, one after the other. Routes and waypoints are no tracks and are not read."""
    try:
        content = gpxpy.parse(path.read_bytes())
    except (gpxpy.gpx.GPXException, UnicodeDecodeError, ValueError) as error:
        raise UnusableTrack(f"{path}: not a GPX file: {error}") from error
    segments = [segment.points for track in content.tracks for segment in track.segments]
    points: list[tuple[int, Any]] = [
        (part, point) for part, each in enumerate(segments, start=1) for point in each
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
    return Points(table[:, 0], table[:, 1:3], numbers, parts, texts, len(points), left_out)


def _fault(point: Any) -> tuple[str, str] | None:
    """Why a point cannot be used, and what it says."""
    if point.time is None:
        return "no time", "a point without a <time>"
    if abs(point.latitude) > 90 or abs(point.longitude) > 360:
        return "out of range", f"lat {point.latitude:g}, lon {point.longitude:g}"
    if point.latitude == 0 and point.longitude == 0:
        return "no fix (latitude and longitude both 0)", "lat 0, lon 0"
    return None


def write_gpx(path: Path, seconds: Array, latlon: Array, extras: dict[str, Array], breaks: Integers) -> None:
    """One track with a new segment at each row of `breaks`; `extras` go to each point's extensions."""
    content = gpxpy.gpx.GPX()
    content.creator = "ufirext"
    content.nsmap["ufirext"] = _NAMESPACE
    track = gpxpy.gpx.GPXTrack()
    content.tracks.append(track)
    starts = set(breaks.tolist()) | {0}
    for row, (stamp, (lat, lon)) in enumerate(zip(seconds.tolist(), latlon.tolist(), strict=True)):
        if row in starts:
            segment = gpxpy.gpx.GPXTrackSegment()
            track.segments.append(segment)
        point = gpxpy.gpx.GPXTrackPoint(lat, lon, time=_START + timedelta(seconds=stamp))
        for name, values in extras.items():
            if np.isfinite(values[row]):
                element = ElementTree.Element(f"{{{_NAMESPACE}}}{name}")
                element.text = f"{values[row]:.4f}"
                point.extensions.append(element)
        segment.points.append(point)
    path.write_text(content.to_xml(version="1.1"), encoding="utf-8")
