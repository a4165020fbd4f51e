"""What filtering a whole series gives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .._arrays import Array

__all__ = ["SeriesEstimate"]


@dataclass(frozen=True, repr=False)
class SeriesEstimate:
    """Estimates of a whole series, or of many.

    Attributes
    ----------
    x : ndarray, (T, dim_x) or (S, T, dim_x)
        Row n is the estimate, after the measurement of step n, of the state of step n - lag, in the units of
        the states. NaN where it is not determined, unless a prior was given.
    ready : ndarray of bool, (T,) or (S, T)
        Where the measurements of the window determine the state.
    horizon, lag : int
    covariances : callable
        Works out `P`, which asks it once.

    Examples
    --------
    >>> import numpy as np
    >>> from ufirext import filter_series, kinematic
    >>> estimate = filter_series(kinematic(1, 1, 1.0), [0.0, 1.0, 2.0, 3.0], horizon=3)
    >>> estimate.ready
    array([False,  True,  True,  True])
    >>> estimate.x[-1].round(9)
    array([3., 1.])
    >>> estimate.P.shape
    (4, 2, 2)
    """

    x: Array
    ready: NDArray[np.bool_]
    horizon: int
    lag: int
    covariances: Callable[[], Array] = field(compare=False)

    @cached_property
    def P(self) -> Array:
        """Error covariances, (T, dim_x, dim_x) or (S, T, dim_x, dim_x), worked out when first read.

        Exact under the model's Q and R (a read-only view where many series share them); NaN where x is.
        """
        return self.covariances()

    def __len__(self) -> int:
        return int(self.x.shape[-2])

    def __repr__(self) -> str:
        many = f"series={self.x.shape[0]}, " if self.x.ndim == 3 else ""
        steps, states = self.x.shape[-2:]
        ready = int(np.count_nonzero(self.ready))
        return (
            f"SeriesEstimate({many}steps={steps}, dim_x={states}, ready={ready} of {self.ready.size}, "
            f"horizon={self.horizon}, lag={self.lag})"
        )
