"""Arrays of other libraries, on their device and in their dtype, through the array API standard.

NumPy arrays, lists and numbers never need more than NumPy. Everything else (torch, JAX, CuPy, any library
that follows the standard) goes through array-api-compat, which is asked for only then.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ._arrays import require_real, shown, unmasked
from .errors import NonFiniteError, ShapeError, UfirextError

__all__ = ["Space", "is_native"]

# Libraries whose arrays NumPy would convert silently, copying them off their device.
FOREIGN = frozenset({"array_api_strict", "cupy", "jax", "jaxlib", "torch"})
# Libraries that take target[indices] = rows.
ASSIGNING = frozenset({"cupy", "torch"})
LAZY = frozenset({"dask", "xarray"})


def is_native(value: Any) -> bool:
    """Whether NumPy itself takes care of `value`: its arrays, numbers, lists, whatever it can convert."""
    if isinstance(value, np.ndarray | np.generic | list | tuple | int | float):
        return True
    library = type(value).__module__.partition(".")[0]
    if library in LAZY:
        raise UfirextError(
            f"{library} arrays are filtered lazily by ufirext.distributed, here an array in memory must be "
            f"given, got {type(value).__name__}: use ufirext.distributed, or its .compute() or .to_numpy()"
        )
    return library not in FOREIGN and (
        not hasattr(value, "__array_namespace__") or hasattr(value, "__array_interface__")
    )


@dataclass(frozen=True)
class Space:
    """Where a computation lives: the library's namespace, the dtype and the device.

    Attributes
    ----------
    xp : module
        NumPy, or the namespace that array-api-compat gives.
    dtype : dtype
        float32 or float64 of that library.
    device : object
        None for NumPy.
    """

    xp: Any
    dtype: Any
    device: Any = None

    @classmethod
    def of(cls, value: Any, name: str) -> Space:
        """The space of a caller's array: float32 stays float32, float64 float64, integers become float64.

        Raises
        ------
        ImportError
            For arrays of other libraries without array-api-compat.
        ShapeError
            For complex numbers, half precision, text, ragged lists.
        """
        if is_native(value):
            return cls(
                np, np.dtype(np.float32) if _native(value, name).dtype == np.float32 else np.dtype(float)
            )
        compat = _compat(type(value).__module__.partition(".")[0])
        xp = compat.array_namespace(value)
        device = compat.device(value)
        if value.dtype in (xp.float32, xp.float64):
            return cls(xp, value.dtype, device)
        if xp.isdtype(value.dtype, ("integral", "bool")):
            return cls(xp, xp.asarray(0.0, device=device).dtype, device)
        raise ShapeError(f"{name} must hold float32, float64 or integers, got {value.dtype}")

    def __reduce__(self) -> tuple[Any, ...]:
        # A module cannot be copied, nor can every device: an empty array says where it lives, and comes back
        # where the arrays beside it do.
        return Space.of, (self.xp.zeros((0,), dtype=self.dtype, **self.placed), "an array")

    @property
    def native(self) -> bool:
        """Whether arrays are NumPy's."""
        return self.xp is np

    @property
    def placed(self) -> dict[str, Any]:
        """Keywords that make a new array of this space's device."""
        return {} if self.native else {"device": self.device}

    @property
    def eps(self) -> float:
        """Spacing of the dtype's numbers at 1."""
        return float(self.xp.finfo(self.dtype).eps)

    def dtype_of(self, dtype: np.dtype[Any]) -> Any:
        """What the library calls a NumPy dtype."""
        return dtype if self.native else getattr(self.xp, dtype.name)

    def array(self, value: Any, name: str) -> Any:
        """A caller's array in this space; other libraries and devices are refused, other dtypes converted."""
        if self.native and is_native(value):
            return _native(value, name).astype(self.dtype, copy=False)
        if self.native or is_native(value):
            raise UfirextError(f"{name} must be {self}, as before, got {type(value)!r}: convert it first")
        compat = _compat(str(self.xp.__name__))
        if compat.array_namespace(value) is not self.xp or compat.device(value) != self.device:
            raise UfirextError(f"{name} must be {self}, as before, got {type(value)!r} on {value.device}")
        return self.xp.astype(value, self.dtype, copy=False)

    def constant(self, values: np.ndarray[Any, Any]) -> Any:
        """An array of ours as an array of this space."""
        if self.native:
            return np.ascontiguousarray(values, dtype=self.dtype)
        # A read-only array shared with another library would be writeable there: hand over a copy.
        return self.xp.asarray(np.array(values), dtype=self.dtype, device=self.device)

    def indices(self, values: np.ndarray[Any, Any]) -> Any:
        """Integers or booleans of ours as an array of this space."""
        return values if self.native else self.xp.asarray(values.copy(), device=self.device)

    def host(self, array: Any) -> np.ndarray[Any, Any]:
        """A NumPy copy, or the NumPy array itself."""
        if self.native:
            return np.asarray(array)
        if hasattr(array, "get"):  # CuPy converts on demand only
            return np.asarray(array.get())
        cpu = array.detach().cpu() if hasattr(array, "detach") else array
        return np.asarray(cpu)

    def finite_or_nan(self, array: Any, name: str) -> bool:
        """Whether all of `array` is finite; infinities are refused, NaN (missing) is not.

        Raises
        ------
        NonFiniteError
        """
        xp = self.xp
        # A sum is one cheap pass; only a sum that is not finite (or overflows) needs a look at the numbers.
        if self.native:
            with np.errstate(over="ignore", invalid="ignore"):
                total = float(array.sum())
        else:
            total = float(xp.sum(array))
        if math.isfinite(total):
            return True
        if bool(xp.any(xp.isinf(array))):
            raise NonFiniteError(f"{name} must be finite, or NaN where nothing came, got inf")
        return not bool(xp.any(xp.isnan(array)))

    def copy(self, array: Any) -> Any:
        """An array of its own."""
        return self.xp.asarray(array, copy=True)

    def put_rows(self, target: Any, where: Any, rows: Any) -> Any:
        """`target` with the rows at the indices `where` replaced; in place where the library can."""
        if self.native:
            target[where] = rows
            return target
        if hasattr(target, "at"):  # JAX: arrays do not change
            return target.at[where].set(rows)
        xp = self.xp
        if xp.__name__.rpartition(".")[2] in ASSIGNING:
            target[where] = rows
            return target
        # The standard has no assignment by indices: number the rows, take them, choose.
        host = np.full(target.shape[0], -1)
        host[np.asarray(where)] = np.arange(rows.shape[0])
        taken = xp.take(rows, self.indices(np.maximum(host, 0)), axis=0)
        chosen = xp.reshape(self.indices(host >= 0), (-1,) + (1,) * (target.ndim - 1))
        return xp.where(chosen, taken, target)

    def put(self, target: Any, slot: int, value: Any) -> Any:
        """`target` with target[slot, ...] replaced; in place where the library can."""
        if hasattr(target, "at"):
            return target.at[slot].set(value)
        target[slot, ...] = value
        return target

    def __str__(self) -> str:
        if self.native:
            return "a NumPy array"
        return f"a {self.xp.__name__.rpartition('.')[2]} array on {self.device}"


def _native(value: Any, name: str) -> np.ndarray[Any, Any]:
    """`value` as a real NumPy array, not copied where it is one."""
    try:
        array = np.asarray(unmasked(value)[0])
        if array.dtype == object:
            require_real(array)
            array = array.astype(float)  # None is NaN, that is: missing
    except OverflowError as error:
        raise NonFiniteError(f"{name} must be numbers below 1.8e308, got {shown(value)}") from error
    except (TypeError, ValueError) as error:
        raise ShapeError(f"{name} must be an array of real numbers, got {shown(value)}") from error
    if array.dtype.kind not in "fiub" or array.dtype == np.float16:
        raise ShapeError(f"{name} must hold float32, float64 or integers, got {array.dtype}")
    return array


def _compat(library: str) -> Any:
    try:
        import array_api_compat
    except ImportError as error:
        raise ImportError(
            f"{library} arrays need array-api-compat: pip install 'ufirext[arrays]' (NumPy arrays do not)"
        ) from error
    return array_api_compat
