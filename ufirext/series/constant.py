"""A constant model and a series without holes: products in pieces that stay in the cache."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .._arrays import Array
from ..gains import ufir_gain
from ..minimum_variance import minimum_variance_gain
from .plan import SeriesPlan
from .summed import Summed
from .toeplitz import convolve

__all__ = ["Tick", "convolved", "head_covariances"]

Tick = Callable[[int], None]
# Pieces of fewer steps cost less in one product with those of other series.
LONG = 2048


def convolved(
    summed: Summed, z: Array, out: Array, alignment: int, tick: Tick = lambda samples: None
) -> None:
    """Rows `history` .. T - 1 of the convolution of z (S, T, inputs) into out (S, T, outputs).

    Piece after piece from multiples of the alignment on, each with the samples before it, so that the bits
    of a row depend on its place in the grid alone. Rows before `history` are left as they are.
    """
    op = summed.op
    count, steps = z.shape[:2]
    begin = op.history // op.block * op.block
    together = max(1, alignment // max(steps, 1))
    for first in range(0, count, together):
        rows = slice(first, first + together)
        for piece in range(begin // alignment * alignment, steps, alignment):
            start, stop = max(piece, begin), min(piece + alignment, steps)
            if start < stop:
                _piece(summed, z[rows], out[rows], start, stop)
                tick(len(z[rows]) * (stop - start))


def _piece(summed: Summed, z: Array, out: Array, start: int, stop: int) -> None:
    """Rows start .. stop - 1; those before the first full window are worked out and not kept."""
    op = summed.op
    length = -(-(stop - start) // op.block) * op.block
    before, after = max(op.history - start, 0), start + length - stop
    taken = z[:, max(start - op.history, 0) : stop]
    if before or after:
        padded = np.zeros((len(z), op.history + length, op.inputs))
        padded[:, before : padded.shape[1] - after] = taken
        taken = padded
    elif taken.dtype != np.float64 or not taken[0].flags.carray:
        taken = np.ascontiguousarray(taken, dtype=np.float64)
    target = out[:, start:stop]
    direct = not (before or after) and target.dtype == np.float64 and bool(target[0].flags.carray)
    x = target if direct else np.empty((len(z), length, op.outputs))
    # The length alone decides, so that the bits of a series do not depend on its company.
    if length < LONG:
        convolve(op, taken, out=x)
    else:
        for samples, states in zip(taken, x, strict=True):
            summed(samples, states)
    if not direct:
        target[:, before:] = x[:, before : stop - start]


def head_covariances(plan: SeriesPlan, steps: int) -> Array:
    """Error covariances of the first `steps` windows, not full yet, (steps, dim_x, dim_x); NaN where none."""
    n, design = plan.model.dim_x, ufir_gain if plan.unbiased else minimum_variance_gain
    P = np.full((steps, n, n), np.nan)
    for length in range(plan.first, steps + 1):
        P[length - 1] = design(plan.model, length, plan.lag).P
    return P
