"""Uribe-Murcia et al. (2019): two tables and four figures on delays without time stamps."""

from __future__ import annotations

from validation.item import Item
from validation.s2 import fig_4, fig_5
from validation.s2.figs_2_3 import FIG_2, FIG_3
from validation.s2.tables import TABLE_1, TABLE_2

__all__ = ["ITEMS"]

ITEMS: tuple[Item, ...] = (TABLE_1, TABLE_2, FIG_2, FIG_3, fig_4.ITEM, fig_5.ITEM)
