"""Convolution of a series with matrix taps by matrix products alone, at a cost that hardly depends on their
number.

A gain that is the same at every step makes the whole series one block-Toeplitz product. Blocks of B outputs
share their samples (one product with a Toeplitz matrix E); where the taps are sums of few exponentials, as
every gain of a constant model is, the samples that all outputs of a block share enter through a few moments
of each block, and sums of moments are a convolution again, of a series B times shorter.

The kernel needs only matmul, reshape, slices and concat: any array library runs it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from .._arrays import Array

__all__ = ["PIECE", "Convolution", "Far", "convolution", "convolve", "moved"]

# Singular values below this fraction of the largest are rounding.
NOISE = 4e-15
# Two levels must reproduce the taps to this fraction of the largest tap's row norm.
FAITHFUL = 4e-15
# Shortest convolution for which two levels can pay.
TWO_LEVELS_FROM = 24
# Shifts of the taps from which a basis of all of them is taken.
SHIFTS = 6
# Moving a number costs as much as this many multiplications; a row of a product that is a block short.
MOVE = 6.0
# What the calls of one more level cost, in multiplications.
LEVEL = 60_000.0
# A series is worked off in pieces of about so many samples, which stay in a processor's cache.
PIECE = 16_384
# Columns a product needs to run at full speed.
WIDE = 16


class Far(NamedTuple):
    """Samples that all outputs of a block share, through moments.

    offset : first sample, counted from the oldest one the block sees; blocks : how many of them;
    local : (B m, p) moments of a block; inner : convolution of the moments, p in, r out.
    """

    offset: int
    blocks: int
    local: Any
    inner: Any


class Convolution(NamedTuple):
    """y_n = sum_i taps[i]' z_{n - history + i}, in blocks of `block` outputs.

    near : (offset, width) of the samples that enter one by one; far : those that enter through moments;
    E : (all that enters, block * outputs).
    """

    block: int
    history: int
    inputs: int
    outputs: int
    near: tuple[tuple[int, int], ...]
    far: tuple[Far, ...]
    E: Any

    @property
    def multiplications(self) -> float:
        """Multiplications an output step takes."""
        own = float(self.E.shape[0] * self.E.shape[1])
        for far in self.far:
            own += far.local.shape[0] * far.local.shape[1] + far.inner.multiplications
        return own / self.block

    @property
    def levels(self) -> int:
        """1, and one more for moments, and for moments of moments."""
        return 1 + max((far.inner.levels for far in self.far), default=0)


def moved(op: Convolution, convert: Callable[[Array], Any]) -> Convolution:
    """The same convolution with its matrices converted, to another array library, device or type."""
    far = tuple(part._replace(local=convert(part.local), inner=moved(part.inner, convert)) for part in op.far)
    return op._replace(far=far, E=convert(op.E))


def convolve(op: Convolution, z: Any, xp: Any = np, out: Any = None) -> Any:
    """The kernel: (.., history + blocks * block, inputs) -> (.., blocks * block, outputs); pure.

    `xp` is the array namespace of z and of the matrices; `out`, for NumPy alone, takes the result.
    """
    count = (z.shape[-2] - op.history) // op.block
    parts = [_blocks(op, z, offset, count, xp)[..., : width * op.inputs] for offset, width in op.near]
    for far in op.far:
        moments = xp.matmul(_blocks(op, z, far.offset, count + far.blocks - 1, xp), far.local)
        parts.append(_padded(far.inner, moments, count, xp))
    stacked = parts[0] if len(parts) == 1 else xp.concat(parts, axis=-1)
    if out is None:
        y = xp.matmul(stacked, op.E)
        return xp.reshape(y, (*z.shape[:-2], count * op.block, op.outputs))
    xp.matmul(stacked, op.E, out=out.reshape((*z.shape[:-2], count, op.block * op.outputs)))
    return out


def _blocks(op: Convolution, z: Any, offset: int, count: int, xp: Any) -> Any:
    """`count` consecutive blocks of samples from `offset` on, as rows."""
    rows = z[..., offset : offset + count * op.block, :]
    return xp.reshape(rows, (*z.shape[:-2], count, op.block * op.inputs))


def _padded(op: Convolution, z: Any, wanted: int, xp: Any) -> Any:
    """The first `wanted` outputs of a series that need not end with a whole block."""
    short = -wanted % op.block
    if not short:
        return convolve(op, z, xp)
    filler = xp.zeros_like(xp.broadcast_to(z[..., :1, :], (*z.shape[:-2], short, z.shape[-1])))
    return convolve(op, xp.concat([z, filler], axis=-2), xp)[..., :wanted, :]


# -- design ----------------------------------------------------------------------------------------------


def convolution(taps: Array, steps: int = PIECE) -> Convolution:
    """The cheapest way to convolve with `taps` (length, inputs, outputs), oldest sample first.

    `steps` : so many at a time.
    """
    single = _one_level(taps, _single_block(*taps.shape))
    if len(taps) < TWO_LEVELS_FROM:
        return single
    double = _two_levels(taps, _double_block(*taps.shape), steps)
    if double is None or double.multiplications + LEVEL / steps > single.multiplications:
        return single
    return double


def _single_block(length: int, inputs: int, outputs: int) -> int:
    """B that balances the products, (length + B) inputs outputs a step, against overhead and moves."""
    candidates = range(max(1, -(-WIDE // outputs)), max(2 * length, 64) + 1)
    return min(candidates, key=lambda B: _cost(B, length - 1 + B, inputs, outputs))


def _double_block(length: int, inputs: int, outputs: int) -> int:
    rank = outputs

    def cost(B: int) -> float:
        count, rest = divmod(length - B, B)
        near = _cost(B, 2 * B - 1 + rest + rank / inputs, inputs, outputs)
        # The moments are convolved in turn, in two levels once there are many.
        return near + inputs * rank + min(1.3 * max(count, 1), 3.0 * WIDE) * rank * rank / B

    longest = length // 3
    return min(range(min(max(2, -(-WIDE // outputs)), longest), longest + 1), key=cost)


def _cost(B: int, width: float, inputs: int, outputs: int) -> float:
    """Of one step: multiplications, and numbers moved; (B outputs) columns, width * inputs rows."""
    return width * inputs * outputs * (1.0 + WIDE / (2.0 * B * outputs)) + MOVE * width * inputs / B


def _entries(taps: Array, positions: Array, B: int) -> Array:
    """Rows of E for samples at these positions before (negative) and in the block: (positions m, B k)."""
    length, inputs, outputs = taps.shape
    index = positions[:, None] - np.arange(B) + length - 1
    inside = (index >= 0) & (index < length)
    rows = np.where(inside[:, :, None, None], taps[np.where(inside, index, 0)], 0.0)
    return np.ascontiguousarray(rows.transpose(0, 2, 1, 3)).reshape(len(positions) * inputs, B * outputs)


def _one_level(taps: Array, B: int) -> Convolution:
    length, inputs, outputs = taps.shape
    whole, rest = divmod(length - 1, B)
    near = [(0, rest)] if rest else []
    near += [(rest + i * B, B) for i in range(whole + 1)]
    E = _entries(taps, np.arange(1 - length, B), B)
    return Convolution(B, length - 1, inputs, outputs, tuple(near), (), E)


def _two_levels(taps: Array, B: int, steps: int = PIECE) -> Convolution | None:
    """Left edge, moments of whole blocks, and the newest samples; None where the taps are not so simple."""
    length, inputs, outputs = taps.shape
    count, rest = divmod(length - B, B)
    if count < 2:
        return None
    size = np.sqrt((taps**2).sum(axis=(0, 1)))
    size = np.where(size > 0.0, size, 1.0)
    start = B - length  # of the far samples, before the block
    shared = _entries(taps / size, np.arange(start, start + count * B), B)
    basis = _range(shared.reshape(-1, B, outputs)[:, _spread(B)].reshape(len(shared), -1))
    if basis is None:
        return None
    pieces = basis.reshape(count, B * inputs, -1)
    local = _range(pieces.transpose(1, 0, 2).reshape(B * inputs, -1))
    if local is None:
        return None
    transport = local.T @ pieces  # (count, p, r)
    seen = basis.T @ shared
    error = (local @ transport).reshape(len(basis), -1) @ seen - shared
    if not np.abs(error).max() <= FAITHFUL:
        return None
    near = [(0, B - 1), (length - 1 - rest, rest), (length - 1, B)]
    near = [piece for piece in near if piece[1]]
    places = np.concatenate([np.arange(o, o + w) for o, w in near]) - (length - 1)
    E = np.concatenate([_entries(taps, places, B), seen * np.tile(size, B)])
    inner = convolution(transport, max(1, steps // B))
    far = Far(B - 1, count, np.ascontiguousarray(local), inner)
    return Convolution(B, length - 1, inputs, outputs, tuple(near), (far,), np.ascontiguousarray(E))


def _spread(B: int) -> list[int]:
    return sorted({round(p) for p in np.linspace(0, B - 1, SHIFTS)})


def _range(A: Array) -> Array | None:
    """Orthonormal basis of the columns of A; None where it is as large as A has rows."""
    U, s, _ = np.linalg.svd(A, full_matrices=False)
    rank = max(1, int((s > NOISE * s[0]).sum())) if s.size and s[0] > 0.0 else 1
    return np.asarray(U[:, :rank]) if 2 * rank <= len(A) else None
