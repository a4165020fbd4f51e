"""filterpy's face, once: every name of filterpy.kalman.KalmanFilter over an opaque state object."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from itertools import repeat
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from .._arrays import Array, covariance, finite, integer, matrix, readings, real
from ..errors import ShapeError
from ._arguments import measurement, require_filter
from ._attributes import Attributes
from ._checks import scalar
from ._describe import describe
from ._series import PerStep, run_series, smooth_series
from ._state import FilterState
from ._update import LOG_SMALLEST, log_normal

# What there is to take over from another filter.
TAKEN_OVER = ("F", "H", "Q", "R", "B", "P", "x", "M", "alpha")


class DimensionMismatch(ShapeError, AssertionError):
    """A matrix does not fit the others; also an AssertionError, as filterpy raises there."""


class FilterSurface(Attributes):
    """The verbs and attributes of filterpy's KalmanFilter; subclasses bring the state object that does the
    work.
    """

    def __init__(self, dim_x: int, dim_z: int, dim_u: int, state: FilterState) -> None:
        self.dim_x, self.dim_z, self.dim_u = dim_x, dim_z, dim_u
        self.inv = np.linalg.inv
        self._state = state

    @property
    def _plain(self) -> bool:
        """Whether this is a fresh filter whose estimates a convolution of the series can give."""
        return False

    # -- verbs -----------------------------------------------------------------------------------------------

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
            Known input; ignored where there is no B.
        B, F, Q : array_like, optional
            Replace the attribute for this call.
        """
        state = self._state
        state.settle()
        if u is None and F is None and Q is None:
            state.predict(state.F.value, state.Q.value, None)
        else:
            state.predict(*state.transition(u, B, F, Q))

    def update(
        self, z: ArrayLike | None, R: ArrayLike | None = None, H: ArrayLike | None = None, *, delay: int = 0
    ) -> None:
        """Take a measurement.

        Parameters
        ----------
        z : scalar or array_like, (dim_z,) or (dim_z, 1), or None
            None: nothing came. NaN: this component did not come.
        R, H : array_like, optional
            Replace the attribute for this call; H may have another number of rows.
        delay : int, optional
            Age of the measurement in steps: z was taken `delay` steps ago.

        Raises
        ------
        ValueError
            For wrong shapes, infinite values, an R that is no covariance, a delay that is no count.
        """
        state = self._state
        state.settle()
        if delay.__class__ is not int or delay < 0:
            delay = integer(delay, "delay", 0)
        z_in, H_in, R_in = self._measurement(z, R, H)
        whole = z_in is not None and z_in.dot(z_in) < np.inf and state.sees_all(H_in)
        state.update(z_in, H_in, R_in, delay, whole=whole)

    def _measurement(
        self, z: ArrayLike | None, R: ArrayLike | None, H: ArrayLike | None
    ) -> tuple[Array | None, Array, Array]:
        state = self._state
        H_now = state.H.value
        if H is not None:
            same = state.H.known(H)
            H_now = self._observation(H) if same is None else same
        m = len(H_now)
        if R is not None:
            R_now = state.R.known(R)
            if R_now is None:
                R_now = covariance(scalar(R, "R") if m == 1 else R, m, "R", "(rows of H)")
        else:
            R_now = state.R.value
            if len(R_now) != m:
                raise ShapeError(
                    f"R must be given with an H of {m} rows: the filter's own R has shape {R_now.shape}"
                )
        return measurement(z, m), H_now, R_now

    def _observation(self, H: ArrayLike) -> Array:
        rows = H if isinstance(H, np.ndarray) and H.ndim == 2 else np.atleast_2d(real(H, "H"))
        return matrix(rows, (len(rows), self.dim_x), "H", "(rows, dim_x)")

    def predict_steadystate(self, u: ArrayLike | None = 0, B: ArrayLike | None = None) -> None:
        """`predict` that leaves P as it is."""
        P = self._state.look().P
        self.predict(u, B)
        self._state.keep_P(P)

    def update_steadystate(self, z: ArrayLike | None) -> None:
        """`update` that leaves P, K and S as they are."""
        state = self._state.look()
        P, last = state.P, state.last
        self.update(z)
        self._state.keep_P(P, last)

    def update_correlated(
        self, z: ArrayLike | None, R: ArrayLike | None = None, H: ArrayLike | None = None
    ) -> None:
        """`update` with process and measurement noise correlated by M (acts on S, and on x in warm-up)."""
        state = self._state
        state.settle()
        state.update(*self._measurement(z, R, H), 0, state.M.value)

    def update_sequential(
        self, start: int, z_i: ArrayLike, R_i: ArrayLike | None = None, H_i: ArrayLike | None = None
    ) -> None:
        """Take the components start, start + 1, .. of a measurement on their own."""
        state = self._state
        state.settle()
        values = readings(z_i, "z_i").reshape(-1)
        start = integer(start, "start", 0, self.dim_z - 1, "it is a component of z", ShapeError)
        stop = start + len(values)
        if not 1 <= len(values) <= self.dim_z - start:
            raise ShapeError(
                f"z_i must hold 1 to {self.dim_z - start} components from start={start} on, got {len(values)}"
            )
        H = state.H.value.copy()
        R = state.R.value.copy()
        z = np.full(self.dim_z, np.nan)
        z[start:stop] = measurement(values, len(values))
        if H_i is not None:
            H[start:stop] = matrix(np.atleast_2d(real(H_i, "H_i")), (len(values), self.dim_x), "H_i")
        if R_i is not None:
            R[start:stop, start:stop] = covariance(np.squeeze(real(R_i, "R_i"))[()], len(values), "R_i")
        before, same_step = state.last, state.updated
        state.update(z, H, R, 0)
        if same_step and before is not None:
            state.show_earlier(before.z)

    def predicted(self, steps: int) -> tuple[Array, Array]:
        """The state `steps` ahead under the present F and Q without input, and its covariance.

        Parameters
        ----------
        steps : int
            At least 0.

        Returns
        -------
        x : ndarray, in the form of `x`
        P : ndarray, (dim_x, dim_x)
        """
        state = self._state
        state.settle()
        x, P = state.x, state.P
        for _ in range(integer(steps, "steps", 0)):
            x, P = state.F.value @ x, P.predicted(state.F.value, state.Q.value, state.fading)
        return state.shaped(x), P.value.copy()

    @classmethod
    def from_statespace(
        cls, sys: Any, QN: ArrayLike | None = None, RN: ArrayLike | None = None, **options: Any
    ) -> Self:
        """A filter for the plant that a ``control.StateSpace`` describes.

        Parameters
        ----------
        sys : control.StateSpace
            Discrete-time, or continuous-time with the keyword `dt`.
        QN, RN : array_like, optional
            Covariances of the disturbances and of the measurement noise; Q = G QN G'. Only UFIRFilter does
            without, where its horizon is given or "adaptive".
        **options
            dt, G, C, control_indices, disturbance_indices of `ufirext.control.from_statespace`, and keywords
            of the filter.

        Examples
        --------
        >>> import control as ct
        >>> from ufirext import UFIRFilter
        >>> plant = ct.ss([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], 0)
        >>> f = UFIRFilter.from_statespace(plant, [[1]], [[0.01]], dt=0.1, horizon=12)
        >>> f.F, f.B.ravel().round(3)
        (array([[1. , 0.1],
               [0. , 1. ]]), array([0.005, 0.1  ]))
        """
        from ..control.convert import from_statespace

        return from_statespace(cls, sys, QN, RN, **options)

    @staticmethod
    def _dimensions_of(kf: Any) -> tuple[int, int, int]:
        """dim_x, dim_z and dim_u of a filterpy KalmanFilter, or of anything with its attributes."""
        require_filter(kf, "kf", "filterpy.kalman.KalmanFilter", ("dim_x", "dim_z", *TAKEN_OVER, "inv"))
        return kf.dim_x, kf.dim_z, getattr(kf, "dim_u", 0) or 0

    def _take_over(self, kf: Any) -> None:
        """Its model and state, as copies."""
        for name in TAKEN_OVER:
            setattr(self, name, copy.deepcopy(getattr(kf, name)))
        self.inv = kf.inv

    # -- helpers ---------------------------------------------------------------------------------------------

    def get_prediction(
        self,
        u: ArrayLike | None = None,
        B: ArrayLike | None = None,
        F: ArrayLike | None = None,
        Q: ArrayLike | None = None,
    ) -> tuple[Array, Array]:
        """x and P as `predict` would give them; changes nothing."""
        fork = copy.deepcopy(self)
        fork.predict(u, B, F, Q)
        return fork.x, fork.P

    def get_update(self, z: ArrayLike | None = None) -> tuple[Array, Array]:
        """x and P as `update(z)` would give them; changes nothing."""
        fork = copy.deepcopy(self)
        fork.update(z)
        return fork.x, fork.P

    def residual_of(self, z: ArrayLike) -> Array:
        """z - H x_prior."""
        self._state.settle()
        flat = measurement(z, self.dim_z)
        if flat is None:
            raise ShapeError("residual_of needs a measurement, got None")
        return self._state.shaped(flat - self._state.H.value @ self._state.look().prior[0])

    def measurement_of_state(self, x: ArrayLike) -> Array:
        """H x, in the form of the x given."""
        self._state.settle()
        state = finite(real(x, "x"), "x")
        if state.shape[:1] != (self.dim_x,):
            raise ShapeError(f"x must have shape ({self.dim_x}, 1) or ({self.dim_x},), got {state.shape}")
        return np.asarray(self._state.H.value @ state)

    def log_likelihood_of(self, z: ArrayLike | None) -> float:
        """log N(z; H x, S) for another measurement; the logarithm of the smallest float for None."""
        flat = measurement(z, self.dim_z)
        if flat is None or np.isnan(flat).all():
            return LOG_SMALLEST
        mask = ~np.isnan(flat)
        state = self._state
        state.settle()
        residual = flat - state.H.value @ self.x.reshape(-1)
        last = state.last
        if last is not None and len(last.H) == len(flat):
            S = last.S
        else:  # nothing came, or what another sensor measured
            P = state.P if last is None else last.P
            S = P.innovation(state.H.value, state.R.value)
        return log_normal(residual[mask], S[np.ix_(mask, mask)])

    @property
    def _weighing(self) -> str | None:
        """What in it weighs Q against R, so that it cannot work without a guess of both."""
        return "the gain"

    def test_matrix_dimensions(
        self,
        z: ArrayLike | None = None,
        H: ArrayLike | None = None,
        R: ArrayLike | None = None,
        F: ArrayLike | None = None,
        Q: ArrayLike | None = None,
    ) -> None:
        """Check that the matrices fit together; AssertionError (and ValueError) where they do not."""
        try:
            self._state.transition(None, None, F, Q)
            _, H_now, _ = self._measurement(None, R, H)
            measurement(z, len(H_now))
        except ValueError as error:
            raise DimensionMismatch(str(error)) from error

    def batch_filter(
        self,
        zs: Sequence[Any] | Array,
        Fs: PerStep = None,
        Qs: PerStep = None,
        Hs: PerStep = None,
        Rs: PerStep = None,
        Bs: PerStep = None,
        us: PerStep = None,
        update_first: bool = False,
        saver: Any = None,
    ) -> tuple[Array, Array, Array, Array]:
        """Run over a series; every list may hold one entry a step, None for the attribute.

        Parameters
        ----------
        zs : sequence of measurements
            None or NaN: missing.
        Fs, Qs, Hs, Rs, Bs, us : sequences, optional
            One entry for each of zs; ShapeError, before anything is filtered, where one is shorter.
        update_first : bool
            update before predict in every step.
        saver : filterpy.common.Saver, optional
            Its save() is called after every step.

        Returns
        -------
        means, covariances, means_p, covariances_p : ndarray
            (T, dim_x, 1) or (T, dim_x) in the form of x, and (T, dim_x, dim_x): after update, after predict.
        """
        return run_series(self, zs, (Fs, Qs, Hs, Rs, Bs, us), update_first, saver)

    def rts_smoother(
        self,
        Xs: Array,
        Ps: Array,
        Fs: Sequence[Array] | None = None,
        Qs: Sequence[Array] | None = None,
        inv: Any = np.linalg.inv,
    ) -> tuple[Array, Array, Array, Array]:
        """Rauch-Tung-Striebel smoothing of `batch_filter`'s output, as in filterpy.

        Returns
        -------
        x, P, K, Pp : ndarray
            Smoothed means and covariances, smoother gains, predicted covariances.

        Raises
        ------
        ShapeError, NonFiniteError
            For what is no output of `batch_filter`.
        """
        self._state.settle()
        F, Q = repeat(self._state.F.value), repeat(self._state.Q.value)
        return smooth_series(Xs, Ps, F if Fs is None else Fs, Q if Qs is None else Qs, inv)

    def __repr__(self) -> str:
        return describe(self)
