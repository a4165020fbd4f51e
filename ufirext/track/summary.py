"""What came of a track, in numbers and in words."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby

import numpy as np

from .._arrays import Array
from .motion import Choice
from .outliers import outliers
from .run import Estimates, Motion
from .series import LeftOut, Track
from .timing import Timing

__all__ = ["Summary", "duration", "facts", "left_out", "summarise"]

_FILTERS = {
    "ufir": "unbiased FIR",
    "fms": "minimum variance over a window",
    "kalman": "Kalman, late rows by the recursion that is exact",
    "hinf": "H-infinity, a-posteriori form, of the augmented state where rows are late",
}
_ORDERS = ("constant position", "constant velocity", "constant acceleration")


@dataclass(frozen=True)
class Summary:
    """Statistics of a filtered track.

    Attributes
    ----------
    innovation_std : float
        Root mean square of the innovations of a coordinate, m, over rows with a whole window behind them.
    autocorrelation : float
        Of successive innovations; 0 when all that could be predicted was.
    nis : float
        Mean normalised innovation squared; 2 when the covariances are right.
    judged : int
        Rows these are taken over.
    whole : bool
        Whether they have a whole window behind them; else all rows that are predicted, there being no such.
    moved : float
        Root mean square distance between measurement and estimate, m.
    raw_rmse, filtered_rmse : float or None
        Root mean square distance to the truth, m, on the rows that have one.
    true_rows : int
    """

    innovation_std: float
    autocorrelation: float
    nis: float
    judged: int
    whole: bool
    moved: float
    raw_rmse: float | None = None
    filtered_rmse: float | None = None
    true_rows: int = 0


def summarise(track: Track, estimates: Estimates) -> Summary:
    """The statistics of what a filter made of a track."""
    judged = estimates.settled & estimates.predicted
    if not (whole := bool(judged.any())):
        judged = estimates.predicted
    y = np.where(judged[:, None], estimates.innovation, np.nan)
    raw, filtered, true_rows = _to_truth(track, estimates)
    return Summary(
        innovation_std=_rms(y),
        autocorrelation=_autocorrelation(y),
        nis=float(np.mean(estimates.nis[judged])) if judged.any() else np.nan,
        judged=int(judged.sum()),
        whole=whole,
        moved=_rms(np.linalg.norm(estimates.position - track.position, axis=1)),
        raw_rmse=raw,
        filtered_rmse=filtered,
        true_rows=true_rows,
    )


def _to_truth(track: Track, estimates: Estimates) -> tuple[float | None, float | None, int]:
    if track.truth is None or not (known := np.isfinite(track.truth).all(axis=1)).any():
        return None, None, 0
    raw, filtered = (
        _rms(np.linalg.norm(each[known] - track.truth[known], axis=1))
        for each in (track.position, estimates.position)
    )
    return raw, filtered, int(known.sum())


def _rms(values: Array) -> float:
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else np.nan


def _autocorrelation(y: Array) -> float:
    """Of successive rows; the first rows after a fresh start are NaN, so that no pair reaches across one."""
    first, second = y[:-1], y[1:]
    both = np.isfinite(first) & np.isfinite(second)
    power = 0.5 * (np.sum(first[both] ** 2) + np.sum(second[both] ** 2))
    return float(np.sum(first[both] * second[both]) / power) if power > 0 else np.nan


def duration(seconds: float) -> str:
    """A span of time for people."""
    if seconds < 120:
        return f"{seconds:.4g} s"
    if seconds < 7200:
        return f"{seconds / 60:.1f} min"
    return f"{seconds / 3600:.1f} h"


def facts(
    track: Track, axis: Timing, choice: Choice, estimates: Estimates, summary: Summary
) -> list[tuple[str, str]]:
    """The lines of the table: a heading and what there is to say."""
    motion = choice.motion
    lines = [
        ("rows read", f"{track.rows_read:,}; {len(track) - int(estimates.late.sum()):,} used"),
        *_left_out(track, left_out(track, estimates)),
        ("time", _time(track, axis)),
        *_segments(track),
        ("gaps", _gaps(track, axis, estimates)),
        ("filter", _FILTERS[motion.filter]),
        ("motion model", f"{_ORDERS[motion.order]} ({choice.why_order})"),
    ]
    if motion.windowed:
        used = "adaptive" if motion.adaptive else motion.horizon
        lines.append(("horizon", f"{used} ({choice.why_horizon})"))
    if motion.lag:
        lines.append(("lag", f"{motion.lag} steps, {duration(motion.lag * axis.step)}"))
    if track.age is not None:
        lines.append(("delays", _delays(track, estimates)))
    lines += [
        ("sigma", f"{np.sqrt(motion.r):.3g} m per coordinate ({choice.why_sigma})"),
        ("density", f"{choice.density:.3g} m^2/s^{2 * motion.order + 1} ({choice.why_density})"),
        *_theta(motion, estimates),
        ("innovations", _innovations(summary)),
        ("NIS mean", _nis(motion, summary)),
        ("estimate - measurement", f"{summary.moved:.3g} m rms"),
    ]
    if summary.raw_rmse is not None and summary.filtered_rmse is not None:
        change = f" ({summary.filtered_rmse / summary.raw_rmse - 1.0:+.1%})" if summary.raw_rmse else ""
        text = (
            f"raw {summary.raw_rmse:.3f} m, filtered {summary.filtered_rmse:.3f} m{change.replace('%', ' %')}"
        )
        lines.append(("RMSE to truth", f"{text} on {summary.true_rows:,} rows"))
    notes = [*track.notes, *_unfilled(motion, summary), *outliers(track, estimates)]
    return lines + [("note", note) for note in notes]


def _unfilled(motion: Motion, summary: Summary) -> list[str]:
    """A note where a told window is longer than every stretch of the track."""
    if summary.whole or not motion.windowed or not summary.judged:
        return []
    return [f"no row has a whole window of {motion.horizon} steps behind it: all windows in use are shorter"]


def _theta(motion: Motion, estimates: Estimates) -> list[tuple[str, str]]:
    """What an H-infinity filter promises of the whole track."""
    if estimates.theta is None:
        return []
    low, high, limit = estimates.theta
    used = f"{low:.3g} .. {high:.3g}" if low < high else f"{high:.3g}"
    why = "0.3 of the limit at each row" if motion.theta is None else "as told"
    return [
        ("theta", f"{used} per m^2 ({why}; smallest limit {limit:.3g})"),
        ("guarantee", "sum of theta |position error|^2 <= energy of the start and of both noises"),
    ]


def _innovations(summary: Summary) -> str:
    if not summary.judged:
        return "none: too few rows to predict one"
    said = [f"std {summary.innovation_std:.3g} m"]
    if not np.isnan(summary.autocorrelation):
        said.append(f"lag-1 autocorrelation {summary.autocorrelation:.2f}")
    rows = "with a whole window behind them" if summary.whole else "; none has a whole window behind it"
    return f"{', '.join(said)} ({summary.judged:,} rows{' ' if summary.whole else ''}{rows})"


def _nis(motion: Motion, summary: Summary) -> str:
    if not summary.judged:
        return "-"
    expected = "2 or less: hinf allows for the worst" if motion.filter == "hinf" else "2 expected"
    return f"{summary.nis:.2f} ({expected})"


def left_out(track: Track, estimates: Estimates) -> list[LeftOut]:
    """The rows left out when the file was read, and those that came too late for the filter."""
    unit = track.age_unit
    late = [
        LeftOut(
            int(track.lines[row]),
            "too late for the filter, or from before its start",
            f"{track.age[row]:.6g} {unit} old on arrival",
        )
        for row in np.flatnonzero(estimates.late).tolist()
        if track.age is not None
    ]
    return sorted(track.left_out + late)


def _left_out(track: Track, rows: list[LeftOut], shown: int = 5) -> list[tuple[str, str]]:
    if not rows:
        return [("left out", "none")]
    lines = []
    ordered = sorted(rows, key=lambda each: (each.fault, each.line))
    for fault, group in groupby(ordered, key=lambda each: each.fault):
        rows = list(group)
        text = "; ".join(f"{track.counted} {row.line} ({row.found})" for row in rows[:shown])
        more = f"; and {len(rows) - shown:,} more" if len(rows) > shown else ""
        lines.append(("left out", f"{len(rows):,}: {fault}: {text}{more}"))
    return lines


def _time(track: Track, axis: Timing) -> str:
    span = duration(float(track.seconds[-1] - track.seconds[0]))
    rate = f"{1.0 / axis.step:.4g} Hz" if axis.step <= 1.0 else f"a row every {axis.step:.4g} s"
    kind = "on a grid" if axis.regular else "off a grid: steps of their own length"
    return f"{span}, nominally {rate}, {kind}"


def _gaps(track: Track, axis: Timing, estimates: Estimates) -> str:
    spans = np.delete(np.diff(track.seconds), track.breaks - 1)
    gaps = spans[spans > 1.5 * axis.step]
    if not len(gaps):
        return "none"
    longest = duration(float(gaps.max()))
    restarts = len(estimates.starts) - 1 - len(track.breaks)
    text = f"{len(gaps):,}, the longest {longest}"
    return f"{text}; {restarts} longer than a window, a fresh start after each" if restarts else text


def _segments(track: Track) -> list[tuple[str, str]]:
    if not len(track.breaks):
        return []
    spans = np.diff(track.seconds)[track.breaks - 1]
    text = f"{len(track.breaks) + 1:,}, up to {duration(float(spans.max()))} apart; a fresh start in each"
    return [("segments", text)]


def _delays(track: Track, estimates: Estimates) -> str:
    ages = np.asarray(track.age)
    text = f"mean {ages.mean():.3g} {track.age_unit}, longest {ages.max():.3g} {track.age_unit}"
    late = int(estimates.late.sum())
    return f"{text}; {late:,} rows too late to be used" if late else text
