"""State object of the Kalman filter of the augmented state."""

from __future__ import annotations

from typing import Any

import numpy as np

from .._arrays import Array, symmetric
from ..channels import Channel
from ..channels.effective import at_block
from ..engines.covariance import Covariance
from ..recursions.augmented import Lifted, lift, predict_lifted
from ..recursions.kalman import Posterior, update
from ._late import LateState, Left, Mask, left_behind, measured_part


class LiftedState(LateState):
    """The Kalman filter of the augmented state [x_n; x_{n-1}; ..]."""

    def __init__(self, dim_x: int, dim_z: int, channel: Channel) -> None:
        super().__init__(dim_x, dim_z, channel)
        self.tall = lift(self.x, self.P.value, channel.max_delay + 1)

    def _settled(self) -> Lifted:
        """The augmented state with x and P as they are now."""
        if self.P is not self.own_P:
            self.tall = with_marginal(self.tall, self.P.value)
            self.own_P = self.P
        return self.tall

    def _held(self) -> Any:
        return self.tall.P

    def _resume(self, held: Any, steps: int) -> None:
        self.tall, self.own_P = Lifted(self.x, held), self.P

    def _repeats(self) -> bool:
        return super()._repeats() and self.channel.max_delay == 0

    def _moved(self, delta: Array) -> None:
        super()._moved(delta)
        x = self.tall.x.copy()
        x[: self.dim_x] += delta
        self.tall = self.tall._replace(x=x)

    def _ahead(self, F: Array, Q: Array, known: Array | None) -> tuple[Array, Array]:
        n = self.dim_x
        self.tall = predict_lifted(self._closed(self._settled()), F, Q, known, self.fading)
        if self.edited is not None and len(self.tall.x) > n:
            # Rows of the step that ends saw the state before x was moved.
            self.tall.x[n : 2 * n] -= self.edited
        return self.tall.x[:n].copy(), self.tall.P[:n, :n].copy()

    def _taken(
        self, z: Array, H: Array, R: Array, mask: Mask | None, delay: int, cross: Array | None
    ) -> tuple[Left, Array, Array]:
        n, state = self.dim_x, self._start()
        if len(state.x) == n:
            big_H = H
        elif self.now:
            big_H, R = self.channel.lifted(H, R, delay, state.x, state.P)
        else:
            big_H = at_block(H, 0, len(state.x))
        if cross is not None:
            cross = np.vstack([cross, np.zeros((len(state.x) - n, len(H)))])
        posterior = self._updated(state, *measured_part(mask, z, big_H, R, cross))
        self.tall = Lifted(posterior.x, posterior.P)
        left = left_behind(z, big_H, R, mask, state.x, Covariance.of(state.P), posterior.K[:n], cross, None)
        return left, posterior.x[:n], posterior.P[:n, :n]

    def lagged(self, lag: int) -> tuple[Array, Array]:
        """The state `lag` steps ago, in the client's form, and its covariance."""
        state, n = self._settled(), self.dim_x
        at = slice(lag * n, (lag + 1) * n)
        return self.shaped(state.x[at]), state.P[at, at].copy()

    def _start(self) -> Lifted:
        """The augmented state that a measurement of this step meets."""
        return self._settled()

    def _closed(self, state: Lifted) -> Lifted:
        """The augmented state at the end of its step."""
        return state

    def _updated(self, state: Lifted, z: Array, H: Array, R: Array, cross: Array | None) -> Posterior:
        return update(state.x, state.P, z, H, R, cross)


def with_marginal(state: Lifted, P: Array) -> Lifted:
    """Another covariance of the newest block; what the older ones are given the newest stays."""
    n = len(P)
    old, joint = state.P[:n, :n], state.P[n:, :n]
    if not len(joint):
        return state._replace(P=P)
    regression = joint @ np.linalg.pinv(old, hermitian=True)
    big = state.P.copy()
    big[:n, :n] = P
    big[n:, :n] = regression @ P
    big[:n, n:] = big[n:, :n].T
    big[n:, n:] = symmetric(big[n:, n:] + regression @ (P - old) @ regression.T)
    return state._replace(P=big)
