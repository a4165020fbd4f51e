"""Kim (2019): two tables and four figures."""

from __future__ import annotations

from validation.item import Item
from validation.s3 import table_1

__all__ = ["ITEMS"]

ITEMS: tuple[Item, ...] = (table_1.ITEM,)
