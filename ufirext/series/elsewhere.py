"""Whole series of constant models on arrays of torch, JAX, CuPy: the kernels of `series` on them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._array_api import Space
from .._arrays import Array
from ..errors import ShapeError, UfirextError
from .constant import head_covariances
from .estimate import SeriesEstimate
from .growth import head_states, moved_head
from .plan import SeriesPlan
from .toeplitz import convolve, moved

__all__ = ["filtered_elsewhere"]

# Rows that are filtered at once: intermediate products take a few times their memory.
PIECE = 1 << 22


def filtered_elsewhere(
    plan: SeriesPlan, zs: Any, engine: str, refused: Mapping[str, object]
) -> SeriesEstimate:
    """The estimates of zs (T, dim_z) or (S, T, dim_z), (T,) where dim_z is 1: x in the library of zs.

    `refused`: arguments that only NumPy arrays can have.
    """
    given = [name for name, value in refused.items() if value is not None]
    if engine not in ("auto", "toeplitz"):
        given.append(f"engine={engine!r}")
    if given:
        library = type(zs).__module__.partition(".")[0]
        raise UfirextError(f"{' and '.join(given)} must come with a NumPy array zs, got one of {library}")
    x = _filtered(plan, zs)
    first = min(plan.first - 1, x.shape[-2])
    ready: NDArray[np.bool_] = np.ones(tuple(x.shape[:-1]), dtype=np.bool_)
    ready[..., :first] = False
    return SeriesEstimate(x, ready, plan.horizon, plan.lag, partial(_covariances, plan, tuple(x.shape)))


def _covariances(plan: SeriesPlan, shape: tuple[int, ...]) -> Array:
    begin = min(plan.horizon - 1, shape[-2])
    P = np.empty((shape[-2], shape[-1], shape[-1]))
    P[:begin], P[begin:] = head_covariances(plan, begin), plan.gain.P
    return np.broadcast_to(P, (*shape[:-1], shape[-1], shape[-1]))


def _filtered(plan: SeriesPlan, zs: Any) -> Any:
    space = Space.of(zs, "zs")
    xp, z = space.xp, space.array(zs, "zs")
    m, n = plan.model.dim_z, plan.model.dim_x
    if z.ndim == 1 and m == 1:
        z = xp.reshape(z, (-1, 1))
    if z.ndim not in (2, 3) or z.shape[-1] != m:
        raise ShapeError(f"zs must have shape (T, {m}) or (S, T, {m}), got {tuple(z.shape)}")
    if not space.finite_or_nan(z, "zs"):
        raise UfirextError(
            f"zs must have no holes (NaN) as {space}: give a NumPy array, or filter tick by tick with Fleet"
        )
    begin = min(plan.horizon - 1, z.shape[-2])
    parts = [_head(plan, z[..., :begin, :], space)] if begin else []
    parts += _full(plan, z, space)
    if not parts:
        return xp.zeros((*z.shape[:-1], n), dtype=space.dtype, **space.placed)
    return xp.concat(parts, axis=-2)


def _head(plan: SeriesPlan, z: Any, space: Space) -> Any:
    if plan.head is None:
        raise UfirextError(
            f"the first {plan.horizon - 1} rows of this lag or model need a filter that goes step by step: "
            "give a NumPy array"
        )
    return head_states(moved_head(plan.head, _converter(space)), z, space.xp)


def _full(plan: SeriesPlan, z: Any, space: Space) -> list[Any]:
    """Full windows, in pieces of whole blocks."""
    xp, op = space.xp, moved(plan.convolution, _converter(space))
    first, steps, parts = plan.horizon - 1, z.shape[-2], []
    count = 1 if z.ndim == 2 else max(1, z.shape[0])
    length = max(1, PIECE // count // op.block) * op.block
    for start in range(first, steps, length):
        stop = min(start + length, steps)
        rows = z[..., start - first : stop, :]
        short = -(stop - start) % op.block
        if short:
            zeros = xp.zeros((*z.shape[:-2], short, z.shape[-1]), dtype=space.dtype, **space.placed)
            rows = xp.concat([rows, zeros], axis=-2)
        parts.append(convolve(op, rows, xp)[..., : stop - start, :])
    return parts


def _converter(space: Space) -> Any:
    def convert(values: Array) -> Any:
        return space.constant(values)

    return convert
