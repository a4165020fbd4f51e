"""Coercion, shapes and messages for every array that enters the library."""

from __future__ import annotations

import math
import operator
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ._lapack import Array as Array
from ._lapack import is_positive_definite
from .errors import CovarianceError, HorizonError, NonFiniteError, ShapeError, UfirextError

Shape = tuple[int | None, ...]

FLOAT = np.dtype(float)

# What NumPy makes a float of and is none; None it makes a NaN.
NO_NUMBERS = (str, bytes, complex, np.complexfloating, np.datetime64, np.timedelta64)

# A covariance may miss positive semidefiniteness by rounding: this fraction of its largest (scaled) entry.
PSD_SLACK = 1e-9
# Mirror images may differ by as much of it, but by no more than this fraction of their own scale.
SYMMETRY_SLACK = 1e-6
# Differences of matrices may leave a variance below zero, by so much of the largest entry.
VARIANCE_SLACK = 1e-12


def real(value: ArrayLike, name: str) -> Array:
    """A fresh float64 array; complex, text, times, ragged and masked input are refused."""
    if value.__class__ is np.ndarray and value.dtype == float:
        return value.copy()
    return _numbers(without_mask(value, name), name)


def readings(value: ArrayLike, name: str) -> Array:
    """A fresh float64 array of measurements: as `real`, but a masked entry is a missing one, NaN."""
    if value.__class__ is np.ndarray and value.dtype == float:
        return value.copy()
    return _numbers(unmasked(value)[0], name)


def unmasked(value: Any) -> tuple[Any, bool]:
    """`value` with NaN for its masked entries, inside lists too, and whether there are any."""
    ma: Any = sys.modules.get("numpy.ma")  # NumPy loads it on demand: before that nobody has such an array
    if ma is None:
        return value, False
    if isinstance(value, ma.MaskedArray):
        data, hidden = np.asarray(value), ma.getmask(value)
        if data.dtype.kind not in "fiubO" or not hidden.any():
            return data, False
        return np.where(hidden, np.nan, data), True
    if isinstance(value, list | tuple) and any(
        issubclass(kind, list | tuple | ma.MaskedArray) for kind in set(map(type, value))
    ):
        parts = [unmasked(part) for part in value]
        if any(hidden for _, hidden in parts):
            return [part for part, _ in parts], True
    return value, False


def masked_constant() -> Any:
    """`numpy.ma.masked`, or None while nobody can have it."""
    ma: Any = sys.modules.get("numpy.ma")
    return None if ma is None else ma.masked


def require_real(raw: np.ndarray[Any, Any]) -> None:
    """Raise a TypeError unless the entries are real numbers: NumPy reads text, and takes times for counts."""
    kinds = set(map(type, raw.ravel().tolist())) if raw.dtype.kind == "O" else ()
    if raw.dtype.kind in "cmMSTU" or any(issubclass(kind, NO_NUMBERS) for kind in kinds):
        raise TypeError("complex numbers, times or text")


def without_mask(value: Any, name: str) -> Any:
    """`value` where a mask says nothing; one with masked entries is refused."""
    plain, hidden = unmasked(value)
    if hidden:
        raise NonFiniteError(
            f"{name} must have no masked entries, whose numbers mean nothing, got {value!s:.80}"
        )
    return plain


def _numbers(value: Any, name: str) -> Array:
    try:
        raw = np.asarray(value)
        require_real(raw)
        with np.errstate(over="ignore"):  # of longer floats: infinity, as it is told of
            return np.array(raw, dtype=float)
    except OverflowError as error:
        raise NonFiniteError(f"{name} must be numbers below 1.8e308, got {shown(value)}") from error
    except (TypeError, ValueError) as error:
        raise ShapeError(f"{name} must be an array of real numbers, got {shown(value)}") from error


def shown(value: Any) -> str:
    """The beginning of `value` as Python writes it."""
    if isinstance(value, int) and value.bit_length() > 1024:
        return f"an int of {value.bit_length()} bits"
    try:
        return f"{value!r:.80}"
    except ValueError:  # so large an int inside
        return f"a {type(value).__name__} of numbers that are too large"


