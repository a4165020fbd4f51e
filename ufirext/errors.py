"""What ufirext raises: ValueErrors that say what was expected, why, what came, and what to do."""

from __future__ import annotations

__all__ = [
    "CovarianceError",
    "HorizonError",
    "NonFiniteError",
    "ShapeError",
    "UfirextError",
    "UnobservableWindow",
]


class UfirextError(ValueError):
    """Base of every error this library raises on purpose.

    Examples
    --------
    >>> from ufirext import ShapeError, UfirextError
    >>> issubclass(ShapeError, UfirextError) and issubclass(UfirextError, ValueError)
    True
    """


class ShapeError(UfirextError):
    """An array has the wrong shape, or a dimension is none.

    Examples
    --------
    >>> from ufirext import Model, ShapeError
    >>> try:
    ...     Model([[1.0, 1.0], [0.0, 1.0]], [[1.0, 0.0, 0.0]])
    ... except ShapeError as error:
    ...     print(error)
    H must have shape (any, 2) (dim_z, dim_x), got (1, 3)
    """


class NonFiniteError(UfirextError):
    """A NaN or an infinity stands where only a finite number makes sense.

    Examples
    --------
    >>> from ufirext import Model, NonFiniteError
    >>> try:
    ...     Model([[float("nan")]], [[1.0]])
    ... except NonFiniteError as error:
    ...     print(str(error).partition(",")[0])
    F must be finite
    """


class CovarianceError(UfirextError):
    """A covariance is not symmetric positive semidefinite (or, for R, not usable as a weight).

    Examples
    --------
    >>> from ufirext import CovarianceError, Model
    >>> try:
    ...     Model([[1.0]], [[1.0]], Q=[[-1.0]])
    ... except CovarianceError as error:
    ...     print(str(error).partition(",")[0])
    Q must be positive semidefinite
    """


class HorizonError(UfirextError):
    """A horizon, lag or delay is not an integer or lies outside its range.

    Examples
    --------
    >>> from ufirext import HorizonError, kinematic, ufir_gain
    >>> try:
    ...     ufir_gain(kinematic(1, 1, 1.0), horizon=2.5)
    ... except HorizonError as error:
    ...     print(str(error).partition(";")[0])
    horizon must be an integer, got 2.5
    """


class UnobservableWindow(UfirextError):
    """The rows of a window do not determine the state that is asked for.

    Attributes
    ----------
    rank : int or None
        Numerical rank of the stacked, column-scaled observation matrix.
    shortest : int or None
        The shortest horizon that works for this model, None if none does.

    Examples
    --------
    >>> from ufirext import UnobservableWindow, kinematic, ufir_gain
    >>> try:
    ...     ufir_gain(kinematic(1, 1, 1.0), horizon=1)
    ... except UnobservableWindow as error:
    ...     print(error.shortest)
    2
    """

    def __init__(self, message: str, *, rank: int | None = None, shortest: int | None = None) -> None:
        super().__init__(message)
        self.rank = rank
        self.shortest = shortest

    def __reduce__(self) -> tuple[object, ...]:
        return (_rebuild, (str(self), self.rank, self.shortest))


def _rebuild(message: str, rank: int | None, shortest: int | None) -> UnobservableWindow:
    return UnobservableWindow(message, rank=rank, shortest=shortest)
