"""The state objects of an FMSFilterSmoother behind a channel."""

from __future__ import annotations

import numpy as np

from .._arrays import Array, symmetric
from ..channels import Channel
from ..engines.covariance import Covariance
from ..engines.pairs import PairRing
from ..engines.records import Limits, Step
from ..engines.segmented import Segmented
from ..recursions.augmented import Lifted
from ..window import Row, whitener
from ._channel_rows import AveragedRows, StampedRows
from ._fms_state import FMSState, check_weight


class StampedFMSState(StampedRows, FMSState):
    """Measurements with time stamps."""


class AveragedFMSState(AveragedRows, FMSState):
    """Measurements that are one step late with a known probability.

    Each measurement as a row of the state before, its noise made free of the process noise.

    z = A x_n + B x_{n-1} + e and x_n = F x_{n-1} + u + w give a row of x_{n-1} with the noise A w + e. With
    T = Q A' (A Q A' + cov e)^-1 the rest w - T (A w + e) of the process noise is uncorrelated with it, and
    T (z - ..) is a known input: an ordinary window again, without an inverse of F.
    """

    @property
    def limits(self) -> Limits:
        """The window's rules; the row of a state belongs to the state before."""
        return super().limits._replace(horizon=self.horizon + self.channel.max_delay)

    def _ring(self, engine: Segmented, F: Array, Q: Array) -> PairRing | None:
        return None

    def _pair(self) -> Lifted:
        """The present state and the one before, as the rows of this step left them."""
        if not self.updated or self.left is not None:
            return super()._pair()
        found = self._folds().lagged(self.now - 1, self.now, self.known)
        if found is None:
            return super()._pair()
        P = np.block([[self.P.value, found.cross], [found.cross.T, found.P]])
        return Lifted(np.concatenate([self.x, found.x]), P)

    def _absorb(self, z: Array, H: Array, R: Array, delay: int, cross: Array | None) -> Covariance | None:
        if H.shape[1] == self.dim_x:
            return super()._absorb(z, H, R, delay, cross)
        check_weight(R)
        self._begin(self.F.value, self.Q.value)
        folds = self._folds()
        step, row, T = decorrelated(folds, z, H, R)
        if folds.negligible(row, self.limits):
            return None
        folds.steps[-1], self.left = step, None
        solution = self._entered(folds, row)
        if solution is None:
            self.wide = z, H, R
            gain = self._kalman(z, H, R, cross)
            self.wide = None
            return gain
        return Covariance(_total_gain, (self._solved(solution), T))


def decorrelated(folds: Segmented, z: Array, H: Array, R: Array) -> tuple[Step, Row, Array]:
    """A measurement of [x_n; x_{n-1}]: the last step and its row without correlation, and T."""
    step, n = folds.steps[-1], len(folds.center)
    now, before = H[:, :n], H[:, n:]
    known = np.zeros(n) if step.known is None else step.known
    free = z - now @ (known if folds.after is None else known + folds.after)
    cov = symmetric(now @ step.Q @ now.T + R)
    W = whitener(cov)
    T = step.Q @ now.T @ W.T @ W
    row = Row(folds.now - 1, folds.now, now @ step.F + before, cov, free)
    rest = np.eye(n) - T @ now
    Q = symmetric(rest @ step.Q @ rest.T + T @ R @ T.T)
    return Step(step.F - T @ row.H, Q, known + T @ free), row, T


def _total_gain(gain: Covariance, T: Array) -> Array:
    """The measurement acts as a row, and as a known input of the last step."""
    return np.asarray(gain.value + T)


def fms_state(dim_x: int, dim_z: int, horizon: int, lag: int, channel: Channel | None) -> FMSState:
    """The state object of a new filter."""
    if channel is None:
        return FMSState(dim_x, dim_z, horizon, lag)
    kind = StampedFMSState if channel.stamped else AveragedFMSState
    state = kind(dim_x, dim_z, horizon, lag)
    state.channel = channel
    return state
