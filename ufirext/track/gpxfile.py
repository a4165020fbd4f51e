"""GPX files: points in, points with their velocity and standard deviations out (by gpxpy)."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from xml.etree import ElementTree

import gpxpy
import gpxpy.gpx
import numpy as np

from .._arrays import Array
from .series import Integers, LeftOut, Texts, UnusableTrack

__all__ = ["read_gpx", "write_gpx"]

_NAMESPACE = "urn:ufirext:track:1"
_START = datetime(1970, 1, 1, tzinfo=UTC)


def read_gpx(path: Path) -> tuple[Array, Array, Integers, Texts, int, list[LeftOut]]:
    """Seconds since 1970, degrees (n, 2), points by number and stamp, how many there are, those left out.

    All tracks and segments, one after the other. Routes and waypoints have no time and are not read.
    """
    try:
        content = gpxpy.parse(path.read_bytes())
    except (gpxpy.gpx.GPXException, UnicodeDecodeError, ValueError) as error:
        raise UnusableTrack(f"{path}: not a GPX file: {error}") from error
    points = [point for track in content.tracks for segment in track.segments for point in segment.points]
    if not points:
        found = f"{len(content.routes)} routes and {len(content.waypoints)} waypoints"
        raise UnusableTrack(f"{path}: no track points (found {found}, which carry no time)")
    left_out: list[LeftOut] = []
    kept: list[tuple[float, float, float, int]] = []
    stamps: list[bytes] = []
    for number, point in enumerate(points, start=1):
        if point.time is None:
            left_out.append(LeftOut(number, "no time", "a point without a <time>"))
        elif abs(point.latitude) > 90 or abs(point.longitude) > 360:
            left_out.append(
                LeftOut(number, "out of range", f"lat {point.latitude:g}, lon {point.longitude:g}")
            )
        elif point.latitude == 0 and point.longitude == 0:
            left_out.append(LeftOut(number, "no fix (latitude and longitude both 0)", "lat 0, lon 0"))
        else:
            stamp = point.time if point.time.tzinfo is not None else point.time.replace(tzinfo=UTC)
            kept.append(((stamp - _START).total_seconds(), point.latitude, point.longitude, number))
            stamps.append(stamp.isoformat().replace("+00:00", "Z").encode())
    table = np.array(kept, dtype=float).reshape(-1, 4)
    texts = np.array(stamps, dtype=np.bytes_)
    return table[:, 0], table[:, 1:3], table[:, 3].astype(int), texts, len(points), left_out


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
