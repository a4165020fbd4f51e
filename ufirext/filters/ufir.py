"""UFIRFilter: the unbiased FIR filter behind filterpy's verbs."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._arrays import Array, integer
from ..errors import UfirextError
from ._bank import new_state, with_policy
from ._describe import describe
from ._surface import FilterSurface
from ._ufir_state import MISSING, POSTED, PREDICTED, WINDOWS, UFIRState, checked_horizon

__all__ = ["UFIRFilter"]


class UFIRFilter(FilterSurface):
    """Unbiased finite impulse response filter, a drop-in for ``filterpy.kalman.KalmanFilter``.

    x^_n = K Z over the measurements of the last `horizon` steps, with the unbiased gain K = T C+ of least
    noise power (least squares over the window). The estimate needs no Q, x0 or P0; R only weighs rows against
    each other.

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

    Attributes
    ----------
    x, P, F, H, Q, R, B, M, K, y, S, SI, z, x_prior, P_prior, x_post, P_post, log_likelihood, likelihood,
    mahalanobis
        As in filterpy. P is the exact error covariance of x under Q and R, computed when read.

    Notes
    -----
    Until the rows determine the state the filter is the Kalman filter of x, P, Q, R; then `ready` is True and
    it is least squares over the growing window. Shmaliy, "An iterative Kalman-like algorithm ignoring noise
    and initial conditions", IEEE TSP 59(6), 2011, in batch form.

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
    ) -> None:
        dim_x, dim_z = integer(dim_x, "dim_x", 1), integer(dim_z, "dim_z", 1)
        dim_u = integer(dim_u, "dim_u", 0)
        for name, value, allowed in (("missing", missing, MISSING), ("window", window, WINDOWS)):
            if value not in allowed:
                raise UfirextError(f"{name} must be one of {', '.join(map(repr, allowed))}, got {value!r}")
        super().__init__(
            dim_x, dim_z, dim_u, new_state(dim_x, dim_z, checked_horizon(horizon), missing, window)
        )

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
        """
        new = cls(kf.dim_x, kf.dim_z, getattr(kf, "dim_u", 0) or 0, horizon=horizon, **options)
        for name in ("F", "H", "Q", "R", "B", "P", "x", "M", "alpha"):
            setattr(new, name, getattr(kf, name))
        new.inv = kf.inv
        return new

    # -- the two verbs, with their hot path ------------------------------------------------------------------

    @property
    def x(self) -> Array:
        """State estimate, (dim_x, 1) or (dim_x,), in the form it was last assigned; writes are honoured."""
        x = self._state._x_handed
        return self._state.hand_out_x() if x is None else x

    @x.setter
    def x(self, value: ArrayLike) -> None:
        self._state.write_x(value)

    def predict(
        self,
        u: ArrayLike | None = None,
        B: ArrayLike | None = None,
        F: ArrayLike | None = None,
        Q: ArrayLike | None = None,
    ) -> None:
        """Advance one step: x <- F x + B u.

        Parameters
        ----------
        u : scalar or array_like, (dim_u,) or (dim_u, 1), optional
            Known input; ignored where there is no B. It is carried inside the window.
        B, F, Q : array_like, optional
            Replace the attribute for this call.

        Raises
        ------
        ValueError
            For wrong shapes or values that are not finite.
        UnobservableWindow
            At the first verb, for a horizon that can never determine the state while a longer one could.
        """
        state = self._state
        if state.mode == POSTED and u is None and F is None and Q is None:
            x = state._x_handed
            if x is None or x.tobytes() == state._x_raw:
                state._x_handed = None
                state.mode = PREDICTED
                return
        super().predict(u, B, F, Q)

    def update(
        self, z: ArrayLike | None, R: ArrayLike | None = None, H: ArrayLike | None = None, *, delay: int = 0
    ) -> None:
        """Take a measurement.

        Parameters
        ----------
        z : scalar or array_like, (dim_z,) or (dim_z, 1), or None
            None: nothing came. NaN: this component did not come.
        R, H : array_like, optional
            Replace the attribute for this call; rows are weighted by their R, H may have any number of rows.
        delay : int, optional
            Age of the measurement in steps: z was taken `delay` steps ago and joins the window at its place.

        Raises
        ------
        ValueError
            For wrong shapes, infinite values, an R that is no covariance, a delay that is no count.
        """
        state = self._state
        if state.mode == PREDICTED and H is None and delay == 0:
            x = state._x_handed
            untouched = x is None or x.tobytes() == state._x_raw
            if untouched and (state.take(z) if R is None else state.take_weighted(z, R)):
                state._x_handed = None
                state.mode = POSTED
                return
        super().update(z, R, H, delay=delay)

    # -- beyond filterpy -------------------------------------------------------------------------------------

    @property
    def ready(self) -> bool:
        """True once the rows in the window determine the state."""
        return self._state.ready

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
    def rows(self) -> int:
        """Number of measurements in the window."""
        solution = self._state.look().solution
        return 0 if solution is None else solution.rows

    @property
    def dropped(self) -> int:
        """Number of measurements that came too late to join the window."""
        return self._state.dropped

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

    def predicted(self, steps: int) -> tuple[Array, Array]:
        """The state `steps` ahead under the present F and Q without input, and its covariance.

        Returns
        -------
        x : ndarray, in the form of `x`
        P : ndarray, (dim_x, dim_x)
        """
        state = self._state
        state.settle()
        x, P = state.x, state.P
        for _ in range(integer(steps, "steps", 0)):
            x, P = state.F.value @ x, P.predicted(state.F.value, state.Q.value)
        return state.shaped(x), P.value.copy()

    def __repr__(self) -> str:
        return describe(self, extra=("horizon", "ready", "rows"))
