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
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from .._arrays import Array

__all__ = ["Convolution", "Far", "convolution", "convolve", "moved", "piece"]

# Singular values below this fraction of the largest are rounding.
NOISE = 4e-15
# Two levels must reproduce the taps to this fraction of the largest tap's row norm.
FAITHFUL = 4e-15
# Shifts of the taps from which a basis of all of them is taken.
SHIFTS = 6
# A series is worked off in pieces of about so many numbers in and out, which stay in a processor's cache.
NUMBERS = 98_304
# What a product costs beside its multiplications, counted in them: columns come in multiples of LANES, a row
# of the result costs ROW, a number of it ENTRY, or PACKED in products of more than SMALL multiplications,
# which BLAS copies first, a sample (of many series, which do not lie side by side) MOVE, and a call CALL.
LANES, ROW, ENTRY, PACKED, SMALL, MOVE, CALL = 8, 28.0, 1.4, 8.0, 1e6, 8.0, 20_000.0
# Two levels round more often than one: they are worth it at this fraction of the cost.
WORTH = 0.8
# Blocks are tried up to so many numbers of output, and of so many samples at least.
BROAD, FEW = 96, 4


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


Choice = tuple[float, int]  # cost of a step, in multiplications, and block


def piece(inputs: int, outputs: int) -> int:
    """Samples of a piece."""
    return NUMBERS // (inputs + outputs) or 1


def convolution(taps: Array, steps: int | None = None) -> Convolution:
    """The cheapest way to convolve with `taps` (length, inputs, outputs), oldest sample first.

    `steps` : so many at a time, by default a piece.
    """
    steps = steps or piece(*taps.shape[1:])
    (_, single), (_, double) = _choice(*taps.shape, steps)
    while double and 3 * double <= len(taps):
        found = _two_levels(taps, double, steps)
        if found is not None:
            return found
        double *= 2  # more moments than expected pay from longer blocks on
    return _one_level(taps, single)


@lru_cache(maxsize=4096)
def _choice(length: int, inputs: int, outputs: int, steps: int) -> tuple[Choice, Choice]:
    """One level, and two levels or more; block 0 where these do not pay."""
    blocks = range(1, max(BROAD // outputs, FEW) + 1)
    single = min((_single_cost(length, inputs, outputs, B, steps), B) for B in blocks)
    deeper = [B for B in blocks if length >= 3 * B and _moments(length, outputs, B) <= B * inputs / 2]
    double = min(((_double_cost(length, inputs, outputs, B, steps), B) for B in deeper), default=single)
    return single, double if double[0] < WORTH * single[0] else (single[0], 0)


def _single_cost(length: int, inputs: int, outputs: int, B: int, steps: int) -> float:
    products = 1 - (1 - length) // B  # of the length - 1 samples before a block and its own
    return products * _product(B * inputs, B * outputs, B, steps)


def _double_cost(length: int, inputs: int, outputs: int, B: int, steps: int) -> float:
    count, moments = _shared_blocks(length, B)[0], _moments(length, outputs, B)
    own = 2 * _product(B * inputs, B * outputs, B, steps) + _product(outputs, B * outputs, B, steps)
    own += _product(B * inputs, moments, B, steps)
    within = min(_choice(count, moments, outputs, max(1, steps // B)))[0]
    return own + within / B


def _moments(length: int, outputs: int, B: int) -> int:
    """Numbers that stand for a block: as many as the taps have outputs, twice as many if one is not whole."""
    return outputs * (2 if _shared_blocks(length, B)[1] else 1)


def _product(rows: int, columns: int, B: int, steps: int) -> float:
    """What one product adds to the cost of a step."""
    entry = ENTRY if rows * columns * steps <= SMALL * B else PACKED
    return (-(-columns // LANES) * LANES * rows + ROW + entry * columns + MOVE * rows) / B + CALL / steps


def _shared_blocks(length: int, B: int) -> tuple[int, int]:
    """How many blocks of samples all outputs of a block share, and by how many samples the last is short.

    The samples before them are the left edge, B - 1 or B.
    """
    count, rest = divmod(length - B, B)
    return (count, 0) if rest < 2 else (count + 1, B - rest)


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


def _two_levels(taps: Array, B: int, steps: int) -> Convolution | None:
    """Left edge, moments of blocks, and the newest samples; None where the taps are not so simple."""
    length, inputs, outputs = taps.shape
    count, short = _shared_blocks(length, B)
    edge = length - 1 - count * B + short
    size = np.sqrt((taps**2).sum(axis=(0, 1)))
    size = np.where(size > 0.0, size, 1.0)
    start = edge + 1 - length  # of the far samples, before the block
    shared = _entries(taps / size, np.arange(start, start + count * B), B)
    # What the last block has too many are samples of the outputs' own block.
    shared[len(shared) - short * inputs :] = 0.0
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
    near = tuple(piece for piece in ((0, edge), (length - 1, B)) if piece[1])
    places = np.concatenate([np.arange(o, o + w) for o, w in near]) - (length - 1)
    E = np.concatenate([_entries(taps, places, B), seen * np.tile(size, B)])
    inner = convolution(transport, max(1, steps // B))
    far = Far(edge, count, np.ascontiguousarray(local), inner)
    return Convolution(B, length - 1, inputs, outputs, near, (far,), np.ascontiguousarray(E))


def _spread(B: int) -> list[int]:
    return sorted({round(p) for p in np.linspace(0, B - 1, SHIFTS)})


def _range(A: Array) -> Array | None:
    """Orthonormal basis of the columns of A; None where it is as large as A has rows."""
    U, s, _ = np.linalg.svd(A, full_matrices=False)
    rank = max(1, int((s > NOISE * s[0]).sum())) if s.size and s[0] > 0.0 else 1
    return np.asarray(U[:, :rank]) if 2 * rank <= len(A) else None
