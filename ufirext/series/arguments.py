"""What callers hand over, in one form."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._arrays import (
    Array,
    check_covariance,
    covariance,
    finite,
    masked_constant,
    matrix,
    readings,
    real,
    rectangular,
    require_counts,
    unmasked,
)
from ..errors import HorizonError, NonFiniteError, ShapeError, UfirextError
from ..model import Model

__all__ = [
    "Prior",
    "as_delays",
    "as_inputs",
    "as_output",
    "as_per_step",
    "as_prior",
    "as_series",
    "holes",
]

# Numbers that are searched for holes at once.
LOOKED_AT = 65_536


def as_series(zs: Any, dim_z: int) -> tuple[Array, bool]:
    """Measurements as (S, T, dim_z), not copied where they are numbers already, and whether S was given."""
    zs, _ = unmasked(_without_none(zs, dim_z))
    plain = isinstance(zs, np.ndarray) and zs.dtype.kind in "fiu" and np.can_cast(zs.dtype, float)
    array = zs if plain else real(zs, "zs")
    if array.ndim == 1 and (dim_z == 1 or not len(array)):
        array = array.reshape(-1, dim_z)
    if array.ndim not in (2, 3) or array.shape[-1] != dim_z:
        single = " or (T,)" if dim_z == 1 else ""
        advice = ""
        if array.ndim == 3 and array.shape[1:] == (dim_z, 1):
            advice = "; give columns without their last axis: zs[..., 0]"
        elif dim_z == 1 and array.ndim == 2:
            advice = "; give many series of one component as zs[..., None]"
        raise ShapeError(
            f"zs must have shape (T, {dim_z}){single} for one series or (S, T, {dim_z}) for many, "
            f"got {array.shape}{advice}"
        )
    return (array, True) if array.ndim == 3 else (array[None], False)


def _without_none(zs: Any, dim_z: int) -> Any:
    """A list in which None or numpy.ma.masked stands for a measurement that is missing: NaN in its place."""
    masked = masked_constant()
    if not isinstance(zs, Sequence) or isinstance(zs, str) or not any(z is None or z is masked for z in zs):
        return zs
    lost = np.full(dim_z, np.nan)
    return [lost if z is None or z is masked else readings(z, "zs").reshape(-1) for z in zs]


def holes(z: Array) -> NDArray[np.bool_]:
    """Which of the series (S, T, dim_z) have NaN, a measurement that is missing; infinities are refused."""
    found = np.zeros(len(z), dtype=np.bool_)
    if z.dtype.kind != "f":
        return found
    together, width = max(1, LOOKED_AT // max(z[:1].size, 1)), max(1, LOOKED_AT // z.shape[2])
    for first in range(0, len(z), together):
        if _plainly_finite(z[first : first + together]):
            continue
        for series in range(first, min(first + together, len(z))):
            for start in range(0, z.shape[1], width):
                part = z[series, start : start + width]
                found[series] |= not _plainly_finite(part) and _has_nan(part, series, start)
    return found


def _plainly_finite(part: Array) -> bool:
    """Whether a quick look, at the sum of squares, suffices."""
    if not part.flags.c_contiguous or part.size > LOOKED_AT:
        return False
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(np.vdot(part, part)))


def _has_nan(part: Array, series: int, start: int) -> bool:
    infinite = np.isinf(part)
    if infinite.any():
        step = start + int(np.argwhere(infinite)[0][0])
        raise NonFiniteError(
            f"zs must be finite, NaN where a measurement is missing, "
            f"got inf at step {step} of series {series}"
        )
    return bool(np.isnan(part).any())


def as_inputs(us: ArrayLike | None, model: Model, shape: tuple[int, int]) -> Array | None:
    """Known inputs as (S, T, dim_u); one series of inputs serves all series of measurements."""
    if us is None:
        return None
    if model.B is None:
        raise ShapeError("us needs a model with an input matrix B (dim_x, dim_u), this one has none")
    array = finite(real(us, "us"), "us")
    if array.ndim == 1 and model.dim_u == 1:
        array = array[:, None]
    wanted = (*shape, model.dim_u)
    if array.ndim not in (2, 3) or array.shape not in (wanted, wanted[1:]):
        raise ShapeError(f"us must have shape {wanted[1:]} or {wanted} (S, T, dim_u), got {array.shape}")
    return np.broadcast_to(array, wanted)


def as_delays(delays: ArrayLike | None, shape: tuple[int, int]) -> NDArray[np.int64] | None:
    """Delays in steps as (S, T); None where all are zero."""
    if delays is None:
        return None
    array = rectangular(delays, "delays")
    if array.dtype.kind not in "iu":
        raise HorizonError(
            f"delays must be integers (steps from a state to its measurement), got {delays!r:.60}"
        )
    if array.ndim > 2 or array.shape not in (shape, shape[1:], ()):
        raise ShapeError(f"delays must have shape {shape[1:]} or {shape} (S, T), got {array.shape}")
    require_counts(array, "delays")
    whole = np.broadcast_to(array.astype(np.int64), shape)
    return whole if whole.any() else None


def as_per_step(given: Mapping[str, ArrayLike | None], model: Model, steps: int) -> dict[str, Array | None]:
    """F, Q, H, R of each step as (T, ..), None where the model's hold; None in a list: the model's."""
    n, m = model.dim_x, model.dim_z
    shapes = {"F": (n, n), "Q": (n, n), "H": (m, n), "R": (m, m)}
    result: dict[str, Array | None] = {}
    for name, values in given.items():
        if values is None:
            result[name] = None
            continue
        filled: Any = values
        if isinstance(values, Iterable) and not isinstance(values, np.ndarray):
            filled = [getattr(model, name) if value is None else value for value in filled]
        wanted = (steps, *shapes[name])
        if values.__class__ is np.ndarray and values.dtype == float and values.shape == wanted:
            found = finite(values, f"{name}s")
        else:
            found = matrix(filled, wanted, f"{name}s", f"(T, {', '.join(_SIZES[name])})")
        if name in "QR":
            _check_covariances(found, f"{name}s")
        result[name] = found
    return result


def _check_covariances(P: Array, name: str) -> None:
    """Raise unless every one of P (T, n, n) is symmetric and positive semidefinite."""
    n = P.shape[1]
    diagonal = np.einsum("tii->ti", P)
    plain = (diagonal >= 0.0).all(axis=1)
    if n > 1:
        plain &= np.count_nonzero(P, axis=(1, 2)) == np.count_nonzero(diagonal, axis=1)
    for step in np.flatnonzero(~plain).tolist():
        check_covariance(P[step], f"{name}[{step}]")


_SIZES = {
    "F": ("dim_x", "dim_x"),
    "Q": ("dim_x", "dim_x"),
    "H": ("dim_z", "dim_x"),
    "R": ("dim_z", "dim_z"),
}


@dataclass(frozen=True)
class Prior:
    """The state before the first step and its covariance, one for each series: (S, n) and (S, n, n)."""

    x: Array
    P: Array


def as_prior(prior: Any, model: Model, count: int) -> Prior | None:
    """(x, P), for all series or one for each."""
    if prior is None:
        return None
    try:
        x, P = prior
    except (TypeError, ValueError):
        raise UfirextError(f"prior must be a pair (x, P), got {prior!r:.60}") from None
    n = model.dim_x
    mean = finite(real(x, "prior[0] (x)"), "prior[0] (x)")
    if mean.shape in ((n, 1), ()):
        mean = mean.reshape(-1)
    if mean.shape not in ((n,), (count, n)):
        raise ShapeError(
            f"prior[0] (x) must have shape ({n},) or ({count}, {n}) (S, dim_x), got {mean.shape}"
        )
    spread = real(P, "prior[1] (P)")
    if spread.ndim == 3:
        spread = matrix(spread, (count, n, n), "prior[1] (P)", "(S, dim_x, dim_x)")
        spread = np.array([covariance(one, n, "prior[1] (P)") for one in spread])
    else:
        spread = covariance(spread, n, "prior[1] (P)", "(dim_x, dim_x)")
    return Prior(np.broadcast_to(mean, (count, n)), np.broadcast_to(spread, (count, n, n)))


def as_output(out: Any, shape: tuple[int, ...], read: Mapping[str, Array | None]) -> Array:
    """The array results are written to: the caller's, or a fresh one; `read`: arrays that are still read."""
    if out is None:
        return np.empty(shape)
    if not isinstance(out, np.ndarray) or out.dtype.kind != "f" or not out.flags.writeable:
        raise ShapeError(f"out must be a writeable array of floats, got {type(out).__name__}")
    if out.shape != shape:
        raise ShapeError(f"out must have shape {shape}, as x has, got {out.shape}")
    for name, array in read.items():
        if array is not None and np.may_share_memory(out, array):
            raise UfirextError(
                f"out must not share memory with {name}, which is still read while out is written"
            )
    return out
