"""Uribe-Murcia et al. (2018): three figures on time-stamped delays."""

from __future__ import annotations

from validation.item import Item
from validation.s0 import fig_3, fig_4, fig_5

__all__ = ["ITEMS"]

ITEMS: tuple[Item, ...] = (fig_3.ITEM, fig_4.ITEM, fig_5.ITEM)
