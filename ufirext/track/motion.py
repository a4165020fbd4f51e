"""Motion model, horizon and noise of a track, from the track itself."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil
from typing import NamedTuple

import numpy as np

from ..errors import HorizonError, ShapeError
from ..gains import ufir_gain
from ..horizon import best_horizon, horizon_criterion, shortest_horizon
from ..model import kinematic
from .filters import FilterName
from .run import AXES, LONGEST, Estimates, Motion, run
from .series import Track
from .timing import APART, Timing, age_in_steps, pieces

__all__ = ["Choice", "Wish", "choose"]

_BLOCKS, _BLOCK = 8, 1_000  # of rows that the choice between orders looks at
_LONGEST = 100  # steps in a window that is chosen from data
_WORTH = 0.98  # a higher order must bring the mean square prediction error below this part
_FEW = 8  # rows with a whole window behind them; with fewer, shorter windows count as well
_ENOUGH = 1.5  # horizons of least squares make the minimum variance as small as it gets, to 0.1 %
_TINY = 1e-6  # m; a smaller standard deviation of a position means nothing


@dataclass(frozen=True)
class Choice:
    """A motion model with its horizon and noise, and where each came from.

    Attributes
    ----------
    motion : Motion
    density : float
        Of the process noise, m^2/s^(2 order + 1).
    why_order, why_horizon, why_sigma, why_density : str
    errors : dict
        Order -> (horizon, root mean square one-step prediction error, m), of the orders that were tried.
    """

    motion: Motion
    why_order: str
    why_horizon: str
    why_sigma: str
    density: float
    why_density: str
    errors: dict[int, tuple[int, float]]


class Wish(NamedTuple):
    """What was asked for; None leaves it to the data.

    Attributes
    ----------
    order, horizon, lag : int
    adaptive : bool
    sigma : float
        Standard deviation of a measured coordinate, m.
    filter : str
    density : float
        Of the process noise, m^2/s^(2 order + 1).
    theta : float
        1/m^2.
    """

    order: int | None = None
    horizon: int | None = None
    adaptive: bool = False
    lag: int = 0
    sigma: float | None = None
    filter: FilterName = "ufir"
    density: float | None = None
    theta: float | None = None


NOTHING_TOLD = Wish()


def choose(track: Track, axis: Timing, wish: Wish = NOTHING_TOLD) -> Choice:
    """The motion that predicts the track's next position best.

    For every order the horizon with the least mean square one-step prediction error (`best_horizon`); of the
    orders the one whose error is least, on the rows that all of them predict from a whole window.
    The noise is that under which this horizon is the best one and the innovations are as large as they are.
    """
    part, part_axis = _excerpt(track, axis)
    told = wish.horizon
    orders = [wish.order] if wish.order is not None else _possible(part_axis)
    horizons = {each: _horizon(track, axis, each) if told is None else told for each in orders}
    tried = {each: run(part, part_axis, Motion(each, horizons[each]), spread=False) for each in orders}
    errors = _errors(tried)
    best = orders[0]
    for each in orders[1:]:
        if errors[each] < _WORTH * errors[best]:
            best = each
    second = axis.step ** (2 * best + 1)  # the unit of time in the filter is a step
    density = None if wish.density is None else wish.density * second
    q, r = _noise(best, horizons[best], errors[best], wish.sigma, density)
    horizon = _window(wish, horizons[best])
    motion = Motion(best, horizon, q, r, wish.lag, wish.adaptive, wish.filter, wish.theta)
    return Choice(
        motion,
        _why_order(wish.order, errors),
        _why_horizon(wish, horizon, horizons[best], errors[best]),
        _why_sigma(wish.sigma, errors[best]),
        q / second,
        "as told" if wish.density is not None else _why_density(wish, horizons[best]),
        {each: (horizons[each], float(np.sqrt(errors[each]))) for each in orders},
    )


def _window(wish: Wish, best: int) -> int:
    """The horizon in use, where `best` is that of least squares."""
    if wish.horizon is not None:
        return wish.horizon
    if wish.filter in ("ufir", "fms") and 2 * wish.lag + 1 > LONGEST:
        most = (LONGEST - 1) // 2  # the lag of a chosen window lies in its middle
        raise HorizonError(f"lag must be at most {most} steps where no horizon is told, got {wish.lag}")
    return max(ceil(_ENOUGH * best) if wish.filter == "fms" else best, 2 * wish.lag + 1)


def _why_order(told: int | None, errors: dict[int, float]) -> str:
    if told is not None:
        return "as told"
    if len(errors) == 1:
        return "too few rows in a row to judge others"
    listed = ", ".join(f"order {order} {_metres(error)}" for order, error in errors.items())
    return f"least one-step prediction error: {listed}"


def _metres(square: float) -> str:
    return f"{np.sqrt(square):.3g} m" if square > _TINY**2 else f"under {_TINY:g} m"


def _why_horizon(wish: Wish, used: int, best: int, square: float) -> str:
    if wish.horizon is not None:
        return "as told"
    if wish.adaptive:
        return "chosen on the way, by prediction error"
    if np.isnan(square):
        return "two more than the least: too few rows to judge by"
    if wish.filter == "fms" and used == ceil(_ENOUGH * best):
        return f"{best} predicts best by least squares; half as long again leaves nothing to gain"
    if used != best:
        return f"{best} predicts best; longer, so that the lag lies in its middle"
    return "least one-step prediction error"


def _why_density(wish: Wish, best: int) -> str:
    return f"the one for which a window of {best} steps is the best"


def _why_sigma(told: float | None, square: float) -> str:
    if told is not None:
        return "as told"
    if np.isnan(square):
        return "assumed: too few rows to tell"
    if square <= _TINY**2:
        return "at most: the motion model explains every row"
    return "from the innovations; slow errors of a receiver are not in it"


def _excerpt(track: Track, axis: Timing) -> tuple[Track, Timing]:
    """A long track's blocks of rows, evenly spread; a short one as it is."""
    if len(track) <= _BLOCKS * _BLOCK:
        return track, axis
    starts = np.linspace(0, len(track) - _BLOCK, _BLOCKS).astype(int)
    rows = (starts[:, None] + np.arange(_BLOCK)).ravel()
    steps = axis.steps[rows].copy()
    steps[::_BLOCK] = APART
    age = None if track.age is None else track.age[rows]
    part = replace(
        track,
        seconds=track.seconds[rows],
        position=track.position[rows],
        lines=track.lines[rows],
        age=age,
        truth=None,
        breaks=np.zeros(0, dtype=np.int64),
    )
    return part, replace(axis, steps=steps)


