"""Units that the name of a column ends in: `t_ms`, `east_km`, `Latitude (rad)`."""

from __future__ import annotations

from math import pi
from typing import NamedTuple

__all__ = ["BASE", "DELAY_UNITS", "Unit", "other_quantity", "split_unit"]


def _spelled(factors: dict[str, float]) -> dict[str, float]:
    """One entry for every spelling: the keys list them, apart by blanks."""
    return {spelling: factor for spellings, factor in factors.items() for spelling in spellings.split()}


_TIME = _spelled(
    {
        "s sec secs second seconds": 1.0,
        "ms msec msecs millis millisecond milliseconds": 1e-3,
        "us \u03bcs usec usecs micros microsecond microseconds": 1e-6,
        "ns nsec nsecs nanos nanosecond nanoseconds": 1e-9,
        "min mins minute minutes": 60.0,
        "h hr hrs hour hours": 3600.0,
    }
)
_LENGTH = _spelled(
    {
        "m metre metres meter meters": 1.0,
        "km kilometre kilometres kilometer kilometers": 1e3,
        "cm centimetre centimetres centimeter centimeters": 1e-2,
        "mm millimetre millimetres millimeter millimeters": 1e-3,
        "ft foot feet": 0.3048,
        "yd yard yards": 0.9144,
        "mi mile miles": 1609.344,
        "nmi": 1852.0,
    }
)
_ANGLE = _spelled({"deg degs degree degrees": 1.0, "rad rads radian radians": 180.0 / pi, "e7": 1e-7})

_QUANTITIES: dict[str, dict[str, float]] = {"s": _TIME, "m": _LENGTH, "degrees": _ANGLE, "days": {}}
BASE = {"time": "s", "delay": "s", "x": "m", "y": "m", "lat": "degrees", "lon": "degrees"}
"""Role -> the unit in which its values are kept."""
BASE["date"] = "days"
BASE |= {f"truth_{role}": BASE[role] for role in ("x", "y", "lat", "lon")}
DELAY_UNITS = ("s", "ms", "us", "ns", "min", "h", "steps")
"""What a delay may be told to be in."""


class Unit(NamedTuple):
    """A unit as a name spells it, and how many base units it is worth."""

    name: str
    factor: float


def split_unit(name: str, role: str) -> tuple[str, Unit | None]:
    """The name, its words joined by "_", without a last word that is a unit for this role; and that unit.

    >>> split_unit("east_km", "x")
    ('east', Unit(name='km', factor=1000.0))
    """
    before, _, last = name.rpartition("_")
    factor = _QUANTITIES[BASE[role]].get(last)
    if factor is None and role == "delay" and last in ("steps", "step"):
        return before, Unit("steps", 1.0)
    return (name, None) if factor is None else (before, Unit(last, factor))


def other_quantity(name: str, role: str) -> str | None:
    """The unit that ends the name, where it measures something else than this role does.

    Times do not count for the others: `x_min` may well be the smallest x.
    """
    before, _, last = name.rpartition("_")
    if not before or last in _QUANTITIES[BASE[role]]:
        return None
    others = (table for base, table in _QUANTITIES.items() if base not in (BASE[role], "s"))
    return last if any(last in table for table in others) else None
