"""The state objects of the window filters: one for each way to choose the horizon and kind of channel.

The kind is chosen when a filter is made or its horizon assigned, so that no step has to ask.
"""

from __future__ import annotations

from typing import TypeVar

from .._arrays import Array
from ..channels import Channel
from ..engines.records import Records
from ._bank import AdaptiveState, Member
from ._channel_fms import AveragedFMSState
from ._channel_rows import ChannelState, CorrelatedWindow, EffectiveRows, StampedRows
from ._fms_state import FMSState
from ._ufir_state import UFIRState

__all__ = ["fms_state", "ufir_state", "with_policy"]

State = TypeVar("State", FMSState, UFIRState)


class StampedUFIRState(StampedRows, UFIRState):
    """One horizon, behind a channel with time stamps."""


class StampedAdaptiveState(StampedRows, AdaptiveState):
    """A bank of horizons, behind a channel with time stamps."""


class StampedFMSState(StampedRows, FMSState):
    """Minimum variance, behind a channel with time stamps."""


class AveragedUFIRState(EffectiveRows, UFIRState):
    """One horizon, behind a channel without time stamps."""


class AveragedMember(CorrelatedWindow, Member):
    """A candidate of a bank behind a channel without time stamps."""


class AveragedAdaptiveState(EffectiveRows, AdaptiveState):
    """A bank of horizons, behind a channel without time stamps."""

    def _member(self, horizon: int, past: Records | None) -> Member:
        return AveragedMember(self, horizon, past)

    def _correlate(self, correlation: Array) -> None:
        for member in self.members:
            if isinstance(member, AveragedMember):
                member.correlation = correlation


def ufir_state(
    dim_x: int, dim_z: int, policy: int | str, missing: str, window: str, channel: Channel | None
) -> UFIRState:
    """The state object of a new UFIRFilter."""
    single, bank = _kinds(channel)
    if policy == "adaptive":
        state: UFIRState = bank(dim_x, dim_z, missing, window)
    else:
        state = single(dim_x, dim_z, policy, missing, window)
    return _behind(state, channel)


def with_policy(state: UFIRState, policy: int | str) -> UFIRState:
    """A UFIRFilter's state object after its horizon was assigned; the window is kept."""
    state.settle()
    single, bank = _kinds(state.channel if isinstance(state, ChannelState) else None)
    if policy == "adaptive":
        return state if isinstance(state, AdaptiveState) else bank.of(state)
    if isinstance(state, AdaptiveState):
        state = state.single(single)
    state.set_policy(policy)
    return state


def fms_state(dim_x: int, dim_z: int, horizon: int, lag: int, channel: Channel | None) -> FMSState:
    """The state object of a new FMSFilterSmoother."""
    if channel is None:
        return FMSState(dim_x, dim_z, horizon, lag)
    kind = StampedFMSState if channel.stamped else AveragedFMSState
    return _behind(kind(dim_x, dim_z, horizon, lag), channel)


def _kinds(channel: Channel | None) -> tuple[type[UFIRState], type[AdaptiveState]]:
    if channel is None:
        return UFIRState, AdaptiveState
    if channel.stamped:
        return StampedUFIRState, StampedAdaptiveState
    return AveragedUFIRState, AveragedAdaptiveState


def _behind(state: State, channel: Channel | None) -> State:
    if isinstance(state, ChannelState) and channel is not None:
        state.behind(channel)
    return state
