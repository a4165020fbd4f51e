"""Kim (2019): two tables and four figures."""

from __future__ import annotations

from validation.item import Item
from validation.s3 import fig_1, fig_2, fig_3, fig_4, table_1, table_2

__all__ = ["ITEMS"]

ITEMS: tuple[Item, ...] = (table_1.ITEM, fig_1.ITEM, fig_2.ITEM, fig_3.ITEM, fig_4.ITEM, table_2.ITEM)
