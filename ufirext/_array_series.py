"""Whole series of constant models on arrays of torch, JAX, CuPy: the kernels of `series` on them."""

from __future__ import annotations

from typing import Any

from ._array_api import Space
from ._arrays import Array
from .errors import ShapeError, UfirextError
from .series.growth import head_states, moved_head
from .series.plan import SeriesPlan
from .series.toeplitz import convolve, moved

__all__ = ["filtered"]

# Rows that are filtered at once: intermediate products take a few times their memory.
PIECE = 1 << 22


def filtered(plan: SeriesPlan, zs: Any) -> tuple[Any, Any]:
    """x (.., T, dim_x) and ready (.., T) of zs (T, dim_z) or (S, T, dim_z), (T,) where dim_z is 1.

    In the library, on the device and in the dtype of zs.
    """
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
    x = (
        xp.concat(parts, axis=-2)
        if parts
        else xp.zeros((*z.shape[:-1], n), dtype=space.dtype, **space.placed)
    )
    return x, ~xp.any(xp.isnan(x), axis=-1)


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
