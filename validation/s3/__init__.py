"""Kim (2019): two tables and four figures."""

from __future__ import annotations

from validation.item import Item
from validation.s3 import table_1, table_2

__all__ = ["ITEMS"]

ITEMS: tuple[Item, ...] = (table_1.ITEM, table_2.ITEM)
