"""DelayKalmanFilter: the Kalman filter for measurements that come late, behind filterpy's verbs."""

from __future__ import annotations

from typing import Any, get_args

from numpy.typing import ArrayLike

from .._arrays import Array, integer, one_of
from ..channels import Channel
from ..errors import UfirextError
from ..recursions.delayed import Correlation
from ._arguments import dimensions, late_channel
from ._delayed import RecursiveState
from ._describe import describe
from ._late import LateState
from ._lifted import LiftedState
from ._steady import POSTED, PREDICTED
from ._surface import FilterSurface

__all__ = ["DelayKalmanFilter"]

METHODS = ("exact", "augmented", "correlated", "white")


class LateFilter(FilterSurface):
    """What the filters with a channel add to filterpy's face."""

    _state: LateState

    # -- the two verbs, with their hot path -----------------------------------------------

    def predict(
        self,
        u: ArrayLike | None = None,
        B: ArrayLike | None = None,
        F: ArrayLike | None = None,
        Q: ArrayLike | None = None,
    ) -> None:
        state = self._state
        if state.mode == POSTED and u is None and F is None and Q is None and state.hot_predict():
            return
        super().predict(u, B, F, Q)

    def update(
        self, z: ArrayLike | None, R: ArrayLike | None = None, H: ArrayLike | None = None, *, delay: int = 0
    ) -> None:
        state = self._state
        if state.mode == PREDICTED and R is None and H is None and delay == 0 and state.hot_update(z):
            return
        super().update(z, R, H, delay=delay)

    predict.__doc__ = FilterSurface.predict.__doc__
    update.__doc__ = FilterSurface.update.__doc__

    # -- beyond filterpy ------------------------------------------------------------------

    @property
    def channel(self) -> Channel:
        """What the network does to measurements."""
        return self._state.channel

    @property
    def max_delay(self) -> int:
        """The oldest measurement that is taken, in steps."""
        return self._state.channel.max_delay

    @property
    def dropped(self) -> int:
        """Measurements left out: duplicates, and those made before the start."""
        return self._state.dropped

    @property
    def ready(self) -> bool:
        """Always True: the filter starts from x and P."""
        return True


class DelayKalmanFilter(LateFilter):
    """Kalman filter for measurements that come late, out of order, in part or not at all.

    The surface is that of ``filterpy.kalman.KalmanFilter``; ``update(z, delay=k)`` takes a measurement that
    was made `k` steps ago. Without delays it is the Kalman filter of the books in Joseph form, equation
    :eq:`kalman`.

    Parameters
    ----------
    dim_x, dim_z : int
        Numbers of states and of measured components.
    dim_u : int, optional
        Number of inputs, 0 for any.
    max_delay : int, optional
        The oldest measurement that is taken, in steps; short for ``channel=TimeStamped(max_delay)``.
    method : {"exact", "augmented", "correlated", "white"}
        "exact": a recursion on the present state that keeps the covariances of its error with the last
        `max_delay` process noises; needs an invertible F where a measurement is late; its P is its true error
        covariance. "augmented": the filter of the state [x_n; x_{n-1}; ..], the optimum for any delays and F.
        "correlated" and "white" are the baselines of the literature: they take into account the correlation
        with the newest process noise only (Uribe-Murcia et al. 2022), or none (Uribe-Murcia et al. 2018), and
        their P is not their error covariance.
    channel : Channel, optional
        What the network does to measurements: `TimeStamped`, `StampedLoss`, `BernoulliDelay`,
        `CompensatedBernoulli`.

    Attributes
    ----------
    x, P, F, H, Q, R, B, M, K, y, S, SI, z, x_prior, P_prior, x_post, P_post, log_likelihood, mahalanobis
        As in filterpy, like the others. For a late measurement y and S are its innovation and that of it.

    Raises
    ------
    UfirextError
        For an unknown method, or a channel and a max_delay together; from `update`, if F is singular where
        "exact" must invert it.
    HorizonError
        For a delay outside 0..max_delay.
    ShapeError
        For a dimension that is none; from the verbs, for arrays that do not fit.

    Examples
    --------
    A measurement that is two steps old:

    >>> import numpy as np
    >>> from ufirext import DelayKalmanFilter
    >>> f = DelayKalmanFilter(dim_x=2, dim_z=1, max_delay=2)
    >>> f.F, f.H = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    >>> f.P *= 100.0
    >>> f.Q = 0.01 * np.eye(2)
    >>> for n in range(20):
    ...     f.predict()
    ...     if n >= 2:
    ...         f.update(3.0 * (n - 2), delay=2)
    >>> f.x.round(1).ravel()
    array([57.,  3.])
    """

    def __init__(
        self,
        dim_x: int,
        dim_z: int,
        dim_u: int = 0,
        *,
        max_delay: int = 0,
        method: str = "exact",
        channel: Channel | None = None,
    ) -> None:
        dim_x, dim_z, dim_u = dimensions(dim_x, dim_z, dim_u)
        one_of(method, METHODS, "method")
        channel = late_channel(channel, max_delay)
        self._method = method
        super().__init__(dim_x, dim_z, dim_u, _state(dim_x, dim_z, channel, method))

    @classmethod
    def from_filterpy(cls, kf: Any, **options: Any) -> DelayKalmanFilter:
        """A DelayKalmanFilter with the model and state of a configured filterpy KalmanFilter.

        Parameters
        ----------
        kf : filterpy.kalman.KalmanFilter
            Or any object with its attributes.
        **options
            Keywords of DelayKalmanFilter.

        Raises
        ------
        TypeError
            For an object that lacks them, with their names.
        """
        new = cls(*cls._dimensions_of(kf), **options)
        new._take_over(kf)
        return new

    @property
    def method(self) -> str:
        """How late measurements are taken in."""
        return self._method

    def smoothed(self, lag: int) -> tuple[Array, Array]:
        """The state `lag` steps ago given everything that came, for method="augmented".

        Parameters
        ----------
        lag : int
            0 <= lag <= max_delay.

        Returns
        -------
        x : ndarray, in the form of `x`
        P : ndarray, (dim_x, dim_x)

        Raises
        ------
        UfirextError
            For the other methods, which keep no older states.
        """
        state = self._state
        if not isinstance(state, LiftedState):
            raise UfirextError(
                f"smoothed needs method='augmented', which keeps older states, got {self._method!r}"
            )
        state.settle()
        return state.lagged(integer(lag, "lag", 0, min(self.max_delay, state.now)))

    def __repr__(self) -> str:
        return describe(self, extra=("method", "max_delay"))


def _state(dim_x: int, dim_z: int, channel: Channel, method: str) -> LateState:
    if method == "augmented":
        return LiftedState(dim_x, dim_z, channel)
    correlation: Correlation = next(name for name in get_args(Correlation) if name == method)
    return RecursiveState(dim_x, dim_z, channel, correlation)
