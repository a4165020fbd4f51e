"""The oldest rows of a window that a recursion starts from: determined and well conditioned."""

from __future__ import annotations

from bisect import bisect_right

import numpy as np

from .window import Window

__all__ = ["good_start", "head", "longest_start", "start_length"]

# A prefix whose scaled rows have a condition below this loses no more than four of sixteen digits.
GOOD_CONDITION = 1e4
# A better conditioned start is looked for within this many further rows a state.
SEARCH_PER_STATE = 4
# Longest prefix, in measured components, that the second design solves at once.
CHECKED_COMPONENTS = 256


def start_length(window: Window, longest: int | None = None) -> int | None:
    """How many rows, oldest first, determine the state at their end and the one aimed at; None: not even all.

    `longest`: look no further than so many rows (dim_x + 1 suffice for a constant model, by Cayley-Hamilton).
    """
    last = len(window.H) if longest is None else min(longest, len(window.H))
    return next((count for count in range(1, last + 1) if head(window, count).determined()), None)


def head(window: Window, count: int) -> Window:
    """The oldest `count` rows and the transitions up to the newest of them (all rows: all transitions)."""
    stop = len(window.F) if count == len(window.H) else window.origins[count - 1]
    return Window(
        window.F[:stop],
        window.Q[:stop],
        window.H[:count],
        window.R[:count],
        window.origins[:count],
        min(window.aim, stop),
        window.W[:count],
    )


def good_start(window: Window, count: int) -> int:
    """A start of good condition at or soon after the shortest one; the best conditioned if none is good."""
    last = min(len(window.H), count + SEARCH_PER_STATE * window.dim_x)
    best, best_condition = count, np.inf
    for candidate in range(count, last + 1):
        condition = head(window, candidate).condition
        if condition < best_condition:
            best, best_condition = candidate, condition
        if condition < GOOD_CONDITION:
            break
    return best


def longest_start(window: Window, first: int) -> int:
    """The longest prefix that one QR solves well, for the second design."""
    least = min(first + window.dim_x, len(window.H))
    limit = max(GOOD_CONDITION, 2.0 * head(window, first).condition)
    count = bisect_right(window.starts, CHECKED_COMPONENTS) - 1
    while count > least and not _solves_well(head(window, count), first, limit):
        count = (count + least) // 2
    return max(count, least)


def _solves_well(prefix: Window, first: int, limit: float) -> bool:
    """Unstable transitions let the newest rows drown the oldest, at a loss of eps times their growth."""
    with np.errstate(over="ignore", invalid="ignore"):
        size = np.sqrt((prefix.C**2).sum(axis=1))
    return bool(size.max() <= limit * size[: prefix.starts[first]].max()) and prefix.condition <= limit
