"""Model matrices the client may assign or edit in place at any time, noticed at the next verb."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from .._arrays import Array, readonly
from ._checks import Check

# sys.getrefcount(self.handed) of an array that only a Live holds: its slot, a local name and the argument. An
# argument that is a local name itself is only lent from Python 3.14 on, and not counted.
_ALONE = 3


class Live:
    """A matrix with two faces: `value`, frozen, for the library; an editable array for the client.

    The client's array `handed` (the one assigned, as filterpy keeps it, or a copy handed out) is compared
    with the frozen value at the next verb, only while somebody else may still hold it: else it is None.
    """

    __slots__ = ("_value", "check", "handed", "raw")

    def __init__(self, value: Array, check: Check) -> None:
        self.check = check
        self.handed: Array | None = None
        self._adopt(value)

    def _adopt(self, value: Array) -> None:
        self._value: Array | None = readonly(value)
        self.raw = value.tobytes()

    @property
    def value(self) -> Array:
        """The matrix, frozen; the same object for as long as it does not change."""
        value = self._value
        if value is None:  # a plain array was assigned, and nobody asked so far
            value = self._value = np.frombuffer(self.raw).reshape(self.check.shape)
        return value

    @property
    def present(self) -> Array:
        """The matrix in whichever array there is, to be read at once; for one that has been looked at."""
        return self.value if self.handed is None else self.handed

    @property
    def held(self) -> bool:
        """Whether there is an array that somebody may edit; a frozen one is let go of."""
        if self.handed is not None and not self.handed.flags.writeable:
            self.handed = None
        return self.handed is not None

    def hand_out(self) -> Array:
        """The client's editable array; edits count from the next verb on."""
        if self.handed is None or not self.held:
            self.handed = self.value.copy()
        return self.handed

    def assign(self, value: Any, raw: bytes | None = None) -> bool:
        """A new value from outside, validated; edits of the array assigned keep counting. True if it
        differs. `raw`: what a quick check of it has shown; then a frozen array is left to `held`.
        """
        if raw is not None:
            return self.replace(value, raw)
        array = self.check(value)
        if isinstance(value, np.ndarray):
            value = np.asarray(value)  # a subclass such as a masked array is its data
        same = isinstance(value, np.ndarray) and value.dtype == float and value.shape == array.shape
        self.handed = value if same and value.flags.writeable else None
        raw = array.tobytes()
        if raw == self.raw and array.shape == self.value.shape:
            return False
        self._value, self.raw = readonly(array), raw
        return True

    def replace(self, value: Array, raw: bytes) -> bool:
        """`assign` of an array that a quick check has shown to be right."""
        self.handed = value
        if raw == self.raw:
            return False
        self._value, self.raw = None, raw
        return True

    @property
    def edited(self) -> bool:
        """Whether the client's array is another one by now."""
        return self.handed is not None and self.handed.tobytes() != self.raw

    def known(self, value: Any) -> Array | None:
        """The frozen value itself where `value` is an array equal to it: what is constant is known by
        identity.
        """
        own = self.value
        if value.__class__ is np.ndarray and value.tobytes() == self.raw:
            return own if value.shape == own.shape and value.dtype == own.dtype else None
        return None

    def taken(self, value: Any) -> Array:
        """`value` for one call: checked, copied, or the frozen value where it is equal."""
        raw = self.check.quick(value)
        if raw is None:
            return self.check(value)
        return self.value if raw == self.raw else value.copy()

    def intact(self) -> bool:
        """Whether the client's array is what it was; let go of where nobody else holds it any more."""
        handed = self.handed
        if handed is None:
            return True
        if handed.tobytes() != self.raw:
            return False
        # Whoever holds a view holds its base: an array that is a view itself can be edited behind our back.
        if handed.base is None and sys.getrefcount(self.handed) <= _ALONE:
            self.handed = None
        return True

    def changed(self) -> bool:
        """Adopt an edit made in place; True if there was one."""
        if self.intact():
            return False
        self._adopt(self.check(self.handed))
        return True

    def share(self, other: Live) -> None:
        """Know an equal matrix by the identity of another one's."""
        self._value = other.value

    def __deepcopy__(self, memo: dict[int, Any]) -> Live:
        # The client of the copy holds nothing yet; pending edits go along.
        return Live(np.array(self.value if self.handed is None else self.handed), self.check)
