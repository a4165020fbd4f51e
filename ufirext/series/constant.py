"""A constant model and a series without holes: products in pieces that stay in the cache."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .._arrays import Array
from ..gains import ufir_gain
from ..minimum_variance import minimum_variance_gain
from .growth import EVEN
from .plan import SeriesPlan
from .summed import Summed

__all__ = ["Tick", "convolved", "head_covariances"]

Tick = Callable[[int], None]
# Pieces of fewer steps are filtered with those of other series, or with nothing, in products of so many.
LONG, TOGETHER = 1024, 8192


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
    for piece in range(begin // alignment * alignment, steps, alignment):
        start, stop = max(piece, begin), min(piece + alignment, steps)
        if start >= stop:
            continue
        length = -(-(stop - start) // op.block) * op.block
        # A number that depends on the length alone, so that no series meets other products for its company.
        together = 1 if length >= LONG else EVEN * -(-TOGETHER // (EVEN * length))
        for first in range(0, count, together):
            some = slice(first, first + together)
            _piece(summed, z[some], out[some], start, stop, (together, length))
            tick(len(z[some]) * (stop - start))


def _piece(summed: Summed, z: Array, out: Array, start: int, stop: int, shape: tuple[int, int]) -> None:
    """Rows start .. stop - 1, as a part of `shape` (series, steps); those before the first full window are
    worked out and not kept.
    """
    op, (count, length) = summed.op, shape
    before, after = max(op.history - start, 0), start + length - stop
    taken = z[:, max(start - op.history, 0) : stop]
    if before or after or len(z) < count:
        padded = np.zeros((count, op.history + length, op.inputs))
        padded[: len(z), before : padded.shape[1] - after] = taken
        taken = padded
    else:
        taken = np.ascontiguousarray(taken, dtype=np.float64)
    target = out[:, start:stop]
    if target.shape[:2] == shape and not before and target.dtype == np.float64 and target.flags.carray:
        summed(taken, target)
    else:
        into = np.empty((*shape, op.outputs))
        summed(taken, into)
        target[:, before:] = into[: len(z), before : stop - start]


def head_covariances(plan: SeriesPlan, steps: int) -> Array:
    """Error covariances of the first `steps` windows, not full yet, (steps, dim_x, dim_x); NaN where none."""
    n, design = plan.model.dim_x, ufir_gain if plan.unbiased else minimum_variance_gain
    P = np.full((steps, n, n), np.nan)
    for length in range(plan.first, steps + 1):
        P[length - 1] = design(plan.model, length, plan.lag).P
    return P
