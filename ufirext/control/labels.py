"""Names of signals and states, as python-control spells them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import control as ct

from .plant import Plant

__all__ = ["Labels", "Names", "labels", "signal_names"]

Names = str | Sequence[str] | None


@dataclass(frozen=True)
class Labels:
    """Signals of an estimator; `inputs` and `outputs` are what its system is built with."""

    estimate: list[str]
    measurement: list[str]
    control: list[str]
    inputs: Any
    outputs: Any


def labels(
    plant: Plant, estimate: Names, measurement: Names, control: Names, inputs: Any, outputs: Any
) -> Labels:
    """The names of xhat, y and u, and the inputs (y then u) and outputs that they make."""
    xhat = signal_names(estimate, "estimate", [f"xhat[{i}]" for i in range(plant.dim_x)])
    y = signal_names(measurement, "measurement", plant.measured)
    u = signal_names(control, "control", plant.known)
    return Labels(xhat, y, u, y + u if inputs is None else inputs, xhat if outputs is None else outputs)


def signal_names(given: Names, kind: str, default: list[str]) -> list[str]:
    """The names given, those that a format string in {i} makes, or the default ones."""
    if given is None:
        return default
    if isinstance(given, str):
        return [given.format(i=i) for i in range(len(default))]
    if not isinstance(given, list | tuple):
        raise ct.ControlArgument(f"{kind}_labels should be a string or a list, got {given!r}")
    if len(given) != len(default):
        raise ct.ControlDimension(
            f"incorrect length of {kind}_labels: {len(given)} instead of {len(default)}"
        )
    return list(given)
