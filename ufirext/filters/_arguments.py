"""What clients pass to the verbs, in any of filterpy's forms, as flat arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from .._arrays import Array, column, dimension, finite, flat, integer, masked_constant, matrix, readings, real
from ..errors import NonFiniteError, UfirextError

if TYPE_CHECKING:
    from ..channels import Channel


def dimensions(dim_x: int, dim_z: int, dim_u: int) -> tuple[int, int, int]:
    """Sizes of a filter, checked."""
    return (
        dimension(dim_x, "dim_x", 1, "states"),
        dimension(dim_z, "dim_z", 1, "measured components"),
        dimension(dim_u, "dim_u", 0, "inputs (0: any)"),
    )


class NoFilter(UfirextError, TypeError):
    """An object that is no filter to take over; also a TypeError."""


def require_filter(given: Any, name: str, kind: str, attributes: Sequence[str]) -> None:
    """Raise unless an object has the attributes of a filter of this kind."""
    lacking = [attribute for attribute in attributes if not hasattr(given, attribute)]
    if lacking:
        raise NoFilter(
            f"{name} must be a {kind}, or have its attributes, got a {type(given).__name__} without "
            f"{', '.join(lacking)}; give a filter, ready to run"
        )


def measurement(z: ArrayLike | None, m: int) -> Array | None:
    """z as a flat (m,) array with NaN for missing components, None as None; infinity is refused."""
    if z is None:
        return None
    if z is masked_constant():
        return np.full(m, np.nan)
    array = flat(readings(z, "z"), m, "z")
    if not array.dot(array) < np.inf and np.isinf(array).any():
        raise NonFiniteError(f"z must be finite (NaN marks a missing component), got {array}")
    return array


def input_matrix(B: ArrayLike | None, n: int) -> Array:
    array = real(B, "B") if B is not None else np.zeros((n, 0))
    if array.ndim < 2:
        array = array.reshape(-1, 1) if array.size == n else array
    return matrix(array, (n, None), "B", "(dim_x, dim_u)")


def input_vector(u: ArrayLike, size: int) -> Array:
    array = real(u, "u")
    if array.ndim == 0 and size != 1 and array == 0.0:
        return np.zeros(size)  # filterpy's batch and MMAE pass u = 0 for no input
    return finite(column(array, size, "u"), "u")


def checked_channel(channel: Channel | None, max_delay: int | None) -> Channel | None:
    """The channel, or the time-stamped one that `max_delay` is short for; both together are refused."""
    if channel is None and max_delay is None:
        return None
    from ..channels import Channel, TimeStamped

    if channel is None:
        return TimeStamped(integer(max_delay, "max_delay", 0))
    if not isinstance(channel, Channel):
        raise UfirextError(f"channel must be a Channel such as TimeStamped(3), got {channel!r}")
    if max_delay is not None:
        raise UfirextError(
            "max_delay is short for channel=TimeStamped(max_delay): give one of them, "
            f"got {max_delay} and {channel}"
        )
    return channel


def late_channel(channel: Channel | None, max_delay: int) -> Channel:
    """The channel of a filter that always has one; a max_delay of 0 beside a channel was not given."""
    from ..channels import TimeStamped

    given = None if channel is not None and max_delay == 0 else max_delay
    return checked_channel(channel, given) or TimeStamped()