def number(value: Any, name: str) -> float:
    """One real number, NaN and infinities included, as a float."""
    if value.__class__ is float:
        return float(value)
    try:
        if value is None or np.ndim(value):
            raise TypeError("none, or several")
        return float(real(value, name))
    except (TypeError, ValueError) as error:
        raise ShapeError(f"{name} must be a number, got {shown(value)}") from error


def finite(array: Array, name: str) -> Array:
    """`array` itself, after checking that it holds neither NaN nor infinity."""
    # The sum of squares is the quickest look, and unlike a plain sum it warns of nothing.
    if not math.isfinite(np.vdot(array, array)) and not np.isfinite(array).all():
        bad = [tuple(int(i) for i in where) for where in np.argwhere(~np.isfinite(array))[:3]]
        raise NonFiniteError(f"{name} must be finite, got NaN or inf at {', '.join(map(str, bad))}")
    return array


def matrix(value: ArrayLike, shape: Shape, name: str, meaning: str = "") -> Array:
    """A finite float64 matrix of `shape` (None: any size); a scalar fits where every size is 1 or None."""
    array = real(value, name)
    return finite(array if array.shape == shape else _shaped(array, shape, name, meaning), name)


def _shaped(array: Array, shape: Shape, name: str, meaning: str) -> Array:
    if array.ndim == 0 and all(size in (1, None) for size in shape):
        array = array.reshape((1,) * len(shape))
    if array.ndim != len(shape) or any(
        s is not None and s != n for s, n in zip(shape, array.shape, strict=True)
    ):
        wanted = "(" + ", ".join("any" if size is None else str(size) for size in shape) + ")"
        raise ShapeError(
            f"{name} must have shape {wanted}{' ' + meaning if meaning else ''}, got {array.shape}"
        )
    return array


def square(value: ArrayLike, size: int, name: str, meaning: str = "") -> Array:
    """A finite (size, size) matrix; a scalar s stands for s * identity, as in filterpy."""
    shape = (size, size)
    if value.__class__ is np.ndarray and value.dtype is FLOAT and value.shape == shape:
        return finite(value.copy(), name)
    array = real(value, name)
    if array.ndim == 0:
        return np.eye(size) * finite(array, name)
    return finite(array if array.shape == shape else _shaped(array, shape, name, meaning), name)


def covariance(value: ArrayLike, size: int, name: str, meaning: str = "") -> Array:
    """A symmetric positive semidefinite (size, size) matrix; a scalar s stands for s * identity."""
    if value.__class__ is np.ndarray and value.dtype is FLOAT and value.shape == (size, size):
        array: Array = value.copy()
        if plainly_covariance(array):
            return array
    array = square(value, size, name, meaning)
    check_covariance(array, name)
    return array


def plainly_covariance(array: Array) -> bool:
    """Whether a look is enough; False proves nothing."""
    # LAPACK may find a factor of a matrix that holds NaN.
    regular = math.isfinite(np.vdot(array, array))
    return regular and array.tobytes() == array.tobytes("F") and plainly_positive(array)


def plainly_positive(array: Array) -> bool:
    """Whether a finite symmetric matrix is plainly positive semidefinite; False proves nothing."""
    if is_positive_definite(array):
        return True
    lifted = array.copy()  # noise of fewer sources than states: a singular Q
    lifted.ravel()[:: len(array) + 1] *= 1.0 + PSD_SLACK
    return is_positive_definite(lifted)


def check_covariance(array: Array, name: str) -> None:
    """Raise CovarianceError unless the finite square `array` is symmetric and positive semidefinite."""
    if plainly_covariance(array):
        return
    variances, scale = array.diagonal(), float(np.abs(array).max(initial=0.0))
    lowest = float(variances.min(initial=0.0))
    diagonal = np.count_nonzero(array) == np.count_nonzero(variances)
    if lowest < (0.0 if diagonal else -VARIANCE_SLACK * scale):
        raise CovarianceError(f"{name} must be positive semidefinite, got the variance {lowest:.3g}")
    if diagonal:
        return
    # Scaling by the diagonal makes the tests independent of the units of the states.
    width = np.sqrt(np.maximum(variances, 0.0))
    unit = np.where(width > 0.0, width, np.sqrt(scale))
    with np.errstate(over="ignore"):
        scaled, gaps = array / unit / unit[:, None], np.abs(array - array.T)
        apart = (gaps / unit / unit[:, None]).max()
    gap = float(gaps.max())
    if apart > SYMMETRY_SLACK or gap > PSD_SLACK * scale:
        raise CovarianceError(f"{name} must be symmetric, got a difference of {gap:.3g} to its transpose")
    lowest = float(np.linalg.eigvalsh(scaled)[0]) if np.isfinite(scaled).all() else -math.inf
    if lowest < -PSD_SLACK * len(array):
        raise CovarianceError(
            f"{name} must be positive semidefinite, its smallest (scaled) eigenvalue is {lowest:.3g}"
        )


