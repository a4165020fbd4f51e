"""`ufirext track FILE`: read, choose, filter, write, draw, tell."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, NamedTuple, NoReturn

import typer
from rich.console import Console
from rich.progress import BarColumn, TaskID, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bars

from ..errors import HorizonError, UfirextError, UnobservableWindow
from ..recursions import ThetaTooLarge
from .filters import FilterName
from .motion import Choice, Wish, choose
from .reading import read_track
from .report import show
from .run import Estimates, run
from .series import Progress, Track, silent
from .summary import facts, summarise
from .summary import left_out as rows_left_out
from .timing import Timing, timing
from .units import DELAY_UNITS
from .writing import default_output, require_format, write_left_out, write_track

__all__ = ["track"]

_HUGE = 1e9  # m; nothing on earth is longer, or known better than its inverse
_LONG = 2**20  # bytes; shorter files are done before a bar could be read


def _result(text: str, *flags: str) -> Any:
    return typer.Option(*flags, rich_help_panel="Results", help=text)


def _column(text: str) -> Any:
    return typer.Option(metavar="NAME", rich_help_panel="Columns with unusual names", help=text)


_ORDER = "Constant position (0), velocity (1) or acceleration (2); else from the data."
_HORIZON = "Steps in the window: told, from the data, or on the way."
_FILTER = "Unbiased FIR, minimum variance (fms), Kalman, or H-infinity (hinf)."
_DENSITY = "Of the process noise, m^2/s^3 at order 1; else from the horizon."
_THETA = "How tightly hinf bounds position errors, 1/m^2; else 0.3 of its limit at each row."
_SIGMA = "Standard deviation of a measured coordinate, m; else from the innovations."


def track(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A CSV or GPX file.")],
    output: Annotated[
        Path | None, _result("Write the estimates to this .csv or .gpx.", "--output", "-o")
    ] = None,
    plot: Annotated[
        Path | None, _result("Draw to this .png, or .html with the table.", "--plot", "-p")
    ] = None,
    left_out: Annotated[Path | None, _result("Write the rows left out, and why, to this .csv.")] = None,
    filter_: Annotated[FilterName, typer.Option("--filter", help=_FILTER)] = "ufir",
    order: Annotated[int | None, typer.Option(min=0, max=2, help=_ORDER)] = None,
    horizon: Annotated[str, typer.Option(metavar="N|auto|adaptive", help=_HORIZON)] = "auto",
    lag: Annotated[int, typer.Option(min=0, help="Smooth: give estimates as of this many steps later.")] = 0,
    sigma: Annotated[float | None, typer.Option(help=_SIGMA)] = None,
    density: Annotated[float | None, typer.Option(help=_DENSITY)] = None,
    theta: Annotated[float | None, typer.Option(help=_THETA)] = None,
    time: Annotated[str | None, _column("Seconds, ISO 8601, or time of day.")] = None,
    lat: Annotated[str | None, _column("Latitude, degrees.")] = None,
    lon: Annotated[str | None, _column("Longitude, degrees.")] = None,
    x: Annotated[str | None, _column("East, m.")] = None,
    y: Annotated[str | None, _column("North, m.")] = None,
    delay: Annotated[str | None, _column("How old a row was on arrival: s, or as the name ends.")] = None,
    truth_x: Annotated[str | None, _column("True east, m.")] = None,
    truth_y: Annotated[str | None, _column("True north, m.")] = None,
    truth_lat: Annotated[str | None, _column("True latitude, degrees.")] = None,
    truth_lon: Annotated[str | None, _column("True longitude, degrees.")] = None,
    delay_unit: Annotated[
        str, typer.Option(metavar="s|ms|..|steps", help="Unit of delays; else by their name.")
    ] = "",
) -> None:
    """Filter a recorded track and say what was found.

    FILE is a table with named columns (time; lat and lon, or east and north, or x and y in metres; optionally
    a delay and truth_ columns), or a GPX file. Rows that cannot be used are left out and reported.
    """
    columns = {"time": time, "lat": lat, "lon": lon, "x": x, "y": y, "delay": delay}
    columns |= {"truth_x": truth_x, "truth_y": truth_y, "truth_lat": truth_lat, "truth_lon": truth_lon}
    told = {role: name for role, name in columns.items() if name is not None}
    wish = Wish(order, _window(horizon), horizon == "adaptive", lag, sigma, filter_, density, theta)
    _check(wish)
    if delay_unit not in ("", *DELAY_UNITS):
        _wrong(f"must be one of {', '.join(DELAY_UNITS)}, got {delay_unit!r}", "--delay-unit")
    target = default_output(file) if output is None else output
    _check_targets(file, {"--output": target, "--plot": plot, "--left-out": left_out})
    try:
        with _bars(file) as progress:
            recorded = read_track(file, told, progress, delay_unit=delay_unit)
            require_format(target, recorded)
            result = _filtered(recorded, wish, progress)
            write_track(target, recorded, result.estimates, progress)
        lines = result.lines(recorded)
        if left_out is not None:
            write_left_out(left_out, rows_left_out(recorded, result.estimates))
            lines.append(("written", f"{left_out} (rows left out)"))
        lines.append(("written", f"{target} (estimates)"))
        if plot is not None:
            _draw(plot, recorded, result, lines)
            lines.append(("written", f"{plot} (picture)"))
    except (HorizonError, UnobservableWindow) as error:
        raise typer.BadParameter(str(error), param_hint="--horizon, --order, --lag") from error
    except ThetaTooLarge as error:
        at = "" if error.step is None else f" at step {error.step}"
        reason = f"theta must be below theta_max = {error.theta_max:.6g}{at}, got {error.theta:.6g}"
        advice = "lower --theta, or leave it out: 0.3 of its limit at each row is used then"
        raise typer.BadParameter(f"{reason}; {advice}", param_hint="--theta") from error
    except UfirextError as error:
        _fail(error)
    show(Console(), file.name, lines)


class _Result(NamedTuple):
    """What came of a track."""

    axis: Timing
    choice: Choice
    estimates: Estimates

    def lines(self, track: Track) -> list[tuple[str, str]]:
        return facts(track, self.axis, self.choice, self.estimates, summarise(track, self.estimates))


def _filtered(recorded: Track, wish: Wish, progress: Progress) -> _Result:
    axis = timing(recorded)
    choice = choose(recorded, axis, wish)
    return _Result(axis, choice, run(recorded, axis, choice.motion, progress))


def _window(text: str) -> int | None:
    """The horizon that was told, None when the data decide."""
    if text in ("auto", "adaptive"):
        return None
    try:
        horizon = int(text)
    except ValueError:
        _wrong(f"must be a number of steps, auto or adaptive, got {text!r}", "--horizon")
    if horizon < 1:
        _wrong(f"must be at least 1 step, got {horizon}", "--horizon")
    return horizon


def _check(wish: Wish) -> None:
    """That every option has a meaning for the filter, and a value that can be meant."""
    name = wish.filter
    if wish.sigma is not None and not 1 / _HUGE <= wish.sigma <= _HUGE:
        _wrong(f"must be a number of metres from {1 / _HUGE:g} to {_HUGE:g}, got {wish.sigma}", "--sigma")
    for option, value in (("--density", wish.density), ("--theta", wish.theta)):
        if value is not None and not 0 <= value <= _HUGE**2:
            _wrong(f"must be a number from 0 to {_HUGE**2:g}, got {value}", option)
    if wish.theta is not None and name != "hinf":
        _wrong(f"is for the filter hinf, got {name}", "--theta")
    if wish.adaptive and name != "ufir":
        _wrong(f"adaptive is for the filter ufir, got {name}", "--horizon")
    if wish.horizon is not None and name in ("kalman", "hinf"):
        _wrong(f"is for filters with a window, ufir and fms; {name} forgets nothing", "--horizon")
    if wish.lag and name == "hinf":
        _wrong("is for the other filters: what hinf bounds is the error of the present state", "--lag")


def _wrong(reason: str, option: str) -> NoReturn:
    raise typer.BadParameter(reason, param_hint=option)


def _check_targets(source: Path, targets: dict[str, Path | None]) -> None:
    """Before any work: that every file to be written has a known suffix, a folder, and is not the source."""
    suffixes = {"--output": (".csv", ".gpx"), "--plot": (".png", ".html"), "--left-out": (".csv",)}
    taken = [source.resolve()]
    for option, target in targets.items():
        if target is None:
            continue
        if target.suffix.lower() not in suffixes[option]:
            _wrong(f"must end in {' or '.join(suffixes[option])}, got {target}", option)
        if target.resolve() in taken:
            _wrong(f"{target} is the input or another result", option)
        if not target.resolve().parent.is_dir() and source.exists():
            _wrong(f"there is no folder {target.parent}", option)
        taken.append(target.resolve())


@contextmanager
def _bars(file: Path) -> Iterator[Progress]:
    """Progress bars on a terminal for long files, on standard error; nothing otherwise."""
    console = Console(stderr=True)
    if not (console.is_terminal and file.is_file() and file.stat().st_size > _LONG):
        yield silent
        return
    columns = (TextColumn("{task.description:<10}"), BarColumn(), TimeRemainingColumn())
    with Bars(*columns, console=console, transient=True) as bars:
        tasks: dict[str, TaskID] = {}

        def listener(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total)
            bars.update(tasks[stage], completed=done, total=total)

        yield listener


def _draw(path: Path, track: Track, result: _Result, lines: list[tuple[str, str]]) -> None:
    try:
        from .figure import write_picture
    except ModuleNotFoundError as error:
        _fail(f"--plot needs {error.name}: pip install 'ufirext[plot]'")
    motion = result.choice.motion
    order = ("position", "velocity", "acceleration")[motion.order]
    window = "adaptive window" if motion.adaptive else f"window of {motion.horizon} steps"
    how = f"{motion.filter}, {window}" if motion.windowed else motion.filter
    title = f"{track.path.name}: constant {order}, {how}"
    write_picture(path, track, result.axis, result.estimates, title, lines)


def _fail(reason: object) -> NoReturn:
    Console(stderr=True, soft_wrap=True).print(f"ufirext track: {reason}", markup=False, highlight=False)
    raise typer.Exit(1)
