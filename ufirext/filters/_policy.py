"""Which state object a UFIRFilter has: by its way to choose the horizon, and by its channel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .._arrays import FLOAT, shown
from ..engines.records import Limits
from ..errors import HorizonError
from ._bank import AdaptiveState
from ._ufir_state import UFIRState

if TYPE_CHECKING:
    from ..channels import Channel

__all__ = ["new_state", "with_policy"]

# Bytes that are there without asking.
PLENTY = 2**28


def new_state(
    dim_x: int, dim_z: int, policy: int | str, missing: str, window: str, channel: Channel | None
) -> UFIRState:
    """The state object of a new filter; what kind it is, no step has to ask."""
    _require_memory(dim_x, dim_z, policy, missing)
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
    _require_memory(state.dim_x, state.dim_z, policy, state.missing)
    state.settle()
    single, bank = _kinds(getattr(state, "channel", None))
    if policy == "adaptive":
        return state if isinstance(state, AdaptiveState) else bank.of(state)
    if isinstance(state, AdaptiveState):
        state = state.single(single)
    state.set_policy(policy)
    return state


def _require_memory(dim_x: int, dim_z: int, policy: int | str, missing: str) -> None:
    """Raise where the window of a horizon cannot be had; nothing else stops so long a one before its time."""
    if isinstance(policy, str):
        return
    reach = Limits(policy, 1, missing != "skip", True).reach
    buffer, sums = 5 * reach * (dim_z + 2) // 2, 2 * policy * dim_x * (dim_x + 1)
    needed = FLOAT.itemsize * max(buffer, sums)
    if needed < PLENTY:
        return
    try:
        np.empty(needed, np.uint8)
    except (MemoryError, ValueError, OverflowError) as error:
        raise HorizonError(
            f"horizon must be a window that fits into memory, got {shown(policy)}, which needs at "
            f"least {min(needed >> 30, 10**18)} GiB: the best one is seldom beyond some hundreds, "
            'horizon="auto" chooses it'
        ) from error


def _kinds(channel: Channel | None) -> tuple[type[UFIRState], type[AdaptiveState]]:
    if channel is None:
        return UFIRState, AdaptiveState
    from ._channel_states import kinds

    return kinds(channel)
