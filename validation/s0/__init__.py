"""Uribe-Murcia et al. (2018): three figures on time-stamped delays."""

from __future__ import annotations

from validation.item import Item
from validation.s0 import fig_3

__all__ = ["ITEMS"]

ITEMS: tuple[Item, ...] = (fig_3.ITEM,)
