"""UFIRFilter: the unbiased FIR filter behind filterpy's verbs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .._arrays import Array, one_of
from ..errors import UfirextError
from ._arguments import checked_channel, dimensions
from ._describe import describe
from ._policy import new_state, with_policy
from ._ufir_state import MISSING, WINDOWS, UFIRState, checked_horizon
from ._windowed import WindowFilter

if TYPE_CHECKING:
    from ..channels import Channel

__all__ = ["UFIRFilter"]


class UFIRFilter(WindowFilter):
    """Unbiased finite impulse response filter, a drop-in for ``filterpy.kalman.KalmanFilter``.

    x^_n = K Z over the measurements of the last `horizon` steps, with the unbiased gain K = T C+ of least
    noise power (least squares over the window), equation :eq:`ufir`. The estimate needs no Q, x0 or P0; R
    only weighs rows against each other.

    Parameters
    ----------
    dim_x, dim_z : int
        Numbers of states and of measured components.
    dim_u : int, optional
        Number of inputs, 0 for any.
    horizon : int, "auto" or "adaptive"
        Length of the window in steps. "auto" chooses it from the model (F, H, Q, R), see `best_horizon`;
        "adaptive" from the data as they come, and needs no Q.
    missing : {"extend", "skip", "predict"}
        What a step without a measurement does: leave it out and reach further back while the window holds too
        few instants (default); leave it out; put the filter's own prediction in its place (as the papers do).
    window : {"arrivals", "origins"}
        A window holds the rows that arrived, or the rows of states that lie, in the last `horizon` steps.
    channel : Channel, optional
        What the network does to measurements: `TimeStamped`, `StampedLoss`, `BernoulliDelay`,
        `CompensatedBernoulli`. Default: ``update(z, delay=k)`` takes any delay.
    max_delay : int, optional
        Short for ``channel=TimeStamped(max_delay)``.

    Attributes
    ----------
    x, P, F, H, Q, R, B, M, K, y, S, SI, z, x_prior, P_prior, x_post, P_post
        As in filterpy. P is the exact error covariance of x under Q and R, computed when read.
    log_likelihood, likelihood, mahalanobis
        Of the last measurement, as in filterpy.

    Raises
    ------
    UfirextError
        For an unknown option, or a channel and a max_delay together; from `update`, if F is singular where a
        channel without time stamps must invert it.
    HorizonError
        For a horizon that is none, or whose window does not fit into memory; from `update`, for a delay that
        the channel cannot produce.
    ShapeError
        For a dimension that is none; from the verbs, for arrays that do not fit.

    Notes
    -----
    Until the rows determine the state the filter is the Kalman filter of x, P, Q, R; then `ready` is True and
    it is least squares over the growing window. Shmaliy, "An iterative Kalman-like algorithm ignoring noise
    and initial conditions", IEEE TSP 59(6), 2011, in batch form. Behind a channel without time stamps every
    measurement is a row with an H, an R and a correlation with the process noise that are worked out from
    x_prior and P_prior; P takes all three into account.

    Examples
    --------
    >>> import numpy as np
    >>> from ufirext import UFIRFilter
    >>> f = UFIRFilter(dim_x=2, dim_z=1, horizon=8)
    >>> f.F = np.array([[1.0, 1.0], [0.0, 1.0]])
    >>> f.H = np.array([[1.0, 0.0]])
    >>> for z in range(10):
    ...     f.predict()
    ...     f.update(2.0 * z)
    >>> f.x.round(6).ravel()
    array([18.,  2.])
    """

    _state: UFIRState

    def __init__(
        self,
        dim_x: int,
        dim_z: int,
        dim_u: int = 0,
        *,
        horizon: int | str = "auto",
        missing: str = "extend",
        window: str = "arrivals",
        channel: Channel | None = None,
        max_delay: int | None = None,
    ) -> None:
        dim_x, dim_z, dim_u = dimensions(dim_x, dim_z, dim_u)
        one_of(missing, MISSING, "missing")
        one_of(window, WINDOWS, "window")
        channel = checked_channel(channel, max_delay)
        state = new_state(dim_x, dim_z, checked_horizon(horizon), missing, window, channel)
        super().__init__(dim_x, dim_z, dim_u, state)

    @classmethod
    def from_filterpy(cls, kf: Any, horizon: int | str = "auto", **options: Any) -> UFIRFilter:
        """A UFIRFilter with the model and state of a configured filterpy KalmanFilter.

        Parameters
        ----------
        kf : filterpy.kalman.KalmanFilter
            Or any object with its attributes.
        horizon : int, "auto" or "adaptive"
        **options
            Further keywords of UFIRFilter.

        Raises
        ------
        TypeError
            For an object that lacks them, with their names.
        """
        new = cls(*cls._dimensions_of(kf), horizon=horizon, **options)
        new._take_over(kf)
        return new

    # -- beyond filterpy -------------------------------------------------------------------------------------

    @property
    def horizon(self) -> int | None:
        """Length of the window in use, steps; None before it was chosen. Assign an int, "auto" or
        "adaptive".
        """
        if self._state.horizon is None:
            self._state.settle()
            self._state.refresh()
        return self._state.horizon

    @horizon.setter
    def horizon(self, value: int | str) -> None:
        self._state = with_policy(self._state, checked_horizon(value))

    @property
    def G(self) -> Array:
        """Generalised noise power gain K K' of the present window, (dim_x, dim_x); NaN while not ready."""
        solution = self._state.look().solution
        if solution is None:
            return np.full((self.dim_x, self.dim_x), np.nan)
        return solution.gain.value @ solution.gain.value.T

    @property
    def _plain(self) -> bool:
        """Whether a series may be worked out at once; verbs of a subclass may do anything."""
        return type(self) is UFIRFilter and self._state.plain

    @property
    def _weighing(self) -> str | None:
        return 'horizon="auto"' if self._state.policy == "auto" else None

    def smoothed(self, lag: int) -> tuple[Array, Array]:
        """The state `lag` steps ago, from the same window, and its exact covariance.

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
        x, P = self._state.lagged(lag)
        return self._state.shaped(x), P.value.copy()

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
        from ..gains import ufir_gain

        horizon, model = self.horizon, self._model_to_certify()
        if horizon is None:
            raise UfirextError(
                "a gain to certify needs a horizon: give one, or a model that determines the state"
            )
        return certify(ufir_gain(model, horizon), model, **options)

    def __repr__(self) -> str:
        return describe(self, extra=("horizon", "ready", "rows"))
