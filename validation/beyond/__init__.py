"""Beyond the papers: robustness, real tracks, certificates, peers."""

from __future__ import annotations

from validation.beyond import hinfinity_gap, late_kalman, outliers, real_tracks, wrong_noise
from validation.item import Item

__all__ = ["ITEMS"]

ITEMS: tuple[Item, ...] = (
    wrong_noise.ITEM,
    outliers.ITEM,
    real_tracks.ITEM,
    late_kalman.ITEM,
    hinfinity_gap.ITEM,
)
