"""State object of the Kalman recursion on the present state alone: exact, or a baseline."""

from __future__ import annotations

import numpy as np

from .._arrays import Array
from ..channels import Channel, Effective
from ..channels.effective import on_time
from ..recursions.delayed import (
    Correlation,
    Delayed,
    corrected,
    cross_covariance,
    predict_delayed,
    update_delayed,
)
from ..recursions.kalman import update
from ._late import LateState, Left, Mask, left_behind, measured_part


class RecursiveState(LateState):
    """The recursion on the present state alone, with all, some or none of the correlation."""

    def __init__(self, dim_x: int, dim_z: int, channel: Channel, correlation: Correlation) -> None:
        super().__init__(dim_x, dim_z, channel)
        self.correlation = correlation
        self.memory = Delayed(self.x, self.P.value)

    def _remembered(self) -> Delayed:
        """The memory with x and P as they are now; another P says nothing of how it goes with past noises."""
        memory = self.memory
        E = memory.E if self.P is self.own_P else tuple(np.zeros_like(E) for E in memory.E)
        return Delayed(self.x, self.P.value, E, memory.past)

    def _held(self) -> Delayed:
        return self.memory

    def _resume(self, held: Delayed, steps: int) -> None:
        self.memory, self.own_P = held, self.P

    def _levels(self) -> list[Array]:
        return [self.P.value, *self.memory.E]

    def _repeats(self) -> bool:
        inputs = any(step.Bu is not None for step in self.memory.past)
        return super()._repeats() and not inputs and len(self.memory.past) == self.channel.max_delay

    def _moved(self, delta: Array) -> None:
        super()._moved(delta)
        if not self.updated and self.memory.past:
            *older, newest = self.memory.past
            Bu = delta if newest.Bu is None else newest.Bu + delta
            self.memory = self.memory._replace(past=(*older, newest._replace(Bu=Bu)))

    def _ahead(self, F: Array, Q: Array, known: Array | None) -> tuple[Array, Array]:
        depth = self.channel.max_delay
        state = predict_delayed(self._remembered(), F, Q, known, depth=depth, fading=self.fading)
        if self.edited is not None and depth:
            *older, newest = state.past
            Bu = F @ self.edited if known is None else known + F @ self.edited
            state = state._replace(past=(*older, newest._replace(Bu=Bu)))
        self.memory = state
        return state.x, state.P

    def _taken(
        self, z: Array, H: Array, R: Array, mask: Mask | None, delay: int, cross: Array | None
    ) -> tuple[Left, Array, Array]:
        state = self._remembered()
        if delay == 0 and self.channel.stamped:
            row_H, row_R, offset, met = H, R, None, cross
            z_in, H_in, R_in, cross_in = measured_part(mask, z, H, R, cross)
            posterior = update(state.x, state.P, z_in, H_in, R_in, cross_in)
            self.memory = corrected(state, posterior, H_in)
        else:
            row = self._row(state, H, R, delay)
            row_H, row_R, offset = row.H, row.R, row.offset
            met = cross_covariance(state, row, self.correlation, cross)
            z_in, *_, cross_in = measured_part(mask, z, H, R, cross)
            self.memory, posterior = update_delayed(
                state, z_in, _components(row, mask), self.correlation, cross_in
            )
        left = left_behind(z, row_H, row_R, mask, state.x, self.P, posterior.K, met, offset)
        return left, posterior.x, posterior.P

    def _row(self, state: Delayed, H: Array, R: Array, delay: int) -> Effective:
        if not state.past:
            return on_time(H, R)
        x, P = (self.prior[0], self.prior[1].value) if self.updated else (state.x, state.P)
        row = self.channel.row(H, R, state.past, delay, x, P)
        if delay and self.edited is not None:
            # The measurement saw the state before x was moved.
            row = row._replace(offset=row.offset + row.H @ self.edited)
        return row


def _components(row: Effective, mask: Mask | None) -> Effective:
    """The measured components of a row."""
    if mask is None:
        return row
    return Effective(
        row.H[mask],
        row.R[np.ix_(mask, mask)],
        tuple(G[mask] for G in row.G),
        row.correlation[:, mask],
        row.offset[mask],
    )
