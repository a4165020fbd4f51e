"""Estimates to a CSV or GPX file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from .._arrays import Array
from .gpxfile import write_gpx
from .run import Estimates
from .series import LeftOut, Progress, Track, UnusableTrack, silent

__all__ = ["default_output", "require_format", "write_left_out", "write_track"]

_CHUNK = 50_000


def default_output(source: Path) -> Path:
    """Where a result goes when nobody says: to the current folder, in the format of its source."""
    return Path(f"{source.stem}_filtered{'.gpx' if source.suffix.lower() == '.gpx' else '.csv'}")


def require_format(path: Path, track: Track) -> None:
    """Raise UnusableTrack when a file of this suffix cannot hold what the track has."""
    if path.suffix.lower() == ".gpx" and track.frame is None:
        raise UnusableTrack(f"{path}: GPX needs latitude and longitude, {track.path} has metres only")


def write_track(path: Path, track: Track, estimates: Estimates, progress: Progress = silent) -> None:
    """Write a row for every row of the track: time, position, velocity and their standard deviations.

    The format is that of the suffix, .csv or .gpx. GPX needs a track that has latitude and longitude.
    """
    require_format(path, track)
    latlon = track.latlon(estimates.position)
    try:
        if path.suffix.lower() == ".gpx" and latlon is not None:
            extras = {**_states(track, estimates), "ready": estimates.ready.astype(float)}
            write_gpx(path, track.seconds, latlon, extras, estimates.starts, track.tracks)
        else:
            _write_csv(path, track, estimates, latlon, progress)
    except OSError as error:
        raise UnusableTrack(f"{path}: cannot be written: {error.strerror or error}") from error


def write_left_out(path: Path, left_out: list[LeftOut]) -> None:
    """Write every row that was left out, with its line and the reason, as CSV."""
    try:
        pd.DataFrame(left_out, columns=list(LeftOut._fields)).to_csv(path, index=False)
    except OSError as error:
        raise UnusableTrack(f"{path}: cannot be written: {error.strerror or error}") from error


def _states(track: Track, estimates: Estimates) -> dict[str, Array]:
    first, second = track.axes
    return {
        f"{first}_m": estimates.position[:, 0],
        f"{second}_m": estimates.position[:, 1],
        f"{first}_std_m": estimates.position_std[:, 0],
        f"{second}_std_m": estimates.position_std[:, 1],
        f"velocity_{first}_mps": estimates.velocity[:, 0],
        f"velocity_{second}_mps": estimates.velocity[:, 1],
        f"velocity_{first}_std_mps": estimates.velocity_std[:, 0],
        f"velocity_{second}_std_mps": estimates.velocity_std[:, 1],
    }


def _write_csv(
    path: Path, track: Track, estimates: Estimates, latlon: Array | None, progress: Progress
) -> None:
    states = _states(track, estimates)
    with path.open("w", encoding="utf-8", newline="") as file:
        for start in range(0, len(track), _CHUNK):
            rows = slice(start, start + _CHUNK)
            columns = {track.counted: track.lines[rows], **_stamps(track, rows)}
            if latlon is not None:
                columns |= {"lat": _digits(latlon[rows, 0], 9), "lon": _digits(latlon[rows, 1], 9)}
            columns |= {name: _digits(values[rows], 4) for name, values in states.items()}
            columns["ready"] = estimates.ready[rows].astype(int)
            pd.DataFrame(columns).to_csv(file, index=False, header=start == 0)
            progress("writing", min(rows.stop, len(track)), len(track))


def _stamps(track: Track, rows: slice) -> dict[str, Array]:
    if not track.dates:
        return {"t_s": _digits(track.seconds[rows], 6)}
    stamps = pd.to_datetime(np.rint(track.seconds[rows] * 1e6), unit="us", utc=True)
    return {"time": stamps.strftime("%Y-%m-%dT%H:%M:%S.%fZ").to_numpy()}


def _digits(values: Array, digits: int) -> Array:
    return np.round(values, digits)
