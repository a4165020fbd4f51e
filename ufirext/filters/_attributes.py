"""filterpy's attributes, over an opaque state object."""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._arrays import Array, number
from ..errors import UfirextError
from ._state import FilterState
from ._update import LOG_SMALLEST


class Attributes:
    """State, model and last step of a filter under filterpy's names."""

    _state: FilterState
    dim_x: int
    dim_z: int
    dim_u: int
    inv: Any

    # -- state and model -------------------------------------------------------------------------------------

    @property
    def x(self) -> Array:
        """State estimate, (dim_x, 1) or (dim_x,), in the form it was last assigned; writes are honoured."""
        x = self._state._x_handed
        return self._state.hand_out_x() if x is None else x

    @x.setter
    def x(self, value: ArrayLike) -> None:
        self._state.write_x(value)

    @property
    def P(self) -> Array:
        """Error covariance of x, (dim_x, dim_x); a written P holds for the coming prediction and update."""
        return self._state.hand_out_P()

    @P.setter
    def P(self, value: ArrayLike) -> None:
        self._state.write_P(value)

    @property
    def F(self) -> Array:
        """State transition, (dim_x, dim_x)."""
        return self._state.hand_out("F")

    @F.setter
    def F(self, value: ArrayLike) -> None:
        self._state.assign("F", value)

    @property
    def H(self) -> Array:
        """Measurement matrix, (dim_z, dim_x)."""
        return self._state.hand_out("H")

    @H.setter
    def H(self, value: ArrayLike) -> None:
        self._state.assign("H", value)

    @property
    def Q(self) -> Array:
        """Process noise covariance, (dim_x, dim_x)."""
        return self._state.hand_out("Q")

    @Q.setter
    def Q(self, value: ArrayLike) -> None:
        self._state.assign("Q", value)

    @property
    def R(self) -> Array:
        """Measurement noise covariance, (dim_z, dim_z)."""
        return self._state.hand_out("R")

    @R.setter
    def R(self, value: ArrayLike) -> None:
        self._state.assign("R", value)

    @property
    def M(self) -> Array:
        """Cross-correlation of process and measurement noise, (dim_x, dim_z); used by `update_correlated`."""
        return self._state.hand_out("M")

    @M.setter
    def M(self, value: ArrayLike) -> None:
        self._state.assign("M", value)

    @property
    def B(self) -> Array | None:
        """Input matrix, (dim_x, dim_u), or None."""
        return None if self._state.B is None else self._state.hand_out("B")

    @B.setter
    def B(self, value: ArrayLike | None) -> None:
        self._state.assign_B(value, self.dim_u)

    @property
    def alpha(self) -> float:
        """Fading memory, at least 1; multiplies the predicted P by alpha^2."""
        return math.sqrt(self._state.fading)

    @alpha.setter
    def alpha(self, value: float) -> None:
        alpha = number(value, "alpha")
        if not (alpha >= 1.0 and alpha * alpha < math.inf):
            raise UfirextError(f"alpha must be a number of at least 1 with a finite square, got {alpha}")
        self._state.settle()
        self._state.fading = alpha**2

    # -- the last step ---------------------------------------------------------------------------------------

    @property
    def x_prior(self) -> Array:
        """Prediction before the last update, a copy."""
        return self._state.shaped(self._state.look().prior[0])

    @property
    def P_prior(self) -> Array:
        """Covariance of `x_prior`, a copy."""
        return self._state.look().prior[1].value.copy()

    @property
    def x_post(self) -> Array:
        """Estimate after the last update, a copy."""
        return self._state.shaped(self._state.look().post[0])

    @property
    def P_post(self) -> Array:
        """Covariance of `x_post`, a copy."""
        return self._state.look().post[1].value.copy()

    @property
    def z(self) -> Array:
        """The last measurement in the form of x; an array of None if there was none."""
        last = self._state.look().last
        if last is None or last.z is None:
            empty = np.array([None] * self.dim_z)
            return empty.reshape(-1, 1) if self._state.form == 2 else empty
        return self._state.shaped(last.z)

    @property
    def y(self) -> Array:
        """Innovation z - H x_prior, 0 where nothing was measured."""
        last = self._state.look().last
        return self._state.shaped(np.zeros(self.dim_z) if last is None else last.y)

    @property
    def K(self) -> Array:
        """Gain on the newest measurement, (dim_x, dim_z)."""
        last = self._state.look().last
        return np.zeros((self.dim_x, self.dim_z)) if last is None else last.K.copy()

    @property
    def S(self) -> Array:
        """Innovation covariance H P_prior H' + R, (dim_z, dim_z)."""
        last = self._state.look().last
        return np.zeros((self.dim_z, self.dim_z)) if last is None else last.S.copy()

    @property
    def SI(self) -> Array:
        """Inverse of S, by the replaceable `inv`."""
        last = self._state.look().last
        return np.zeros((self.dim_z, self.dim_z)) if last is None else np.array(self.inv(last.S.copy()))

    @property
    def log_likelihood(self) -> float:
        """log N(y; 0, S) of the last update."""
        last = self._state.look().last
        return LOG_SMALLEST if last is None else last.log_likelihood()

    @property
    def likelihood(self) -> float:
        """exp(log_likelihood), never 0."""
        return max(math.exp(min(self.log_likelihood, 709.0)), sys.float_info.min)

    @property
    def mahalanobis(self) -> float:
        """sqrt(y' S^-1 y)."""
        last = self._state.look().last
        if last is None:
            return 0.0
        return math.sqrt(max(float(last.y @ self.SI @ last.y), 0.0))
