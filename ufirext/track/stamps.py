"""Time stamps: texts to seconds, and which rows to leave out so that time runs forward."""

from __future__ import annotations

import re
from bisect import bisect_left, bisect_right
from dataclasses import dataclass

import numpy as np
import pandas as pd

from .._arrays import Array
from .series import Mask
from .units import split_unit

__all__ = ["Clock", "in_order", "joined", "leap_second", "numbers", "past_midnight", "without_zone"]

_SAMPLE = 1000  # stamps that tell how the others are written
_DAY = 86_400.0  # s
_ISO = "ISO 8601 (2024-05-01T10:00:00Z)"
_OF_DAY = "hours:minutes:seconds"
_ZONE = re.compile(r"[T\s]\d{2}.*(Z|[+-]\d{2}(:?\d{2})?)\s*$", re.IGNORECASE)
_LEAP = re.compile(r":60(\.\d*)?\s*(Z|[+-]\d{2}(:?\d{2})?)?\s*$", re.IGNORECASE)


def numbers(texts: list[str], decimal_comma: bool = False) -> Array:
    """Floats of texts, NaN where a text is none."""
    series = pd.Series(texts, dtype=object)
    if decimal_comma:
        series = series.str.replace(",", ".", n=1, regex=False)
    return pd.to_numeric(series, errors="coerce").to_numpy(dtype=float)


@dataclass(frozen=True)
class Clock:
    """How the stamps of one file are written.

    Attributes
    ----------
    kind : {"number", "date", "clock"}
        Plain numbers; ISO 8601 (without a zone: UTC); or hours:minutes:seconds.
    scale : float
        Seconds per unit of a plain number.
    epoch : bool
        Whether the seconds count from 1970-01-01T00:00:00Z.
    known : bool
        Whether any stamp could be read.
    """

    kind: str
    scale: float = 1.0
    epoch: bool = False
    known: bool = True

    @classmethod
    def recognised(cls, texts: list[str], name: str, decimal_comma: bool) -> Clock:
        """The way in which most of `texts`, the first stamps of a column called `name`, can be read."""
        texts = texts[:_SAMPLE]
        plain = numbers(texts, decimal_comma)
        counts = {
            "number": np.isfinite(plain).sum(),
            "date": np.isfinite(_dates(texts)).sum(),
            "clock": np.isfinite(_clock_times(texts)).sum(),
        }
        kind = max(counts, key=lambda each: counts[each])  # the first of equals
        if kind != "number" or counts["number"] == 0:
            return cls(kind, epoch=kind == "date", known=bool(counts[kind]))
        size = float(np.nanmedian(np.abs(plain)))
        unit = split_unit(name, "time")[1]
        scale = 1.0 if unit is None else unit.factor
        if scale == 1.0 and not name.endswith("_s"):
            # seconds since 1970 stay below 1e11 for 3000 years; larger numbers count smaller units
            scale = 1e-9 if size > 1e17 else 1e-6 if size > 1e14 else 1e-3 if size > 1e11 else 1.0
        return cls("number", scale, epoch=5e8 < size * scale < 5e9)

    def seconds(self, texts: list[str], decimal_comma: bool) -> Array:
        """Seconds of stamps, NaN where a text is no stamp of this kind."""
        if self.kind == "date":
            return _dates(texts)
        if self.kind == "clock":
            return _clock_times(texts)
        return numbers(texts, decimal_comma) * self.scale

    @property
    def fault(self) -> str:
        """What is wrong with a stamp that cannot be read."""
        if not self.known:
            return f"time is neither a number, nor {_ISO}, nor {_OF_DAY}"
        if self.kind == "number":
            return "time is not a number"
        return f"time is not {_ISO if self.kind == 'date' else _OF_DAY}, as the others are"


def joined(dates: list[str], times: list[str]) -> list[str]:
    """ISO 8601 of a date and a time of day; where one of them is missing, nothing or the time alone."""
    return [
        f"{date}T{'0' if time[1:2] == ':' else ''}{time}" if date and time else time
        for date, time in zip(dates, times, strict=True)
    ]


def without_zone(text: str) -> bool:
    """Whether a stamp in ISO 8601 leaves open how far it is from UTC."""
    return _ZONE.search(text) is None


def leap_second(text: str) -> bool:
    """Whether a stamp is the 61st second of its minute."""
    return _LEAP.search(text) is not None


def _dates(texts: list[str]) -> Array:
    series = pd.Series(texts, dtype=object)
    shaped = series.where(series.str.match(r"\s*\d{4}-?\d{2}-?\d{2}"))  # not a bare year: that is a number
    stamps = pd.to_datetime(shaped, format="ISO8601", utc=True, errors="coerce")
    since = stamps.dt.tz_localize(None).to_numpy(dtype="datetime64[us]")
    return np.where(np.isnat(since), np.nan, since.astype(np.int64) * 1e-6)


def _clock_times(texts: list[str]) -> Array:
    series = pd.Series(texts, dtype=object)
    shaped = series.where(series.str.fullmatch(r"\s*\d{1,2}:\d{2}:\d{2}(\.\d+)?\s*"))
    spans = pd.to_timedelta(shaped, errors="coerce")
    return np.asarray(spans.dt.total_seconds(), dtype=float)


def past_midnight(seconds: Array) -> Array:
    """Times of day that go on into the next one: a fall by more than half a day is a midnight."""
    midnights = np.cumsum(np.diff(seconds, prepend=seconds[:1]) < -_DAY / 2)
    return np.asarray(seconds + _DAY * midnights)


def in_order(seconds: Array, *, strictly: bool) -> Mask:
    """Mask of a largest set of rows whose stamps run forward.

    One wild stamp in the future thus costs one row, not all that follow.
    """
    steps = np.diff(seconds)
    if np.all(steps > 0 if strictly else steps >= 0):
        return np.ones(len(seconds), dtype=bool)
    return _longest_increasing(seconds, strictly)


def _longest_increasing(seconds: Array, strictly: bool) -> Mask:
    tails: list[float] = []  # tails[k]: smallest last stamp of a forward run of k + 1 rows
    length = np.empty(len(seconds), dtype=int)
    for row, stamp in enumerate(seconds.tolist()):
        # of rows that share a stamp the first is kept
        place = bisect_left(tails, stamp) if strictly else bisect_right(tails, stamp)
        if place == len(tails):
            tails.append(stamp)
            length[row] = place + 1
        else:
            length[row] = 0 if strictly and tails[place] == stamp else place + 1
            tails[place] = stamp
    keep = np.zeros(len(seconds), dtype=bool)
    wanted, bound = len(tails), np.inf
    for row in range(len(seconds) - 1, -1, -1):
        if length[row] == wanted and (seconds[row] < bound or (not strictly and seconds[row] <= bound)):
            keep[row] = True
            wanted, bound = wanted - 1, seconds[row]
    return keep
