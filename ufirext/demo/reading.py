"""What the demo's table says, in words: made from the scores, as every track has its own."""

from __future__ import annotations

import math
from collections.abc import Mapping

from .compare import SCENARIOS, Score

__all__ = ["reading"]

YARDSTICKS = {late: f"{kind}, right Q, R" for late, kind in ((False, "Kalman"), (True, "Delay Kalman"))}
"""The Kalman filter of least error, without late packets and with them."""


def reading(scores: Mapping[str, Mapping[str, Score]]) -> list[str]:
    """Notes for a reader of the table: what happens to late packets, who errs least, who is who."""
    late = next(link for link in SCENARIOS.values() if link.late)
    return [
        f"Late packets are 1 to {late.longest} steps late. KalmanFilter has no place for them: it takes "
        "them as new or not at all. The others are told the delay.",
        _who_errs_least(scores),
        "Kalman is filterpy's KalmanFilter, UFIR is UFIRFilter: its horizon auto is chosen from the model's "
        "Q and R, adaptive from the data alone. FMS is FMSFilterSmoother, minimum variance over a window "
        "half as long again as that of UFIR auto; Delay Kalman and H-infinity are DelayKalmanFilter and "
        "DelayHInfinityFilter, which bounds the errors of the position.",
    ]


def _who_errs_least(scores: Mapping[str, Mapping[str, Score]]) -> str:
    """Whether, and by whom, the Kalman filter with the right Q and R is beaten by over a standard error."""
    beaten = []
    for scenario, link in SCENARIOS.items():
        yardstick = scores[YARDSTICKS[bool(link.late)]][scenario]
        name = min((n for n in scores if scenario in scores[n]), key=lambda n: scores[n][scenario].rmse)
        best = scores[name][scenario]
        margin = max(0.005, *(s.error for s in (best, yardstick) if not math.isnan(s.error)), 0.0)
        if best.rmse < yardstick.rmse - margin:
            beaten.append(f"{scenario}, {name} ({best.rmse:.2f} m against {yardstick.rmse:.2f} m)")
    who = "the Kalman filter with the right Q and R, with late packets the one that knows delays,"
    if not beaten:
        return (
            f"In this table nothing beats {who} by more than a standard error: it is the yardstick; "
            "finite memory and H-infinity are for when Q and R are not right."
        )
    return (
        f"In this table {who} does not err least: {'; '.join(beaten)}. It is optimal where the model holds; "
        "this track, or its errors, are not what the model says."
    )
