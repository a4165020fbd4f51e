"""The picture of a filtered track: the track, a closer look, the residuals, and the error or the speed."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .._arrays import Array
from .page import write_page
from .run import Estimates
from .series import Track, UnusableTrack
from .timing import Timing

__all__ = ["DARK", "LIGHT", "Theme", "draw", "write_picture"]

_MOST = 20_000  # points drawn of a series; longer ones are thinned
_VECTORS = 500  # rows; above this the curves of an SVG are embedded as pixels
_CLOSE = 60  # rows in the closer look


@dataclass(frozen=True)
class Theme:
    """Colours (Okabe and Ito's, told apart by the colour-blind) on a ground."""

    ground: str
    ink: str
    grid: str
    raw: str
    filtered: str
    truth: str
    second: str


LIGHT = Theme("#ffffff", "#1a1a1a", "#e2e2e2", "#8a8a8a", "#0072B2", "#D55E00", "#E69F00")
DARK = Theme("#15181c", "#e6e6e6", "#33383e", "#9a9a9a", "#56B4E9", "#E69F00", "#F0E442")


def write_picture(
    path: Path, track: Track, axis: Timing, estimates: Estimates, title: str, lines: list[tuple[str, str]]
) -> None:
    """Draw to a .png, or to a .html that holds the picture, light and dark, and the table."""
    try:
        if path.suffix.lower() == ".png":
            draw(track, axis, estimates, LIGHT, title).savefig(path, dpi=130)
        else:
            light, dark = (_svg(draw(track, axis, estimates, theme)) for theme in (LIGHT, DARK))
            write_page(path, title, light, dark, lines)
    except OSError as error:
        raise UnusableTrack(f"{path}: cannot be written: {error.strerror or error}") from error


def _svg(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "ufirext"}):
        figure.savefig(buffer, format="svg", dpi=130, metadata={"Date": None})
    return buffer.getvalue()


def draw(track: Track, axis: Timing, estimates: Estimates, theme: Theme = LIGHT, title: str = "") -> Figure:
    """The four panels, on a figure of its own (no global state)."""
    figure = Figure(figsize=(12, 9), layout="constrained", facecolor=theme.ground)
    if title:
        figure.suptitle(title, color=theme.ink, fontsize=13)
    panels = figure.subplots(2, 2)
    picture = _Picture(track, estimates, theme, axis)
    picture.whole(panels[0, 0])
    picture.closer(panels[0, 1])
    picture.innovations(panels[1, 0])
    if track.truth is not None and np.isfinite(track.truth).any():
        picture.errors(panels[1, 1])
    elif np.isfinite(estimates.velocity).any():
        picture.speed(panels[1, 1])
    else:
        picture.moved(panels[1, 1])
    for panel in panels.flat:
        _dress(panel, theme)
    return figure


def _dress(panel: Axes, theme: Theme) -> None:
    panel.set_facecolor(theme.ground)
    panel.grid(color=theme.grid, linewidth=0.8)
    panel.set_axisbelow(True)
    panel.tick_params(colors=theme.ink)
    for spine in panel.spines.values():
        spine.set_color(theme.grid)
    panel.xaxis.label.set_color(theme.ink)
    panel.yaxis.label.set_color(theme.ink)


