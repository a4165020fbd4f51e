"""The two things a hot path does with a buffer, as functions with nothing left to look up."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from struct import Struct
from struct import error as StructError  # noqa: N812
from typing import Any, Protocol

import numpy as np

from .._arrays import FLOAT, Array

__all__ = ["Buffer", "Hands", "Intake", "Reading", "intake", "numbers", "reading"]

ARRAY = np.ndarray
# What is one number; float() takes text and masked entries for numbers as well.
CODES = "?" + np.typecodes["AllInteger"] + np.typecodes["Float"]
KINDS: tuple[type, ...] = (int, bool, *(type(np.zeros((), code)[()]) for code in CODES))
NUMBERS: dict[type, Callable[[Any], float]] = dict.fromkeys(KINDS, float)
Intake = Callable[[Any], bool]
Reading = Callable[[], Array]
Hands = tuple[Intake, tuple[Reading, Reading]]
"""z into a buffer, and x out of it: flat, and as a column."""


class Buffer(Protocol):
    """Measurements in the rows of `free`, oldest first; `end` is one past the newest."""

    free: Array
    end: int
    capacity: int

    def compact(self) -> None:
        """Move what is still needed to the front; called when the buffer is full."""


def intake(buffer: Buffer) -> Intake:
    """put(z): a finite z in one of filterpy's forms becomes the next row; anything else is left alone.

    False, with nothing done, where z is missing, not finite, of another shape or type: that is for somebody
    who can say what is wrong.
    """
    return {1: _intake_one, 2: _intake_two, 3: _intake_three}.get(buffer.free.shape[1], _intake_many)(buffer)


def _intake_one(buffer: Buffer) -> Intake:
    cells: Any = buffer.free.reshape(-1).data
    capacity = buffer.capacity

    def put(z: Any) -> bool:
        kind = z.__class__
        try:
            if kind is ARRAY:
                value = z.item() if z.ndim < 3 else np.inf
                if value.__class__ is not float and z.dtype.kind not in "iub":
                    return False  # a time, which is an int inside
            else:
                value = z if kind is float else NUMBERS[kind](z)
            if value - value != 0.0:
                return False
            end = buffer.end
            cells[end] = value
        except (KeyError, OverflowError, ValueError, AttributeError, TypeError):
            return False
        end += 1
        buffer.end = end
        if end == capacity:
            buffer.compact()
        return True

    return put


def _intake_two(buffer: Buffer) -> Intake:
    # Positions in the plane and in space are what most measure: worth versions of their own, a fifth of a
    # step each.
    cells: Any = buffer.free.reshape(-1).data
    capacity = buffer.capacity
    unpack: Callable[[Any], tuple[float, float]] = Struct("2d").unpack

    def put(z: Any) -> bool:
        if z.__class__ is not ARRAY or z.dtype is not FLOAT or z.ndim > 2:
            return False
        try:
            first, second = unpack(z)
        except StructError:  # another size
            return False
        except ValueError:  # not contiguous
            return put(z.copy()) if z.size == 2 else False
        if first - first + second - second != 0.0:
            return False
        end = buffer.end
        cells[end + end] = first
        cells[end + end + 1] = second
        end += 1
        buffer.end = end
        if end == capacity:
            buffer.compact()
        return True

    return put


def _intake_three(buffer: Buffer) -> Intake:
    cells: Any = buffer.free.reshape(-1).data
    capacity = buffer.capacity
    unpack: Callable[[Any], tuple[float, float, float]] = Struct("3d").unpack

    def put(z: Any) -> bool:
        if z.__class__ is not ARRAY or z.dtype is not FLOAT or z.ndim > 2:
            return False
        try:
            first, second, third = unpack(z)
        except StructError:
            return False
        except ValueError:
            return put(z.copy()) if z.size == 3 else False
        if first - first + second - second + third - third != 0.0:
            return False
        end = buffer.end
        at = 3 * end
        cells[at] = first
        cells[at + 1] = second
        cells[at + 2] = third
        end += 1
        buffer.end = end
        if end == capacity:
            buffer.compact()
        return True

    return put


def _intake_many(buffer: Buffer) -> Intake:
    m, capacity = buffer.free.shape[1], buffer.capacity
    values_of, width = numbers(m), m * FLOAT.itemsize
    pack_into, cells = Struct(f"{m}d").pack_into, buffer.free.reshape(-1).data.cast("B")

    def put(z: Any) -> bool:
        values = values_of(z)
        if values is None:
            return False
        end = buffer.end
        pack_into(cells, end * width, *values)
        end += 1
        buffer.end = end
        if end == capacity:
            buffer.compact()
        return True

    return put


@lru_cache(maxsize=64)
def numbers(m: int) -> Callable[[Any], tuple[float, ...] | None]:
    """The components of a finite z in one of filterpy's forms, None for anything else."""
    unpack: Callable[[Any], tuple[float, ...]] = Struct(f"{m}d").unpack
    composite = m > 3  # so many numbers may come as a matrix

    def read(z: Any) -> tuple[float, ...] | None:
        if z.__class__ is not ARRAY:
            return (float(z),) if m == 1 and isinstance(z, float) and z - z == 0.0 else None
        if z.dtype is not FLOAT or z.ndim > 2 or (composite and z.ndim == 2 and 1 not in z.shape):
            return None
        try:
            values = unpack(z)
        except StructError:  # another size
            return None
        except ValueError:  # not contiguous
            return read(z.copy()) if z.size == m else None
        total = sum(values)
        return values if total - total == 0.0 else None

    return read


def reading(buffer: Buffer, gain: Array, column: bool) -> Reading:
    """read(): the gain on the rows up to the newest, as a fresh column (dim_x, 1) or flat."""
    m = buffer.free.shape[1]
    width = gain.shape[1]
    product: Callable[[Array], Array] = gain.dot
    flat = buffer.free.reshape(-1)
    shape = (width, 1) if column else (width,)
    # Looking a view up beats making it: every lap through the buffer meets the same ones.
    views: list[Array | None] = [None] * (buffer.capacity + 1)

    def read() -> Array:
        end = buffer.end
        view = views[end]
        if view is None:
            view = views[end] = flat[end * m - width : end * m].reshape(shape)
        return product(view)

    return read
