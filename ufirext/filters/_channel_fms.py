"""Minimum variance over a window of measurements that are one step late with a known probability."""

from __future__ import annotations

import numpy as np

from .._arrays import Array, symmetric
from ..channels import Effective
from ..engines.covariance import Covariance
from ..engines.pairs import PairRing
from ..engines.records import Limits, Step, measured
from ..engines.segmented import Segmented
from ..recursions.augmented import Lifted
from ..window import Row, whitener
from ._channel_rows import AveragedRows
from ._fms_state import FMSState, check_weight
from ._update import innovation_gain, joseph


class AveragedFMSState(AveragedRows, FMSState):
    """Each measurement as a row of the state before, its noise made free of the process noise.

    z = A x_n + B x_{n-1} + e and x_n = F x_{n-1} + u + w give a row of x_{n-1} with the noise A w + e. With
    T = Q A' (A Q A' + cov e)^-1 the rest w - T (A w + e) of the process noise is uncorrelated with it, and
    T (z - ..) is a known input: an ordinary window again, without an inverse of F.
    """

    met: Lifted | None = None  # [x_n; x_{n-1}] that the row being taken in meets
    left: Lifted | None = None  # .. and as the last row of this step left it, during the warm-up

    @property
    def limits(self) -> Limits:
        """The window's rules; the row of a state belongs to the state before."""
        return super().limits._replace(horizon=self.horizon + self.channel.max_delay)

    def _ring(self, engine: Segmented, F: Array, Q: Array) -> PairRing | None:
        return None

    def predict(self, F: Array, Q: Array, known: Array | None) -> None:
        """Time update by F, Q and a known change of the state."""
        super().predict(F, Q, known)
        self.left = None

    def update(
        self, z: Array | None, H: Array, R: Array, delay: int, cross: Array | None = None, whole: bool = False
    ) -> None:
        """Measurement update; z flat with NaN for missing components, or None."""
        self.channel.check_delay(delay)
        if z is None or self.step is None:
            super().update(z, H, R, 0, cross, whole)
            return
        pair = self.met = self._pair()
        both, R_both = self.channel.lifted(H, R, 0, pair.x, pair.P)
        if not both[:, self.dim_x :].any():
            super().update(z, H, R, 0, cross, whole)
            return
        mask = measured(z, both, R_both)[3]
        super().update(z if mask.any() else None, both, R_both, 0)
        if mask.any():
            if cross is not None:
                cross = np.vstack([cross, np.zeros_like(cross)])
            row = Effective(both, R_both, (), np.zeros((0, 0)), np.zeros(len(z)))
            self._left(z, row, mask, (pair.x, Covariance.of(pair.P)), cross)

    def _pair(self) -> Lifted:
        """The present state and the one before, as the rows so far left them."""
        n = self.dim_x
        if not self.updated:
            return super()._pair()
        if self.left is not None:
            return Lifted(np.concatenate([self.x, self.left.x[n:]]), self.left.P)
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
        if folds.negligible(row):
            return None
        folds.steps[-1] = step
        solution = self._entered(folds, row)
        if solution is None:
            return self._kalman(z, H, R, cross)
        self.left = None
        return Covariance(_total_gain, (self._solved(solution), T))

    def _kalman(self, z: Array, H: Array, R: Array, cross: Array | None) -> Covariance:
        n, pair = self.dim_x, self.met
        if H.shape[1] == n or pair is None:
            return super()._kalman(z, H, R, cross)
        K, _ = innovation_gain(pair.P, H, R)
        x, P = pair.x + K @ (z - H @ pair.x), joseph(pair.P, K, H, R)
        self.left = Lifted(x, P)
        self._publish(x[:n], Covariance.of(P[:n, :n]))
        return Covariance.of(K[:n])


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
