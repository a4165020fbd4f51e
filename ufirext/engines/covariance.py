"""A covariance that is computed when somebody looks at it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from .._arrays import Array, symmetric

# A longer chain of predictions nobody looked at is worked off, so that evaluating it never recurses deeply.
LONGEST_CHAIN = 50


class Covariance:
    """A pure function of immutable arguments (so that it pickles), evaluated once."""

    __slots__ = ("_arguments", "_function", "_next", "_seen", "_value", "depth")

    def __init__(self, function: Callable[..., Array], arguments: tuple[Any, ...], depth: int = 0) -> None:
        self._function: Callable[..., Array] | None = function
        self._arguments = arguments
        self._value: Array | None = None
        # Windows of a constant model share their covariance: what follows from it is worked out once.
        self._next: tuple[Array, Array, float, Covariance] | None = None
        self._seen: tuple[Array, Array, Array] | None = None
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
        """alpha^2 F P F' + Q, later; `fading` is alpha^2. F and Q are known by identity."""
        known = self._next
        if known is not None and known[0] is F and known[1] is Q and known[2] == fading:
            return known[3]
        if self.depth >= LONGEST_CHAIN:
            self.value  # noqa: B018
        ahead = Covariance(_predicted, (self, F, Q, fading), self.depth + 1)
        self._next = F, Q, fading, ahead
        return ahead

    def innovation(self, H: Array, R: Array) -> Array:
        """H P H' + R; do not write to it. H and R are known by identity."""
        known = self._seen
        if known is None or known[0] is not H or known[1] is not R:
            known = self._seen = H, R, symmetric(H @ self.value @ H.T + R)
        return known[2]

    def __reduce__(self) -> tuple[object, ...]:
        if self._function is None:
            return Covariance.of, (self._value,)
        return Covariance, (self._function, self._arguments, self.depth)


def _identity(value: Array) -> Array:
    return value


def _predicted(P: Covariance, F: Array, Q: Array, fading: float) -> Array:
    return symmetric(fading * (F @ P.value @ F.T) + Q)
