"""Does a filter tell the truth about its error? Normalised squares and their chi-square test."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .._arrays import covariance, integer, number, readings
from ..errors import NonFiniteError, UfirextError

__all__ = ["Consistency", "consistency", "nees", "nis"]


def nis(y: ArrayLike, S: ArrayLike) -> float:
    """Normalised innovation squared  y' S^-1 y, chi-square with as many degrees of freedom as y has numbers.

    Parameters
    ----------
    y : array_like, (dim_z,) or (dim_z, 1)
        Innovation; NaN components are left out.
    S : array_like, (dim_z, dim_z)
        Its covariance, positive definite.

    Returns
    -------
    float
        NaN where every component is missing.

    Raises
    ------
    CovarianceError
        If S is no covariance.
    UfirextError
        If S is singular.

    Examples
    --------
    >>> from ufirext.diagnostics import nis
    >>> nis([3.0], [[4.0]])
    2.25
    """
    return _normalised(y, S, "y", "S")


def nees(error: ArrayLike, P: ArrayLike) -> float:
    """Normalised estimation error squared  e' P^-1 e, chi-square with dim_x degrees of freedom.

    Parameters
    ----------
    error : array_like, (dim_x,) or (dim_x, 1)
        True minus estimated state.
    P : array_like, (dim_x, dim_x)
        The filter's covariance, positive definite.

    Returns
    -------
    float

    Raises
    ------
    CovarianceError
        If P is no covariance.
    UfirextError
        If P is singular.

    Examples
    --------
    >>> from ufirext.diagnostics import nees
    >>> nees([1.0, 2.0], [[1.0, 0.0], [0.0, 4.0]])
    2.0
    """
    return _normalised(error, P, "error", "P")


def _normalised(vector: ArrayLike, cov: ArrayLike, name: str, cov_name: str) -> float:
    flat = readings(vector, name).reshape(-1)
    if np.isinf(flat).any():
        raise NonFiniteError(f"{name} must be finite, got {flat}")
    cov = covariance(cov, len(flat), cov_name)
    present = ~np.isnan(flat)
    if not present.any():
        return float("nan")
    scale = np.sqrt(np.maximum(np.diag(cov)[present], 0.0))
    scaled = cov[np.ix_(present, present)] / np.where(scale > 0, np.outer(scale, scale), 1.0)
    try:
        root = np.linalg.solve(np.linalg.cholesky(scaled), flat[present] / np.where(scale > 0, scale, 1.0))
    except np.linalg.LinAlgError as error:
        raise UfirextError(
            f"{cov_name} must be positive definite to normalise {name}, got a singular one"
        ) from error
    return float(root @ root)


@dataclass(frozen=True)
class Consistency:
    """Mean of a chi-square statistic against the interval that a truthful filter keeps.

    Attributes
    ----------
    mean : float
        Over the values that are no NaN.
    low, high : float
        The interval holds the mean of a truthful filter with probability `level`.
    count : int
        Values used.
    level : float
    """

    mean: float
    low: float
    high: float
    count: int
    level: float

    @property
    def consistent(self) -> bool:
        """The mean lies in the interval."""
        return self.low <= self.mean <= self.high


def consistency(values: ArrayLike, dof: int, level: float = 0.95) -> Consistency:
    """Chi-square test of NIS or NEES values: does the filter's covariance tell its true error.

    Parameters
    ----------
    values : array_like
        Independent chi-square values (NIS over time; NEES over independent runs). NaN: missing.
    dof : int
        Degrees of freedom of one value: dim_z for NIS, dim_x for NEES.
    level : float, optional
        Probability of the interval.

    Returns
    -------
    Consistency

    Raises
    ------
    UfirextError
        If there is no value, dof is below 1, or level is outside (0, 1).

    Notes
    -----
    The sum of n values is chi-square with n dof degrees of freedom: Bar-Shalom, Li and Kirubarajan,
    Estimation with Applications to Tracking and Navigation (2001), section 5.4.

    Examples
    --------
    >>> import numpy as np
    >>> from ufirext.diagnostics import consistency
    >>> consistency(np.random.default_rng(1).chisquare(2, size=500), dof=2).consistent
    True
    """
    from scipy.stats import chi2

    flat = readings(values, "values").reshape(-1)
    flat = flat[~np.isnan(flat)]
    if not flat.size:
        raise UfirextError("values must hold at least one number, got none")
    dof = integer(dof, "dof", 1, advice="it is the number of components", refusal=UfirextError)
    if not 0.0 < number(level, "level") < 1.0:
        raise UfirextError(f"level must lie between 0 and 1, got {level!r}")
    total = dof * flat.size
    tail = (1.0 - level) / 2.0
    low, high = (float(chi2.ppf(p, total)) / flat.size for p in (tail, 1.0 - tail))
    return Consistency(float(flat.mean()), low, high, int(flat.size), level)
