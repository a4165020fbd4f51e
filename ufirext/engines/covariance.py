"""A covariance that is computed when somebody looks at it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from .._arrays import Array, symmetric

# A longer chain of predictions nobody looked at is worked off, so that evaluating it never recurses deeply.
LONGEST_CHAIN = 50


class Covariance:
    """A pure function of immutable arguments (so that it pickles), evaluated once."""

    __slots__ = ("_arguments", "_function", "_value", "depth")

    def __init__(self, function: Callable[..., Array], arguments: tuple[Any, ...], depth: int = 0) -> None:
        self._function: Callable[..., Array] | None = function
        self._arguments = arguments
        self._value: Array | None = None
        self.depth = depth

    @classmethod
    def of(cls, value: Array) -> Covariance:
        """A covariance that is already known."""
        return cls(_identity, (value,))

    @property
    def value(self) -> Array:
        """The matrix (dim_x, dim_x); do not write to it."""
        if self._function is not None:
            self._value = self._function(*self._arguments)
            self._function, self._arguments, self.depth = None, (), 0
        value: Array = self._value  # type: ignore[assignment]
        return value

    def predicted(self, F: Array, Q: Array, fading: float = 1.0) -> Covariance:
        """alpha^2 F P F' + Q, later; `fading` is alpha^2."""
        if self.depth >= LONGEST_CHAIN:
            self.value  # noqa: B018
        return Covariance(_predicted, (self, F, Q, fading), self.depth + 1)


def _identity(value: Array) -> Array:
    return value


def _predicted(P: Covariance, F: Array, Q: Array, fading: float) -> Array:
    return symmetric(fading * (F @ P.value @ F.T) + Q)
