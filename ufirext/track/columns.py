"""Which column of a table holds what: by name, whatever the spelling, or as told."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from .series import UnusableTrack
from .units import BASE, other_quantity, split_unit

__all__ = ["ROLES", "Columns", "find_columns", "normalised", "plane_is_told", "unused_delays"]

Columns = dict[str, int]
"""Role -> index of its column."""

# Spellings seen in the wild, lower case, words joined by "_"; the first that is present wins. Where none is,
# one of them with another unit after it does: `t_ms`, `east_km`.
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
    ),
    "date": ("date", "date_utc", "utc_date", "gps_date", "local_date"),
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
    for role in ROLES:
        name = _told(role, told[role], names, header, path) if role in told else _usual(role, names)
        if name is None:
            continue
        if names.count(name) > 1:
            raise UnusableTrack(f"{path}: two columns are named {name!r}; rename one")
        found[role] = names.index(name)
    if "time" not in found:
        raise UnusableTrack(f"{path}: no time column; it has {_listed(header)}; name it with --time")
    if found.get("date") == found["time"]:
        del found["date"]
    _require_positions(found, told, header, path)
    return found


def _told(role: str, told: str, names: Sequence[str], header: Sequence[str], path: object) -> str:
    """The column that was asked for; its name must not say that it holds something else."""
    name, option = normalised(told), f"--{role.replace('_', '-')}"
    if not name or name not in names:
        raise UnusableTrack(f"{path}: no column {told!r} for {role}; it has {_listed(header)}")
    if (unit := other_quantity(name, role)) is not None:
        raise UnusableTrack(
            f"{path}: {option} {told!r}: its name ends in {unit}; {option} takes {BASE[role]}, "
            "or another unit of that kind at the end of the name"
        )
    return name


def _usual(role: str, names: Sequence[str]) -> str | None:
    """The column with a usual name, if there is one."""
    bare = {split_unit(name, role)[0]: name for name in reversed(names)}
    usual = (name for name in ROLES[role] if name in names)
    return next(usual, next((bare[name] for name in ROLES[role] if name in bare), None))


def plane_is_told(told: Mapping[str, str], prefix: str = "") -> bool:
    """Whether the columns in metres were asked for, and those in degrees were not."""

    def named(*roles: str) -> bool:
        return any(f"{prefix}{role}" in told for role in roles)

    return named("x", "y") and not named("lat", "lon")


def unused_delays(header: Sequence[str], used: int | None) -> list[str]:
    """Headings that look like a delay, of columns other than `used`."""
    return [
        name.strip()
        for place, name in enumerate(header)
        if place != used and _DELAY.match(normalised(name)) is not None
    ]


_DELAY = re.compile(r"delay|latenc|ages?(ms|us|ns)?(_|$)")


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
    for prefix in ("", "truth_"):
        x, y, lat, lon = (f"{prefix}{each}" for each in ("x", "y", "lat", "lon"))
        if x in found and lat in found and (lat in told or lon in told) and x not in told and y not in told:
            del found[x], found[y]
    if "truth_lat" in found and plane_is_told(told, "truth_"):
        del found["truth_lat"], found["truth_lon"]
    if "x" not in found and "lat" not in found:
        raise UnusableTrack(
            f"{path}: no position columns (lat and lon in degrees, or east and north, or x and y, in metres)"
            f"; it has {_listed(header)}; name them with --lat --lon or --x --y"
        )


def _listed(header: Sequence[str], most: int = 12) -> str:
    shown = ", ".join(repr(name.strip()[:30]) for name in header[:most])
    return shown + (f" and {len(header) - most} more" if len(header) > most else "")