def _possible(axis: Timing) -> list[int]:
    """The orders with a velocity that the longest stretch without a long gap can tell apart.

    Constant position is for those who ask: it has no velocity to write.
    """
    longest = max(each.stop - each.start for each in pieces(axis, 8))
    return [order for order in (1, 2) if longest >= 3 * (order + 3)] or [1]


def _horizon(track: Track, axis: Timing, order: int) -> int:
    """The best horizon for an order, by the track laid on the nearest points of a grid."""
    model = kinematic(order, AXES, 1.0)
    least = shortest_horizon(model) + 2
    steps = np.minimum(np.rint(axis.steps), 8)  # a long gap need not be walked through
    breaks = track.breaks[: len(track) // 8]  # but no window may reach across a break
    steps[breaks] = _LONGEST + 1
    ages = age_in_steps(track, axis)
    known = ages <= _LONGEST  # a row older than any window tells nothing about windows
    taken = np.rint((np.cumsum(steps) - ages)[known]).astype(int)
    if not len(taken):
        return least
    taken -= taken.min()
    zs = np.full((int(taken.max()) + 1, AXES), np.nan)
    zs[taken] = track.position[known] - track.position[0]
    try:
        return best_horizon(model, zs, longest=max(least, min(_LONGEST, len(track) // 4)))
    except ShapeError:  # too few rows to judge by
        return least


def _errors(tried: dict[int, Estimates]) -> dict[int, float]:
    """Mean square of the innovations of every order, per coordinate, on the rows that all predict; else NaN.

    Never less than the square of a length that means nothing: below, the orders tie.
    """
    common = np.all([each.settled & each.predicted for each in tried.values()], axis=0)
    if common.sum() < _FEW:
        common = np.all([each.predicted for each in tried.values()], axis=0)
    if not common.any():
        return dict.fromkeys(tried, float("nan"))
    return {
        order: max(float(np.mean(each.innovation[common] ** 2)), _TINY**2) for order, each in tried.items()
    }


def _noise(
    order: int, horizon: int, square: float, sigma: float | None, density: float | None
) -> tuple[float, float]:
    """Noise q and r that make `horizon` the best one and `square` the variance of an innovation.

    The error covariance of a window of N is P_N = r G_N + q W_N. P is flat at the horizon where
    r (G_{N-1} - G_{N+1}) = q (W_{N+1} - W_{N-1}); an innovation has the variance r a + q b.
    """
    model = kinematic(order, 1, 1.0, q=1.0, r=1.0)
    first = max(shortest_horizon(model), horizon - 1)
    G = horizon_criterion(model.replace(Q=0.0), first, max(horizon, first) + 1)
    W = horizon_criterion(model, first, max(horizon, first) + 1) - G
    ratio = float((G[0] - G[-1]) / (W[-1] - W[0]))
    gain = ufir_gain(model, max(horizon, first))
    ahead = model.H @ model.F
    a = float(np.vdot(ahead @ gain.G, ahead)) + 1.0
    b = float(np.vdot(ahead @ (gain.P - gain.G), ahead)) + float(model.Q[0, 0])
    if np.isnan(square):
        r = 1.0 if sigma is None else sigma**2
        return ratio * r if density is None else density, r
    if density is not None:
        # Process noise that explains all the innovations leaves next to nothing to the measurements.
        return density, max((square - density * b) / a, 1e-4 * square) if sigma is None else sigma**2
    if sigma is not None:
        return max(square - sigma**2 * a, 0.0) / b, sigma**2
    r = square / (a + ratio * b)
    return ratio * r, r
