"""Which state object a UFIRFilter has: by its way to choose the horizon, and by its channel."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ._bank import AdaptiveState
from ._ufir_state import UFIRState

if TYPE_CHECKING:
    from ..channels import Channel

__all__ = ["new_state", "with_policy"]


def new_state(
    dim_x: int, dim_z: int, policy: int | str, missing: str, window: str, channel: Channel | None
) -> UFIRState:
    """The state object of a new filter; what kind it is, no step has to ask."""
    single, bank = _kinds(channel)
    if policy == "adaptive":
        state: UFIRState = bank(dim_x, dim_z, missing, window)
    else:
        state = single(dim_x, dim_z, policy, missing, window)
    if channel is not None:
        state.channel = channel  # type: ignore[attr-defined]
    return state


def with_policy(state: UFIRState, policy: int | str) -> UFIRState:
    """A filter's state object after its horizon was assigned; the window is kept."""
    state.settle()
    single, bank = _kinds(getattr(state, "channel", None))
    if policy == "adaptive":
        return state if isinstance(state, AdaptiveState) else bank.of(state)
    if isinstance(state, AdaptiveState):
        state = state.single(single)
    state.set_policy(policy)
    return state


def _kinds(channel: Channel | None) -> tuple[type[UFIRState], type[AdaptiveState]]:
    if channel is None:
        return UFIRState, AdaptiveState
    from ._channel_states import kinds

    return kinds(channel)
