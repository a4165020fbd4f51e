"""Channels: what a network does to measurements on their way, as frozen values.

A channel says three things: with which H and R a filter must take in what arrived (and how that noise goes
with the process noise), whether a second copy of a measurement is new information, and how the channel is
simulated on a recorded or simulated series.
"""

from __future__ import annotations

from .base import Channel, Packet
from .effective import Effective, Step
from .stamped import StampedLoss, TimeStamped
from .unstamped import BernoulliDelay, CompensatedBernoulli

__all__ = [
    "BernoulliDelay",
    "Channel",
    "CompensatedBernoulli",
    "Effective",
    "Packet",
    "StampedLoss",
    "Step",
    "TimeStamped",
]
