"""The first windows of a series, which grow by a row a step, for all steps at once.

Short windows have a gain each. Longer ones, up to twice as long as the last, share an orthonormal basis U
of the longest of them: x^ = W_n sum_{i <= n} U_i' z_i, W_n = T_n (sum_{i <= n} U_i' U_i)^-1. That basis is
well conditioned on all of them, so that one cumulative sum gives all. Models that grow too much for that
(unstable ones over long windows) are filtered row by row: a growing window is a recursion with known gains.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from .._arrays import Array
from .._constant import WELL_CONDITIONED, observations
from ..errors import UnobservableWindow
from ..gains import observability_index, ufir_gain
from ..joint import square_root
from ..minimum_variance import minimum_variance_gain
from ..model import Model
from ..window import whitener

__all__ = ["GROUP", "Basis", "Head", "basis_of", "head_of", "head_states", "moved_head"]

# Windows up to this length have a gain each; of minimum variance, whose gains cost more, so many longer ones.
SHORT, SHORT_BEYOND = 32, 4
# Entries of a matrix beyond which sums are cheaper.
DENSE = 25_000
# Series that enter one product together; always so many, because bits depend on the size of a product.
GROUP = 8
# Sums of products of basis vectors that are conditioned worse than this lose too many digits.
SHARED_CONDITION = 1e3


class Dense(NamedTuple):
    """Windows of low + 1 .. high rows by one matrix, (high dim_z, (high - low) dim_x)."""

    low: int
    high: int
    matrix: Any


class Shared(NamedTuple):
    """Windows of low + 1 .. high rows: x^ = W_n' eta_n, eta_n = sum_{i <= low + n} basis_i' z_i.

    basis : (dim_z, dim_x, high), W : (dim_x, dim_x, high - low).
    """

    low: int
    high: int
    basis: Any
    W: Any


class Recursion(NamedTuple):
    """Windows of more than `low` rows: x <- F x + gains[n] (z - H F x)."""

    low: int
    F: Any
    H: Any
    gains: Any


class Head(NamedTuple):
    """Growing windows of first .. length rows, in parts that follow each other."""

    first: int
    length: int
    parts: tuple[Dense | Shared, ...]
    recursion: Recursion | None


def moved_head(head: Head, convert: Callable[[Array], Any]) -> Head:
    """The same head with its matrices converted, to another array library, device or type."""
    parts = tuple(
        part._replace(matrix=convert(part.matrix))
        if isinstance(part, Dense)
        else part._replace(basis=convert(part.basis), W=convert(part.W))
        for part in head.parts
    )
    recursion = head.recursion
    if recursion is not None:
        recursion = recursion._replace(
            F=convert(recursion.F), H=convert(recursion.H), gains=convert(recursion.gains)
        )
    return head._replace(parts=parts, recursion=recursion)


def head_states(head: Head, z: Any, xp: Any = np) -> Any:
    """Estimates of the first steps from (.., T, dim_z), T <= length: (.., T, dim_x); NaN before the first."""
    steps = z.shape[-2]
    parts = [
        _dense_states(part, z, xp) if isinstance(part, Dense) else _shared_states(part, z, xp)
        for part in head.parts
        if part.low < steps or not part.low
    ]
    if head.recursion is not None and steps > head.recursion.low:
        parts += _recursive_states(head.recursion, parts[-1][..., -1, :], z, xp)
    early = min(head.first - 1, parts[0].shape[-2])
    parts[:1] = [xp.full_like(parts[0][..., :early, :], float("nan")), parts[0][..., early:, :]]
    return xp.concat(parts, axis=-2)


def _dense_states(part: Dense, z: Any, xp: Any) -> Any:
    """(.., rows, dim_x), a product for every group of series."""
    stop, lead = min(part.high, z.shape[-2]), z.shape[:-2]
    states = part.matrix.shape[1] // (part.high - part.low)
    flat = xp.reshape(z[..., :stop, :], (-1, stop * z.shape[-1]))
    count, width = flat.shape
    rows = xp.concat([flat] + [xp.zeros_like(flat[:1, :])] * (-count % GROUP), axis=0)
    grouped = xp.reshape(rows, (-(-count // GROUP), GROUP, width))
    x = xp.matmul(grouped, part.matrix[:width, : (stop - part.low) * states])
    flat = xp.reshape(x, (-1, x.shape[-1]))[:count, :]
    return xp.reshape(flat, (*lead, stop - part.low, states))


def _shared_states(part: Shared, z: Any, xp: Any) -> Any:
    """(.., rows, dim_x); on the way time is the last axis, along which loops are long."""
    stop = min(part.high, z.shape[-2])
    basis, W = part.basis[..., :stop], part.W[..., : stop - part.low]
    own = z[..., None, :stop, 0] * basis[0, ...]
    for m in range(1, basis.shape[0]):
        own = own + z[..., None, :stop, m] * basis[m, ...]
    eta = xp.cumulative_sum(own, axis=-1)[..., part.low :]
    x = eta[..., :1, :] * W[0, ...]
    for r in range(1, W.shape[0]):
        x = x + eta[..., r : r + 1, :] * W[r, ...]
    return xp.moveaxis(x, -1, -2)


def _recursive_states(part: Recursion, x: Any, z: Any, xp: Any) -> list[Any]:
    turned, seen = xp.permute_dims(part.F, (1, 0)), xp.permute_dims(part.H, (1, 0))
    parts = []
    for step in range(part.low, z.shape[-2]):
        x = xp.matmul(x[..., None, :], turned)
        innovation = z[..., step : step + 1, :] - xp.matmul(x, seen)
        x = x + xp.matmul(innovation, xp.permute_dims(part.gains[step - part.low, ...], (1, 0)))
        parts.append(x)
        x = x[..., 0, :]
    return parts


# -- design ----------------------------------------------------------------------------------------------


def head_of(model: Model, length: int, lag: int, unbiased: bool) -> Head | None:
    """Windows of up to `length` rows of UFIR, or else of minimum variance; None where only a filter that
    goes step by step knows them.
    """
    index = observability_index(model) or 1
    if not unbiased and lag:
        return None
    least = max(index, lag + 1)
    low = min(max(SHORT, least) if unbiased else least + SHORT_BEYOND, length)
    gains = {count: _gain(model, count, lag, unbiased) for count in range(least, low + 1)}
    found = [count for count, K in gains.items() if K is not None]
    first = found[0] if found else low + 1
    n, m = model.dim_x, model.dim_z
    short = np.zeros((low * n, low * m))
    for count in found:
        short[(count - 1) * n : count * n, : count * m] = gains[count]
    head = Head(first, length, (Dense(0, low, np.ascontiguousarray(short.T)),), None)
    if length <= low:
        return head
    shared = _shared(model, low, length, lag) if unbiased and first <= low else None
    if shared is not None:
        return head._replace(parts=head.parts + tuple(_multiplied(part) for part in shared))
    start = gains[low]
    if lag or start is None:
        return None
    return head._replace(recursion=_recursion(model, start, low, length, unbiased))


def _gain(model: Model, count: int, lag: int, unbiased: bool) -> Array | None:
    try:
        return (ufir_gain if unbiased else minimum_variance_gain)(model, count, lag).K
    except UnobservableWindow:
        return None


def _shared(model: Model, low: int, length: int, lag: int) -> tuple[Shared, ...] | None:
    """Bases for windows of low + 1 .. length rows; None where one of them is ill conditioned."""
    parts = []
    while low < length:
        high = min(2 * low, length)
        part = _basis(model, low, high, lag)
        if part is None:
            return None
        parts.append(part)
        low = high
    return tuple(parts)


def _multiplied(part: Shared) -> Dense | Shared:
    """Where it is small enough, one matrix: columns W_n' basis_i', zero for rows i that are not there yet."""
    inputs, states = part.basis.shape[:2]
    rows = part.high - part.low
    if part.high * inputs * rows * states > DENSE:
        return part
    blocks = np.einsum("mri,rkn->imnk", part.basis, part.W, optimize=True)
    blocks *= (np.arange(part.high)[:, None] <= part.low + np.arange(rows))[:, None, :, None]
    return Dense(part.low, part.high, blocks.reshape(part.high * inputs, rows * states))


class Basis(NamedTuple):
    """Orthonormal basis of a full window: whitened rows, the same for raw measurements, the oldest state.

    white, raw : (length, dim_z, dim_x); back : (dim_x, dim_x), x_oldest = back (sum_i white_i' white_i)^-1
    sum_i raw_i' z_i over the rows that are there.
    """

    white: Array
    raw: Array
    back: Array


def basis_of(model: Model, length: int) -> Basis | None:
    """The basis of the window of `length` steps; None where it is ill conditioned."""
    n, m = model.dim_x, model.dim_z
    W = whitener(model.R)
    with np.errstate(over="ignore", invalid="ignore"):
        C = observations(W @ model.H, model.F, length)
        scale = np.sqrt(np.einsum("ij,ij->j", C, C))
    if not (np.isfinite(scale).all() and scale.all()):
        return None
    U, s, Vt = np.linalg.svd(C / scale, full_matrices=False)
    if s[0] > WELL_CONDITIONED * s[-1]:
        return None
    white = U.reshape(length, m, n)
    return Basis(white, W.T @ white, (Vt.T / s) / scale[:, None])


def _basis(model: Model, low: int, high: int, lag: int) -> Shared | None:
    basis = basis_of(model, high)
    if basis is None:
        return None
    n, blocks = model.dim_x, basis.white
    Lam = np.cumsum(blocks.transpose(0, 2, 1) @ blocks, axis=0)[low:]
    values = np.linalg.eigvalsh(Lam)
    if not (values[:, -1] <= SHARED_CONDITION * values[:, 0]).all():
        return None
    aims = np.empty((high - low, n, n))
    aims[0] = np.linalg.matrix_power(model.F, low - lag) @ basis.back
    for step in range(1, high - low):
        np.matmul(model.F, aims[step - 1], out=aims[step])
    W = np.linalg.solve(Lam, aims.transpose(0, 2, 1))  # transposed: eta W = x
    raw = np.ascontiguousarray(basis.raw.transpose(1, 2, 0))
    return Shared(low, high, raw, np.ascontiguousarray(W.transpose(1, 2, 0)))


def _recursion(model: Model, start: Array, low: int, length: int, unbiased: bool) -> Recursion:
    """Gains of the square-root Kalman filter that goes on from the window of `low` rows; Q = 0 is UFIR."""
    n, m, white = model.dim_x, model.dim_z, whitener(model.R)
    if unbiased:
        own = start.reshape(-1, m) @ np.linalg.inv(white)
        S = _lower(own.reshape(n, -1))
        noise = np.zeros((n, 0))
    else:
        S = square_root(minimum_variance_gain(model, low).P)
        noise = square_root(model.Q)
    H = white @ model.H
    gains = np.empty((length - low, n, m))
    for step in range(length - low):
        S = np.hstack([model.F @ S, noise])
        seen = H @ S
        wide = np.block([[np.eye(m), seen], [np.zeros((n, m)), S]])
        lower = _lower(wide)
        K = np.linalg.solve(lower[:m, :m].T, lower[m:, :m].T).T
        S = _lower(np.hstack([S - K @ seen, K]))
        gains[step] = K @ white
    return Recursion(low, model.F, model.H, gains)


def _lower(A: Array) -> Array:
    """Lower triangular (trapezoidal) L with L L' = A A'."""
    return np.asarray(np.linalg.qr(A.T, mode="r")).T
