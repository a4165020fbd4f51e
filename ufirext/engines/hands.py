"""A measurement on its way into running sums: arrays that stay, and nothing looked at twice.

Between small arrays most of the time goes into making new ones, into views, and into arrays that are not
contiguous: a product into room that stays takes half as long.
"""

from __future__ import annotations

from functools import cached_property
from math import hypot, inf
from struct import Struct
from typing import Any

import numpy as np

from .._arrays import FLOAT, Array
from .._lapack import cholesky_solver
from ..window import GOOD_PIVOT, LEAST_VARIANCE, Row, well_scaled
from .records import Step

__all__ = ["Hands", "QuickRow", "QuickStep"]

ARRAY = np.ndarray


class QuickStep(Step):
    """A step whose F is made of its bytes when somebody asks for it; without known inputs."""

    raw: bytes

    @classmethod
    def of(cls, raw: bytes, Q: Array) -> QuickStep:
        """From the bytes of F."""
        step = object.__new__(cls)
        step.raw, step.Q = raw, Q
        return step

    @property
    def leads(self) -> bytes:
        """F, with no array made."""
        return self.raw

    @cached_property
    def F(self) -> Array:  # type: ignore[override]
        """Transition, (dim_x, dim_x)."""
        n = len(self.Q)
        return np.frombuffer(self.raw).reshape(n, n)


class QuickRow(Row):
    """A row of this step whose arrays are made when somebody asks for them."""

    m: int
    packed: bytes  # H, R and z: one object, for long windows hold many of them

    @cached_property
    def _parts(self) -> tuple[Array, Array, Array]:
        numbers, m = np.frombuffer(self.packed), self.m
        H, R, z = np.split(numbers, [len(numbers) - m * m - m, len(numbers) - m])
        return H.reshape(m, -1), R.reshape(m, m), z

    @cached_property
    def H(self) -> Array:  # type: ignore[override]
        """Observation matrix, (m, dim_x)."""
        return self._parts[0]

    @cached_property
    def R(self) -> Array:  # type: ignore[override]
        """Covariance of the measurement, (m, m)."""
        return self._parts[1]

    @cached_property
    def z(self) -> Array:  # type: ignore[override]
        """Measurement, (m,)."""
        return self._parts[2]


class Hands:
    """What takes rows of m components up, one at a time, for models of n states."""

    def __init__(self, m: int, n: int) -> None:
        k = n + 1
        self.m, self.n, self.shape_H, self.shape_R, self.gaps = m, n, (m, n), (m, m), m * m - m
        self.unpack_H, self.unpack_R = Struct(f"{m * n}d").unpack, Struct(f"{m * m}d").unpack
        self.unpack_z, self.pack_z = Struct(f"{m}d").unpack, Struct(f"{m}d").pack
        # The H and R that were read last; what they came to is used again as long as they stay.
        self.raw_H, self.raw_R, self.size_R = b"", b"", m * m * FLOAT.itemsize
        self.information: float | None = None
        self.full_R: Array | None = None  # that R where it is not diagonal
        self.z: Any
        self.precision: Any
        joint, inverse = np.zeros((m, k)), np.zeros((m, m))  # [H, z] and R^-1
        self.joint, self.H, self.z = joint.T, joint[:, :n], joint.reshape(-1)[n::k].data
        self.inverse, self.precision = inverse, inverse.reshape(-1)[:: m + 1].data
        # H Phi and z - H c in both frames, transposed so that either half is contiguous; the same by R^-1.
        self.seen, self.weighted = np.zeros((2 * k, m)), np.zeros((2 * k, m))
        # Halves of these: the row's gram in either frame is their product.
        self.left = self.weighted[:k].dot, self.weighted[k:].dot
        self.right = self.seen[:n].T, self.seen[k:-1].T

    def row(
        self, now: int, z: Any, H: Any, R: Any, raw_H: bytes | None = None, raw_R: bytes | None = None
    ) -> QuickRow | None:
        """A row of this step from arrays of floats; None for whatever needs a closer look.

        That is: other types and shapes, NaN, infinity, an R that is plainly no covariance, an H with a row of
        zeros, which measures nothing. `raw_H` and `raw_R` are the bytes of arrays known to be right.
        """
        if raw_H is None:
            if H.__class__ is not ARRAY or H.dtype is not FLOAT or H.shape != self.shape_H:
                return None
            raw_H = H.tobytes()
        if raw_R is None:
            if R.__class__ is not ARRAY or R.dtype is not FLOAT or R.shape != self.shape_R:
                return None
            raw_R = R.tobytes()
        elif len(raw_R) != self.size_R:
            return None
        if z.__class__ is ARRAY and z.dtype is FLOAT and z.size == self.m and z.ndim < 3:
            raw_z = z.tobytes()
        elif z.__class__ is float and self.m == 1:
            raw_z = self.pack_z(z)
        else:
            return None
        values = self.unpack_z(raw_z)
        total = sum(values)
        if total - total != 0.0:
            return None
        if not (raw_H is self.raw_H and raw_R is self.raw_R) and not self._weigh(H, R, raw_H, raw_R):
            return None
        for i, value in enumerate(values):
            self.z[i] = value
        row = object.__new__(QuickRow)
        row.origin = row.arrival = now
        row._information = self.information
        row.m, row.packed = self.m, raw_H + raw_R + raw_z
        return row

    def _weigh(self, H: Array, R: Array, raw_H: bytes, raw_R: bytes) -> bool:
        """Make H and R the present ones; False where they need a closer look."""
        self.raw_H = b""
        numbers, noise = self.unpack_H(raw_H), self.unpack_R(raw_R)
        m, n, information = self.m, self.n, 0.0
        diagonal = noise.count(0.0) == self.gaps
        for i in range(m):
            norm, variance = hypot(*numbers[i * n : i * n + n]), noise[i * m + i]
            if not (0.0 < norm < inf and LEAST_VARIANCE < variance < inf):
                return False
            information += norm * norm / variance
            self.precision[i] = 1.0 / variance
        if diagonal:
            self.full_R = None
        elif raw_R != R.T.tobytes() or not sum(map(abs, noise)) < inf:
            return False
        else:
            self.full_R = np.frombuffer(raw_R).reshape(m, m)
        self.H[...] = H
        self.raw_H, self.raw_R, self.information = raw_H, raw_R, information if diagonal else None
        return True

    def see(self, products: Array) -> bool:
        """The last row in both frames, `products` the transposed transitions from these; False where R is
        hardly regular.
        """
        seen = products.dot(self.joint, self.seen)
        if self.full_R is None:
            seen.dot(self.inverse, self.weighted)
            return True
        factor, solution, info = cholesky_solver()(self.full_R, seen.T)
        if info or not well_scaled(factor, self.full_R, GOOD_PIVOT):
            return False
        self.weighted[...] = solution.T
        return True
