"""The convolution of one long NumPy series without copies: products added up where the result stands."""

from __future__ import annotations

import numpy as np
from scipy.linalg.blas import dgemm

from .._arrays import Array
from .toeplitz import Convolution

__all__ = ["Summed"]


class Summed:
    """`convolve` by BLAS: what enters from one place is a product of its own, y += A E, and nothing is moved.

    BLAS has columns where NumPy has rows, so that all matrices are handed over transposed. A block of which
    only some samples enter meets zeros.
    """

    def __init__(self, op: Convolution) -> None:
        self.op, m = op, op.inputs
        self.near: list[tuple[int, Array]] = []
        self.far: list[tuple[int, int, Array, Summed, Array]] = []
        row = 0
        for offset, width in op.near:
            E = np.zeros((op.block * m, op.E.shape[1]))
            E[: width * m] = op.E[row : row + width * m]
            self.near.append((offset, E.T))
            row += width * m
        for far in op.far:
            E = op.E[row : row + far.inner.outputs]
            self.far.append((far.offset, far.blocks, far.local.T, Summed(far.inner), E.T))
            row += far.inner.outputs

    def __call__(self, z: Array, out: Array) -> None:
        """(history + blocks * block, inputs) into out (blocks * block, outputs), both contiguous."""
        count = len(out) // self.op.block
        y, started = out.reshape(count, -1).T, 0.0  # y is replaced, then added to
        for offset, E in self.near:
            dgemm(1.0, E, self._blocks(z, offset, count), started, y, 0, 0, 1)
            started = 1.0
        for offset, blocks, local, inner, E in self.far:
            known, short = count + blocks - 1, -count % inner.op.block
            # The series of moments has to end with a whole block as well.
            moments, sums = np.empty((known + short, len(local))), np.empty((count + short, E.shape[1]))
            moments[known:] = 0.0
            dgemm(1.0, local, self._blocks(z, offset, known), 0.0, moments[:known].T, 0, 0, 1)
            inner(moments, sums)
            dgemm(1.0, E, sums[:count].T, started, y, 0, 0, 1)

    def _blocks(self, z: Array, offset: int, count: int) -> Array:
        """`count` consecutive blocks of samples from `offset` on, as columns."""
        return z[offset : offset + count * self.op.block].reshape(count, -1).T
