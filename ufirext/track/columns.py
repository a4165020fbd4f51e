"""Which column of a table holds what: by name, whatever the spelling, or as told."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from .series import UnusableTrack

__all__ = ["ROLES", "Columns", "find_columns", "normalised"]

Columns = dict[str, int]
"""Role -> index of its column."""

# Spellings seen in the wild, lower case, words joined by "_"; the first that is present wins.
_EAST = (
    "east_m",
    "east",
    "easting",
    "easting_m",
    "e",
    "e_m",
    "x_m",
    "x",
    "pos_x",
    "position_x",
    "utm_easting",
)
_NORTH = (
    "north_m",
    "north",
    "northing",
    "northing_m",
    "n",
    "n_m",
    "y_m",
    "y",
    "pos_y",
    "position_y",
    "utm_northing",
)
_LAT = ("lat", "latitude", "lat_deg", "latitude_deg", "position_lat", "gps_lat", "gps_latitude")
_LON = (
    "lon",
    "longitude",
    "lng",
    "long",
    "lon_deg",
    "longitude_deg",
    "position_long",
    "gps_lon",
    "gps_longitude",
)
ROLES: dict[str, tuple[str, ...]] = {
    "time": (
        *(
            "t_s",
            "time_s",
            "timestamp_s",
            "t",
            "time",
            "timestamp",
            "datetime",
            "date_time",
            "utc",
            "time_utc",
        ),
        *(
            "utc_time",
            "gps_time",
            "epoch",
            "unix",
            "unix_time",
            "seconds",
            "sec",
            "secs",
            "elapsed",
            "elapsed_s",
        ),
        *(
            "t_ms",
            "time_ms",
            "timestamp_ms",
            "t_us",
            "time_us",
            "timestamp_us",
            "t_ns",
            "time_ns",
            "timestamp_ns",
        ),
    ),
    "lat": _LAT,
    "lon": _LON,
    "x": _EAST,
    "y": _NORTH,
    "delay": ("delay_s", "delay_steps", "delay", "age_s", "age", "latency_s", "latency"),
}
for _role, _names in (("lat", _LAT), ("lon", _LON), ("x", _EAST), ("y", _NORTH)):
    ROLES[f"truth_{_role}"] = tuple(
        f"{prefix}_{name}" for prefix in ("truth", "true", "gt", "ground_truth") for name in _names
    )


def normalised(name: str) -> str:
    """`Time (s)`, ` time_s `, `Time [s]` and `TIME-S` are one name."""
    words = re.findall(r"[^\W_]+", name.casefold())
    return "_".join(words)


def find_columns(header: Sequence[str], told: Mapping[str, str], path: object) -> Columns:
    """Index of the column of every role the header has.

    Raises UnusableTrack when a column that was asked for is missing or named twice, when there is no time,
    or when no pair of columns gives positions.
    """
    names = [normalised(name) for name in header]
    found: Columns = {}
    for role, spellings in ROLES.items():
        wanted = (normalised(told[role]),) if role in told else spellings
        for name in wanted:
            if name and names.count(name) > 1:
                raise UnusableTrack(f"{path}: two columns are named {name!r}; rename one")
            if name in names:
                found[role] = names.index(name)
                break
        else:
            if role in told:
                raise UnusableTrack(f"{path}: no column {told[role]!r} for {role}; it has {_listed(header)}")
    if "time" not in found:
        raise UnusableTrack(f"{path}: no time column; it has {_listed(header)}; name it with --time")
    _require_positions(found, told, header, path)
    return found


def _require_positions(found: Columns, told: Mapping[str, str], header: Sequence[str], path: object) -> None:
    for pair in (("lat", "lon"), ("x", "y"), ("truth_lat", "truth_lon"), ("truth_x", "truth_y")):
        present = [role for role in pair if role in found]
        if len(present) == 1:
            missing = next(role for role in pair if role not in found)
            if present[0] in told:
                raise UnusableTrack(
                    f"{path}: --{present[0].replace('_', '-')} without a column for {missing}"
                )
            del found[present[0]]
    if "x" in found and "lat" in found and ("lat" in told or "lon" in told) and "x" not in told:
        del found["x"], found["y"]
    if "x" not in found and "lat" not in found:
        raise UnusableTrack(
            f"{path}: no position columns (lat and lon in degrees, or east and north, or x and y, in metres)"
            f"; it has {_listed(header)}; name them with --lat --lon or --x --y"
        )


def _listed(header: Sequence[str], most: int = 12) -> str:
    shown = ", ".join(repr(name.strip()[:30]) for name in header[:most])
    return shown + (f" and {len(header) - most} more" if len(header) > most else "")
