"""Checks of the attributes that clients assign, as values that pickle."""

from __future__ import annotations

from math import isfinite
from struct import unpack
from typing import Any

import numpy as np

from .._arrays import FLOAT, Array, covariance, matrix, plainly_covariance, plainly_positive, real, square

# So many numbers are summed up as Python's floats more quickly than NumPy is asked.
FEW = 24


class Check:
    """A matrix of this shape, whatever it holds; what is plainly right is recognised by a quick look."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.shape, self.format = shape, f"{shape[0] * shape[1]}d"
        self.few = shape[0] * shape[1] <= FEW

    def quick(self, value: Any) -> bytes | None:
        """The bytes of a plainly right array of floats, None for whatever needs a closer look."""
        if value.__class__ is np.ndarray and value.dtype is FLOAT and value.shape == self.shape:
            raw: bytes = value.tobytes()
            if isfinite(sum(unpack(self.format, raw)) if self.few else np.vdot(value, value)):
                return raw
        return None

    def __call__(self, value: Any) -> Array:
        """The checked value as an array of its own; a clear error for anything else."""
        return np.array(value, dtype=float)


class General(Check):
    """Any finite matrix."""

    def __init__(self, shape: tuple[int, int], name: str, meaning: str) -> None:
        super().__init__(shape)
        self.name, self.meaning = name, meaning

    def __call__(self, value: Any) -> Array:
        """One of the right size in any arrangement as well."""
        if not (isinstance(value, np.ndarray) and value.ndim == 2):
            value = real(value, self.name)
            if value.ndim < 2 and value.size == self.shape[0] * self.shape[1]:
                value = value.reshape(self.shape)
        return matrix(value, self.shape, self.name, self.meaning)


class Square(Check):
    """Any finite square matrix."""

    def __init__(self, size: int, name: str) -> None:
        super().__init__((size, size))
        self.name = name

    def __call__(self, value: Any) -> Array:
        """A scalar stands for a multiple of the identity."""
        size = self.shape[0]
        return square(scalar(value, self.name) if size == 1 else value, size, self.name, "(dim_x, dim_x)")


class Covariance(Check):
    """A covariance; R is one of z, any other one of x."""

    def __init__(self, size: int, name: str) -> None:
        super().__init__((size, size))
        self.name, self.meaning = name, "(dim_z, dim_z)" if name == "R" else "(dim_x, dim_x)"

    def quick(self, value: Any) -> bytes | None:
        """Likewise; most covariances of few components are diagonal."""
        if not (value.__class__ is np.ndarray and value.dtype is FLOAT and value.shape == self.shape):
            return None
        raw: bytes = value.tobytes()
        if not self.few:
            return raw if plainly_covariance(value) else None
        size, numbers = self.shape[0], unpack(self.format, raw)
        if not isfinite(sum(numbers)):
            return None
        variances = numbers[:: size + 1]
        if numbers.count(0.0) - variances.count(0.0) == size * size - size:
            return raw if min(variances) >= 0.0 else None
        return raw if raw == value.tobytes("F") and plainly_positive(value) else None

    def __call__(self, value: Any) -> Array:
        """A scalar stands for a multiple of the identity."""
        size = self.shape[0]
        return covariance(scalar(value, self.name) if size == 1 else value, size, self.name, self.meaning)


class Inputs(Check):
    """Input matrices, whose columns are free unless dim_u tells."""

    def __call__(self, value: Any) -> Array:
        """A vector is a column."""
        array, (rows, columns) = real(value, "B"), self.shape
        if array.ndim < 2 and array.size == rows:
            array = array.reshape(rows, 1)
        return matrix(array, (rows, columns or None), "B", "(dim_x, dim_u)")


def scalar(value: Any, name: str) -> Array:
    """A single number in whatever brackets, without them."""
    array = real(value, name)
    return array.reshape(()) if array.size == 1 else array
