"""The state objects of a UFIRFilter behind a channel: one for each way to choose the horizon."""

from __future__ import annotations

from .._arrays import Array
from ..channels import Channel
from ..engines.records import Records
from ._bank import AdaptiveState, Member
from ._channel_rows import CorrelatedWindow, EffectiveRows, StampedRows
from ._ufir_state import UFIRState

__all__ = ["kinds"]


class StampedUFIRState(StampedRows, UFIRState):
    """One horizon, behind a channel with time stamps."""


class StampedAdaptiveState(StampedRows, AdaptiveState):
    """A bank of horizons, behind a channel with time stamps."""


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


def kinds(channel: Channel) -> tuple[type[UFIRState], type[AdaptiveState]]:
    """The state objects for one horizon and for a bank of horizons."""
    if channel.stamped:
        return StampedUFIRState, StampedAdaptiveState
    return AveragedUFIRState, AveragedAdaptiveState