def column(value: ArrayLike, size: int, name: str) -> Array:
    """A vector of `size` in any of filterpy's forms (scalar, list, row, column) as a flat (size,) array."""
    return flat(real(value, name), size, name)


def flat(array: Array, size: int, name: str) -> Array:
    """`array`, a vector of `size` in any of filterpy's forms, as a flat (size,) array."""
    shape = array.shape
    if shape == (size,):
        return array
    if shape != (size, 1) and (array.size != size or array.ndim > 2 or sum(n != 1 for n in shape) > 1):
        raise ShapeError(f"{name} must hold {size} number{'s' if size != 1 else ''}, got shape {shape}")
    return array.reshape(-1)


def integer(
    value: Any,
    name: str,
    lowest: int,
    highest: int | None = None,
    advice: str = "",
    refusal: type[UfirextError] = HorizonError,
) -> int:
    """`value` as an int in [lowest, highest]; bools and floats are refused."""
    tail = f"; {advice}" if advice else ""
    try:
        if isinstance(value, bool | np.bool_):
            raise TypeError("a bool is not a count")
        number = operator.index(value)
    except TypeError as error:
        raise refusal(f"{name} must be an integer, got {shown(value)}{tail}") from error
    if number < lowest or (highest is not None and number > highest):
        wanted = f"at least {lowest}" if highest is None else f"between {lowest} and {highest}"
        raise refusal(f"{name} must be {wanted}, got {shown(number)}{tail}")
    return number


def dimension(value: Any, name: str, lowest: int, counted: str) -> int:
    """`value` as an int of at least `lowest`: how many of what is counted there are."""
    return integer(value, name, lowest, advice=f"it is the number of {counted}", refusal=ShapeError)


def lag_within(horizon: int, lag: Any) -> int:
    """`lag` as an int: how many steps before its newest state a window of `horizon` steps is asked for."""
    held = f"the window holds {horizon} state{'s' if horizon != 1 else ''}, up to the newest one"
    return integer(lag, "lag", 0, horizon - 1, held)


def rectangular(value: Any, name: str) -> np.ndarray[Any, Any]:
    """`value` as an array of whatever it holds; masked entries are refused."""
    plain = without_mask(value, name)
    try:
        return np.asarray(plain)
    except ValueError as error:
        raise ShapeError(f"{name} must be an array of integers, got {shown(value)}") from error


def require_counts(array: np.ndarray[Any, Any], name: str) -> None:
    """Raise unless the integers of `array` are at least 0 and fit into int64, where unsigned ones may not."""
    if not array.size:
        return
    lowest, highest, limit = int(array.min()), int(array.max()), np.iinfo(np.int64).max
    if lowest < 0:
        raise HorizonError(f"{name} must be at least 0, got {lowest}")
    if highest > limit:
        raise HorizonError(f"{name} must be at most {limit}, got {highest}")


def one_of(value: Any, allowed: Sequence[str], name: str) -> None:
    """Raise unless `value` is one of the words allowed."""
    if not isinstance(value, str) or value not in allowed:
        raise UfirextError(f"{name} must be one of {', '.join(map(repr, allowed))}, got {value!r:.80}")


def symmetric(array: Array) -> Array:
    """The symmetric part, which rounding may have left."""
    return 0.5 * (array + array.T)


def readonly(array: Array) -> Array:
    """`array` itself, with writing switched off."""
    array.setflags(write=False)  # half the time of array.flags.writeable = False
    return array
