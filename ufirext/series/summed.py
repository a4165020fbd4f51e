"""The convolution of NumPy series without copies: products added up where the result stands."""

from __future__ import annotations

import numpy as np
from scipy.linalg.blas import dgemm

from .._arrays import Array
from .toeplitz import Convolution

__all__ = ["Summed"]


class Summed:
    """`convolve` by BLAS, all series in one product: every part of it is y += A E.

    BLAS has columns where NumPy has rows, so that all matrices are handed over transposed. A block of which
    only some samples enter meets zeros.
    """

    def __init__(self, op: Convolution) -> None:
        self.op, rows = op, op.block * op.inputs
        self.near = [(part.offset, _filled(part.E, rows).T) for part in op.near]
        self.far = [(part.offset, part.blocks, part.local.T, Summed(part.inner), part.E.T) for part in op.far]

    def __call__(self, z: Array, out: Array) -> None:
        """(S, history + blocks * block, inputs) into out (S, blocks * block, outputs), both contiguous."""
        series, count = len(z), out.shape[1] // self.op.block
        y, started = out.reshape(series * count, -1).T, 0.0
        for offset, E in self.near:
            dgemm(1.0, E, self._blocks(z, offset, count), started, y, 0, 0, 1)
            started = 1.0
        for offset, blocks, local, inner, E in self.far:
            known = count + blocks - 1
            short = -count % inner.op.block  # their series has to end with a whole block as well
            moments = np.empty((series, known, len(local)))
            flat = moments.reshape(series * known, -1).T
            dgemm(1.0, local, self._blocks(z, offset, known), 0.0, flat, 0, 0, 1)
            if short:
                moments = np.concatenate([moments, np.zeros((series, short, len(local)))], axis=1)
            sums = np.empty((series, count + short, E.shape[1]))
            inner(moments, sums)
            dgemm(1.0, E, sums[:, :count].reshape(series * count, -1).T, started, y, 0, 0, 1)

    def _blocks(self, z: Array, offset: int, count: int) -> Array:
        """`count` consecutive blocks of samples from `offset` on, as columns."""
        rows = z[:, offset : offset + count * self.op.block]
        return rows.reshape(len(z) * count, -1).T


def _filled(E: Array, rows: int) -> Array:
    """E with rows of zeros at its end."""
    return np.concatenate([E, np.zeros((rows - len(E), E.shape[1]))])
