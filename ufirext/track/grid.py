"""Estimates on a grid of steps: whole windows by one product with the gain, the others by the filter."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from .._arrays import Array
from .filters import new_filter, whole_window
from .series import Integers, Mask

if TYPE_CHECKING:
    from .run import Motion

__all__ = ["on_grid", "reach"]

_NUMBERS = 4_000_000  # numbers of all windows multiplied at once: bounds memory


def reach(motion: Motion) -> int:
    """Steps after which a filter cannot know what came before: its window, reached back as far as it may."""
    return 4 * motion.horizon + 64


def on_grid(zs: Array, motion: Motion, lag: int = 0) -> tuple[Array, Array]:
    """Means (n, dim_x) and covariances (n, dim_x, dim_x) at every point of a grid.

    zs : (n, dim_z), NaN where a point is empty. With `lag` they are those of `lag` points later, or of the
    last one.
    """
    states = motion.model().dim_x
    means, covs = np.empty((len(zs), states)), np.empty((len(zs), states, states))
    # the windows of an adaptive filter have no length that is known beforehand
    whole = np.zeros(len(zs), dtype=bool) if motion.adaptive else _whole(zs, motion.horizon, lag)
    if whole.any():
        K, P = whole_window(motion, lag)
        means[whole] = _product(K, zs, np.flatnonzero(whole) + lag - motion.horizon + 1)
        covs[whole] = P
    for start, stop in _runs(~whole, apart=reach(motion)):
        begin, end = max(0, start - reach(motion)), min(len(zs), stop + lag)
        part = slice(start - begin, stop - begin)
        x, P = _streamed(zs[begin:end], motion, lag)
        means[start:stop], covs[start:stop] = x[part], P[part]
    return means, covs


def _whole(zs: Array, horizon: int, lag: int) -> Mask:
    """Points whose window, which ends `lag` points later, has no empty point."""
    filled = np.concatenate([[0], np.cumsum(np.isfinite(zs).all(axis=1))])
    whole = np.zeros(len(zs), dtype=bool)
    whole[max(0, horizon - 1 - lag) : max(0, len(zs) - lag)] = filled[horizon:] - filled[:-horizon] == horizon
    return whole


def _product(K: Array, zs: Array, firsts: Integers) -> Array:
    """K Z for the windows that begin at `firsts`, (windows, dim_x)."""
    horizon = K.shape[1] // zs.shape[1]
    windows = sliding_window_view(zs, horizon, axis=0)
    result = np.empty((len(firsts), len(K)))
    size = max(1, _NUMBERS // K.shape[1])
    for begin in range(0, len(firsts), size):
        rows = slice(begin, begin + size)
        # (rows, dim_z, horizon) -> oldest row first, as in a gain
        result[rows] = windows[firsts[rows]].transpose(0, 2, 1).reshape(-1, K.shape[1]) @ K.T
    return result


def _runs(mask: Mask, apart: int) -> list[tuple[int, int]]:
    """Starts and stops of the runs of True; those closer than `apart` are one."""
    places = np.flatnonzero(mask)
    if not len(places):
        return []
    cuts = np.flatnonzero(np.diff(places) > apart)
    starts, stops = places[np.concatenate([[0], cuts + 1])], places[np.concatenate([cuts, [len(places) - 1]])]
    return list(zip(starts.tolist(), (stops + 1).tolist(), strict=True))


def _streamed(zs: Array, motion: Motion, lag: int) -> tuple[Array, Array]:
    """Means and covariances of a filter that goes through the points from the first to the last."""
    kf = new_filter(motion)
    means, covs, _, _ = kf.batch_filter(zs)
    means = means.reshape(len(zs), -1)
    if lag == 0:
        return means, covs
    kf = new_filter(motion)
    for now, z in enumerate(zs):
        kf.predict()
        kf.update(z)
        # the last points have fewer after them
        backs = range(1, lag + 1) if now == len(zs) - 1 else (lag,)
        for back in backs:
            if back <= now and kf.ready:
                x, P = kf.smoothed(back)
                means[now - back], covs[now - back] = np.ravel(x), P
    return means, covs
