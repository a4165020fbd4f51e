"""FMSFilterSmoother: the minimum-variance finite-memory filter and smoother behind filterpy's verbs."""

from __future__ import annotations

from typing import Any

import numpy as np

from .._arrays import Array, integer, lag_within
from ..channels import Channel
from ._arguments import checked_channel, dimensions
from ._channel_fms import fms_state
from ._describe import describe
from ._fms_state import FMSState
from ._windowed import WindowFilter

__all__ = ["FMSFilterSmoother"]


class FMSFilterSmoother(WindowFilter):
    """Minimum-variance unbiased filter and fixed-lag smoother over a finite window, with filterpy's verbs.

    The estimates of the newest state and of the one `lag` steps ago from the measurements of the last
    `horizon` steps, best under the model's Q and R and independent of everything before: a disturbance is
    forgotten after `horizon` steps, and noise-free data give the exact states. Equation
    :eq:`minimum-variance`.

    Parameters
    ----------
    dim_x, dim_z : int
        Numbers of states and of measured components.
    dim_u : int, optional
        Number of inputs, 0 for any.
    horizon : int
        Length of the window in steps.
    lag : int, optional
        Steps from the newest state back to the smoothed one, 0 <= lag < horizon.
    channel : Channel, optional
        What the network does to measurements: `TimeStamped`, `StampedLoss`, `BernoulliDelay`,
        `CompensatedBernoulli`. Default: ``update(z, delay=k)`` takes any delay.
    max_delay : int, optional
        Short for ``channel=TimeStamped(max_delay)``.

    Attributes
    ----------
    x, P, F, H, Q, R, B, M, K, y, S, SI, z, x_prior, P_prior, x_post, P_post
        As in filterpy; x and P are x_{n|n} and its error covariance. R must not be zero.
    log_likelihood, likelihood, mahalanobis
        Of the last measurement, as in filterpy.

    Raises
    ------
    HorizonError
        For a horizon or lag out of range; from `update`, for a delay that the channel cannot produce.
    UfirextError
        For a channel and a max_delay together.
    ShapeError
        For a dimension that is none; from the verbs, for arrays that do not fit.
    UnobservableWindow
        From the first verb, if the window can never determine the states; from `x_lag` and its kin, while the
        window does not determine that state.

    Notes
    -----
    Kim (2019), "A unified finite memory structure filter and smoother": the paper's window length M is
    `horizon`, its lag d is lag + 1, and its x^_i is `x_prior` (the newest measurement is z_{i-1} there).
    Until the rows determine the state the filter is the Kalman filter of x, P, Q, R. A constant model without
    holes costs one product of a constant gain a step; time-varying models, missing and late measurements,
    inputs and edits of x go through associative segments, exactly and at a cost that does not grow with the
    horizon. The window holds the states of the last `horizon` steps, and reaches further back while it holds
    too few measurements.

    Examples
    --------
    >>> import numpy as np
    >>> from ufirext import FMSFilterSmoother
    >>> f = FMSFilterSmoother(dim_x=2, dim_z=1, horizon=8, lag=3)
    >>> f.F, f.H = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    >>> for z in range(10):
    ...     f.predict()
    ...     f.update(2.0 * z)
    >>> f.x.round(6).ravel(), f.x_lag.round(6).ravel()
    (array([18.,  2.]), array([12.,  2.]))
    """

    _state: FMSState

    def __init__(
        self,
        dim_x: int,
        dim_z: int,
        dim_u: int = 0,
        *,
        horizon: int,
        lag: int = 0,
        channel: Channel | None = None,
        max_delay: int | None = None,
    ) -> None:
        dim_x, dim_z, dim_u = dimensions(dim_x, dim_z, dim_u)
        horizon, lag = _window(horizon, lag)
        state = fms_state(dim_x, dim_z, horizon, lag, checked_channel(channel, max_delay))
        super().__init__(dim_x, dim_z, dim_u, state)

    @classmethod
    def from_filterpy(cls, kf: Any, horizon: int, lag: int = 0, **options: Any) -> FMSFilterSmoother:
        """An FMSFilterSmoother with the model and state of a configured filterpy KalmanFilter.

        Parameters
        ----------
        kf : filterpy.kalman.KalmanFilter
            Or any object with its attributes.
        horizon, lag : int
        **options
            Further keywords of FMSFilterSmoother.

        Raises
        ------
        TypeError
            For an object that lacks them, with their names.
        """
        new = cls(*cls._dimensions_of(kf), horizon=horizon, lag=lag, **options)
        new._take_over(kf)
        return new

    # -- the lagged state -------------------------------------------------------------------------------

    @property
    def x_lag(self) -> Array:
        """The state `lag` steps before the last update(), in the form of x, a copy.

        During the first steps, when that is before the first step of all, the oldest state of the window.
        Where the rows of that step and of those before it are lost, the state of the oldest row is carried
        back, as far as it determines the older one.
        """
        return self._state.hand_out_lagged()

    @property
    def P_lag(self) -> Array:
        """Error covariance of `x_lag`, (dim_x, dim_x), a copy."""
        return np.array(self._state.pair().P)

    @property
    def P_cross(self) -> Array:
        """E[(error of x_post) (error of x_lag)'], (dim_x, dim_x), a copy."""
        return np.array(self._state.pair().cross)

    def smoothed(self, lag: int) -> tuple[Array, Array]:
        """The state `lag` steps before the last update(), from the same window, and its error covariance.

        Costs a pass over the window unless it is the filter's own lag. Steps before the first one are thought
        to be as the first.

        Parameters
        ----------
        lag : int
            0 <= lag < horizon.

        Returns
        -------
        x : ndarray, in the form of `x`
        P : ndarray, (dim_x, dim_x)

        Raises
        ------
        UnobservableWindow
            While the window does not determine that state.
        """
        self._state.settle()
        found = self._state.lagged(lag)
        return self._state.shaped(found.x), found.P.copy()

    # -- the window -------------------------------------------------------------------------------------

    @property
    def horizon(self) -> int:
        """Length of the window, steps; may be assigned."""
        return self._state.horizon

    @horizon.setter
    def horizon(self, value: int) -> None:
        self._state.settle()
        self._state.set_window(*_window(value, self._state.lag))

    @property
    def lag(self) -> int:
        """Steps from the newest state back to the smoothed one; may be assigned."""
        return self._state.lag

    @lag.setter
    def lag(self, value: int) -> None:
        self._state.settle()
        self._state.set_window(*_window(self._state.horizon, value))

    def certify(self, **options: Any) -> Any:
        """Certify the gain of the full window under the filter's model; see `ufirext.certify`.

        Parameters
        ----------
        **options
            Keywords of `ufirext.certify`: objective, solver.

        Returns
        -------
        Certificate
        """
        from ..certificates import certify
        from ..minimum_variance import minimum_variance_gain

        state, model = self._state, self._model_to_certify()
        return certify(minimum_variance_gain(model, state.horizon, state.lag), model, **options)

    def __repr__(self) -> str:
        return describe(self, extra=("horizon", "lag", "ready", "rows"))


def _window(horizon: Any, lag: Any) -> tuple[int, int]:
    horizon = integer(horizon, "horizon", 1, advice="give a count of steps")
    return horizon, lag_within(horizon, lag)
