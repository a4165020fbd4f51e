"""A table of text, row by row: what each row says, or why it says nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np

from .._arrays import Array
from .columns import Columns, find_columns, normalised, plane_is_told, unused_delays
from .fields import encoding_of, header_of, place_in, rows_of
from .series import Integers, LeftOut, Mask, Progress, Texts, UnusableTrack, silent
from .stamps import Clock, joined, leap_second, numbers, past_midnight, without_zone
from .units import BASE, Unit, split_unit

__all__ = ["Table", "read_table"]

_BLOCK = 50_000
_FARTHEST = 1e9  # m; beyond the moon a number is not a position
_LATEST = 1e12  # s; nor is it a time after 30 000 years


@dataclass
class Table:
    """The usable rows of a file as columns of numbers, in file order.

    Attributes
    ----------
    columns : dict
        Role -> values (n,); "time" in seconds.
    lines : ndarray, (n,)
        Line in the file, from 1.
    stamps : ndarray, (n,)
        The time of each row as the file writes it, UTF-8.
    clock : Clock
    names : dict
        Role -> heading of its column.
    rows_read : int
    left_out : list of LeftOut
    age_unit : {"s", "steps"}
    zoneless : int
        Rows whose stamp is a date without a zone.
    notes : list of str
    """

    columns: dict[str, Array]
    lines: Integers
    stamps: Texts
    clock: Clock
    names: dict[str, str]
    rows_read: int
    left_out: list[LeftOut]
    age_unit: str = "s"
    zoneless: int = 0
    notes: list[str] = field(default_factory=list)


@dataclass
class _Layout:
    """What the head of the file tells about the rest."""

    width: int
    columns: Columns
    names: dict[str, str]
    decimal_comma: bool
    units: dict[str, Unit]
    plane_told: bool
    told: str = ""  # the role whose unit was told
    clock: Clock | None = None
    dated: bool = False  # whether the dates of the times stand in a column of their own
    zoneless: int = 0
    left_out: list[LeftOut] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def factor(self, role: str) -> float:
        """What to multiply the numbers of a column by."""
        return self.units[role].factor if role in self.units else 1.0


def read_table(
    path: Path, told: Mapping[str, str], progress: Progress = silent, *, delay_unit: str = ""
) -> Table:
    """Read a table of delimited text whose first line names the columns.

    Comma, semicolon, tab or bar between the fields; decimal commas where the comma does not separate;
    UTF-8 or UTF-16, with or without a byte order mark; lines that start with "#" are comments.
    """
    encoding = encoding_of(path)
    size = max(path.stat().st_size, 1)
    blocks: list[tuple[dict[str, Array], Integers, Texts]] = []
    with path.open(encoding=encoding, errors="replace", newline=None) as file:
        header, delimiter, first = header_of(file, path)
        layout = _layout(header, delimiter, told, path, delay_unit)
        rows = rows_of(file, delimiter, first)
        rows_read = 0
        while block := list(islice(rows, _BLOCK)):
            rows_read += len(block)
            blocks.append(_parsed(block, layout))
            progress("reading", min(place_in(file), size), size)
    if not rows_read:
        raise UnusableTrack(f"{path}: only a header, no rows")
    clock = layout.clock or Clock("number")
    values, lines, stamps = zip(*blocks, strict=True)
    columns = {role: np.concatenate([each[role] for each in values]) for role in values[0]}
    if clock.kind == "clock":
        columns["time"] = past_midnight(columns["time"])
    return Table(
        columns,
        np.concatenate(lines),
        np.concatenate(stamps),
        clock,
        layout.names,
        rows_read,
        layout.left_out,
        "steps" if "delay" in layout.units and layout.units["delay"].name == "steps" else "s",
        layout.zoneless,
        layout.notes + _converted(layout, clock),
    )


def _layout(
    header: list[str], delimiter: str, told: Mapping[str, str], path: Path, delay_unit: str
) -> _Layout:
    columns = find_columns(header, told, path)
    names = {role: normalised(header[place]) for role, place in columns.items()}
    units = {role: unit for role, name in names.items() if (unit := split_unit(name, role)[1]) is not None}
    layout = _Layout(len(header), columns, names, delimiter != ",", units, plane_is_told(told))
    if delay_unit and "delay" in columns and (unit := split_unit(delay_unit, "delay")[1]) is not None:
        units["delay"], layout.told = unit, "delay"
    layout.notes += [
        f"the column {name!r} looks like a delay and was not used; if it is one, name it with --delay, and "
        "its unit with --delay-unit"
        for name in unused_delays(header, columns.get("delay"))
    ]
    return layout


def _converted(layout: _Layout, clock: Clock) -> list[str]:
    """A note of the columns whose unit is another one than that in which values are kept."""
    groups: dict[str, dict[tuple[str, str], list[str]]] = {}
    for role, unit in layout.units.items():
        if unit.factor != 1.0 and (role != "time" or clock.kind == "number"):
            why = "told" if role == layout.told else "the names say"
            alike = groups.setdefault(why, {}).setdefault((unit.name, BASE[role]), [])
            alike.append(layout.names[role])
    return [
        f"converted, as {why}: "
        + "; ".join(f"{' and '.join(names)} from {unit} to {base}" for (unit, base), names in each.items())
        for why, each in groups.items()
    ]


def _parsed(block: list[tuple[int, list[str]]], layout: _Layout) -> tuple[dict[str, Array], Integers, Texts]:
    """The usable rows of a block as numbers; the others are noted in the layout."""
    whole = []
    for line, fields in block:
        if len(fields) != layout.width and (len(fields) < layout.width or any(fields[layout.width :])):
            found = f"{len(fields)} fields where the header has {layout.width}"
            layout.left_out.append(LeftOut(line, "wrong number of fields", found))
        else:
            whole.append((line, fields))
    texts = {role: [fields[place].strip() for _, fields in whole] for role, place in layout.columns.items()}
    clock = _clock(texts, layout)
    values = {
        role: numbers(each, layout.decimal_comma) * layout.factor(role)
        for role, each in texts.items()
        if role != "time"
    }
    values["time"] = clock.seconds(texts["time"], layout.decimal_comma)
    lines = np.array([line for line, _ in whole], dtype=int)
    good = _checked(values, texts, lines, layout)
    stamps = [texts["time"][row][:_LONGEST_STAMP] for row in np.flatnonzero(good).tolist()]
    if clock.kind == "date":
        layout.zoneless += sum(map(without_zone, stamps))
    encoded = np.array([each.encode() for each in stamps], dtype=np.bytes_)
    return {role: each[good] for role, each in values.items()}, lines[good], encoded


def _clock(texts: dict[str, list[str]], layout: _Layout) -> Clock:
    """How the stamps are written, as the first block tells; dates in a column of their own join the times."""
    times, dates = texts["time"], texts.pop("date", None)
    both = times if dates is None else joined(dates, times)
    if layout.clock is None and times:
        name = layout.names["time"]
        layout.clock = Clock.recognised(times, name, layout.decimal_comma)
        if dates is not None and layout.clock.kind != "date":
            whole = Clock.recognised(both, name, layout.decimal_comma)
            layout.dated = whole.kind == "date" and not (layout.clock.kind == "number" and layout.clock.known)
            if layout.dated:
                layout.clock = whole
            else:
                why = (
                    "its dates are not ISO 8601 (2024-05-01)"
                    if layout.clock.kind == "clock"
                    else "the stamps are no times of day"
                )
                layout.notes.append(f"the column {layout.names['date']!r} was not used: {why}")
    if layout.dated:
        texts["time"] = both
    return layout.clock or Clock("number")


def _checked(values: dict[str, Array], texts: dict[str, list[str]], lines: Integers, layout: _Layout) -> Mask:
    """Mask of the rows whose time, position and delay can be used."""
    good = np.ones(len(lines), dtype=bool)

    def refuse(bad: Mask, role: str, fault: str) -> None:
        for row in np.flatnonzero(bad & good).tolist():
            found = f"{layout.names[role]} is {texts[role][row][:40]!r}"
            layout.left_out.append(LeftOut(int(lines[row]), fault, found))
        good[bad] = False

    # degrees beside the columns that were asked for only tie these to the globe
    degrees = () if layout.plane_told else ("lat", "lon")
    measured = [role for role in ("time", *degrees, "x", "y", "delay") if role in values]
    for role in measured:
        unknown = ~np.isfinite(values[role])
        if unknown.any():
            refuse(unknown & _those(texts[role], _nothing), role, f"no {_LABEL[role]}")
            if role == "time":
                refuse(unknown & _those(texts[role], leap_second), role, _LEAP_FAULT)
                refuse(unknown, role, (layout.clock or Clock("number")).fault)
            refuse(unknown, role, f"{_LABEL[role]} is not a number")
    for name, limit in _LIMITS.items():
        if name in measured:
            refuse(np.abs(values[name]) > limit, name, f"{_LABEL[name]} out of range")
    if "lat" in measured:
        refuse((values["lat"] == 0) & (values["lon"] == 0), "lat", "no fix (latitude and longitude both 0)")
    if "delay" in values:
        refuse(values["delay"] < 0, "delay", "negative delay")
    return good


def _those(texts: list[str], what: Callable[[str], bool]) -> Mask:
    return np.array([what(text) for text in texts], dtype=bool)


def _nothing(text: str) -> bool:
    return text.lower() in _NOTHING


_LEAP_FAULT = "a leap second, which seconds since 1970 do not count"
_LONGEST_STAMP = 40  # characters that are remembered
_NOTHING = ("", "nan", "na", "n/a", "null", "none", "-")
_LIMITS = {"time": _LATEST, "lat": 90.0, "lon": 360.0, "x": _FARTHEST, "y": _FARTHEST}
_LABEL = {
    "time": "time",
    "lat": "latitude",
    "lon": "longitude",
    "x": "first coordinate",
    "y": "second coordinate",
    "delay": "delay",
}