class _Picture:
    """The panels of one track; each method draws one."""

    def __init__(self, track: Track, estimates: Estimates, theme: Theme, axis: Timing) -> None:
        self.track, self.estimates, self.theme, self.step = track, estimates, theme, axis.step
        span = float(track.seconds[-1] - track.seconds[0])
        self.unit, scale = ("s", 1.0) if span < 600 else ("min", 60.0) if span < 10_800 else ("h", 3600.0)
        self.time = (track.seconds - track.seconds[0]) / scale
        self.pixels: dict[str, Any] = {"rasterized": len(track) > _VECTORS}

    def _thin(self, *series: Array) -> list[Array]:
        """Every k-th row, with a hole in the line where the filter started afresh."""
        holes = []
        for values in series:
            values = np.array(values, dtype=float)
            holes.append(np.insert(values, self.estimates.starts[1:].tolist(), np.nan, axis=0))
        stride = -(-len(holes[0]) // _MOST)
        return [each[::stride] for each in holes]

    def whole(self, panel: Axes) -> None:
        raw, filtered = self._thin(self.track.position, self.estimates.position)
        panel.plot(*raw.T, ".", color=self.theme.raw, markersize=3, label="measured", **self.pixels)
        if self.track.truth is not None:
            (truth,) = self._thin(self.track.truth)
            panel.plot(*truth.T, color=self.theme.truth, linewidth=1.2, label="truth", **self.pixels)
        panel.plot(*filtered.T, color=self.theme.filtered, linewidth=1.2, label="estimated", **self.pixels)
        self._map(panel, "Track")

    def closer(self, panel: Axes) -> None:
        rows = self._most_moved()
        raw, filtered = self.track.position[rows], self.estimates.position[rows]
        panel.plot(*raw.T, "o", color=self.theme.raw, markersize=4, label="measured")
        if self.track.truth is not None:
            panel.plot(*self.track.truth[rows].T, color=self.theme.truth, linewidth=1.5, label="truth")
        panel.plot(
            *filtered.T, ".-", color=self.theme.filtered, linewidth=1.5, markersize=5, label="estimated"
        )
        first, last = self.time[rows.start], self.time[rows.stop - 1]
        self._map(panel, f"Closer: {first:.1f} to {last:.1f} {self.unit}")

    def _most_moved(self) -> slice:
        """The stretch of rows, within one run of the filter, where estimate and measurement differ most."""
        moved = np.linalg.norm(self.estimates.position - self.track.position, axis=1)
        length = min(_CLOSE, len(moved))
        middle = np.bartlett(length + 2)[1:-1]  # weights that put what is most in the middle of the picture
        power = np.convolve(np.where(self.estimates.ready, moved, 0.0) ** 2, middle, mode="valid")
        restart = np.zeros(len(moved))
        restart[self.estimates.starts[1:]] = 1.0
        inside = np.convolve(restart, np.ones(length), mode="valid") - restart[: len(power)]
        start = int(np.argmax(np.where(inside > 0.5, -1.0, power)))
        return slice(start, start + length)

    def _map(self, panel: Axes, title: str) -> None:
        panel.set_aspect("equal", adjustable="datalim")
        first, second = self.track.axes
        panel.set(xlabel=f"{first}, m", ylabel=f"{second}, m")
        self._head(panel, title)

    def _over_time(self, panel: Axes, title: str, label: str) -> None:
        panel.set(xlabel=f"time, {self.unit}", ylabel=label)
        panel.margins(x=0.02)
        self._head(panel, title)

    def _head(self, panel: Axes, title: str) -> None:
        """Title on the left and legend on the right above the panel, where they hide nothing."""
        panel.set_title(title, loc="left", fontsize=11, color=self.theme.ink)
        panel.legend(
            loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, fontsize=8, frameon=False,
            labelcolor=self.theme.ink,             borderaxespad=0.1, handlelength=1.4, columnspacing=1.0,
        )  # fmt: skip

    def innovations(self, panel: Axes) -> None:
        time, y, std = self._thin(self.time, self.estimates.innovation, self.estimates.innovation_std)
        panel.fill_between(
            time,
            -2 * std[:, 0],
            2 * std[:, 0],
            color=self.theme.grid,
            linewidth=0,
            label="2 std",
        )
        for column, color in enumerate((self.theme.filtered, self.theme.second)):
            name = self.track.axes[column]
            panel.plot(time, y[:, column], ".", color=color, markersize=2.5, label=name, **self.pixels)
        sizes = np.abs(self.estimates.innovation)
        shown = sizes[np.isfinite(sizes)]
        if len(shown):
            limit = 1.1 * float(max(np.quantile(shown, 0.999), 2.5 * np.nanmedian(std)))
            panel.set_ylim(-limit, limit)
            self._outside(panel, self.estimates.innovation, limit)
        self._over_time(panel, "Residuals", "measurement - prediction, m")

    def _outside(self, panel: Axes, values: Array, limit: float) -> None:
        """Marks at the edge for the values (n, k) of all rows that the panel is too small for."""
        beyond = np.abs(values) > limit
        rows, columns = np.nonzero(beyond)
        if not len(rows):
            return
        count = int(beyond.any(axis=1).sum())
        label = f"{count:,} outside" if count > 1 else "1 outside"
        for marker, side in (("^", 1.0), ("v", -1.0)):
            here = np.sign(values[rows, columns]) == side
            if here.any():
                panel.plot(
                    self.time[rows[here]], np.full(int(here.sum()), 0.97 * side * limit), marker,
                    color=self.theme.truth, markersize=7, zorder=5, label=label,
                )  # fmt: skip
                label = "_"  # said once

    def errors(self, panel: Axes) -> None:
        truth = np.asarray(self.track.truth)
        pairs = (
            ("measured", self.track.position, self.theme.raw),
            ("estimated", self.estimates.position, ""),
        )
        for name, position, color in pairs:
            time, error = self._thin(self.time, np.linalg.norm(position - truth, axis=1))
            panel.plot(
                time, error, color=color or self.theme.filtered, linewidth=1, label=name, **self.pixels
            )
        panel.set_ylim(bottom=0)
        self._over_time(panel, "Distance to the truth", "m")

    def speed(self, panel: Axes) -> None:
        speed = np.linalg.norm(self.estimates.velocity, axis=1)
        spread = np.linalg.norm(self.estimates.velocity_std, axis=1) / np.sqrt(2.0)
        known = self.estimates.ready
        whole, spread = (np.where(known, each, np.nan) for each in (speed, spread))
        time, speed, spread = self._thin(self.time, whole, spread)
        low, high = np.maximum(speed - 2 * spread, 0.0), speed + 2 * spread
        panel.fill_between(
            time, low, high, color=self.theme.raw, alpha=0.4, linewidth=0, label="2 std", **self.pixels
        )
        panel.plot(time, speed, color=self.theme.filtered, linewidth=1, label="speed", **self.pixels)
        limit = 1.1 * float(np.nanquantile(speed + spread, 0.999)) if np.isfinite(speed).any() else 1.0
        panel.set_ylim(0, limit)
        self._outside(panel, whole[:, None], limit)
        self._over_time(panel, "Estimated speed", "m/s")

    def moved(self, panel: Axes) -> None:
        distance = np.linalg.norm(self.estimates.position - self.track.position, axis=1)
        time, distance = self._thin(self.time, distance)
        panel.plot(time, distance, color=self.theme.filtered, linewidth=1, label="distance", **self.pixels)
        self._over_time(panel, "Estimate to measurement", "m")
