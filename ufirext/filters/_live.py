"""Model matrices the client may assign or edit in place at any time, noticed at the next verb."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from .._arrays import Array, readonly

# sys.getrefcount of an array that only a Live holds: its slot, the local name and the call's own argument.
_ALONE = 3


class Live:
    """A matrix with two faces: `value`, frozen, for the library; an editable array for the client.

    The client's array (the one assigned, as filterpy keeps it, or a copy handed out) is compared with the
    frozen value at the next verb, only while somebody else may still hold it.
    """

    __slots__ = ("_check", "_handed", "_raw", "value")

    def __init__(self, value: Array, check: Callable[[Any], Array]) -> None:
        self._check = check
        self._handed: Array | None = None
        self._adopt(value)

    def _adopt(self, value: Array) -> None:
        self.value, self._raw = readonly(value), value.tobytes()

    def hand_out(self) -> Array:
        """The client's editable array; edits count from the next verb on."""
        if self._handed is None:
            self._handed = self.value.copy()
        return self._handed

    def assign(self, value: Any) -> bool:
        """A new value from outside, validated; edits of the array assigned keep counting. True if it
        differs.
        """
        array = self._check(value)
        same = isinstance(value, np.ndarray) and value.dtype == float and value.shape == array.shape
        self._handed = value if same and value.flags.writeable else None
        raw = array.tobytes()
        if raw == self._raw and array.shape == self.value.shape:
            return False
        array.flags.writeable = False
        self.value, self._raw = array, raw
        return True

    def known(self, value: Any) -> Array | None:
        """The frozen value itself where `value` is an array equal to it: what is constant is known by
        identity.
        """
        own = self.value
        if value.__class__ is np.ndarray and value.tobytes() == self._raw:
            return own if value.shape == own.shape and value.dtype == own.dtype else None
        return None

    def taken(self, value: Any) -> Array:
        """`value` for one call: checked, copied, or the frozen value where it is equal."""
        own = self.known(value)
        return self._check(value) if own is None else own

    def changed(self) -> bool:
        """Adopt an edit made in place; True if there was one."""
        handed = self._handed
        if handed is None:
            return False
        if handed.tobytes() == self._raw:
            # Whoever holds a view holds its base: an array that is a view itself can be edited behind our
            # back.
            if handed.base is None and sys.getrefcount(handed) <= _ALONE:
                self._handed = None
            return False
        self._adopt(self._check(handed))
        return True

    @property
    def watched(self) -> bool:
        """Whether the client may hold the array and edit it."""
        return self._handed is not None

    def __deepcopy__(self, memo: dict[int, Any]) -> Live:
        # The client of the copy holds nothing yet; pending edits go along.
        return Live(np.array(self.value if self._handed is None else self._handed), self._check)
