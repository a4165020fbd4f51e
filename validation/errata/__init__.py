"""Printed equations that are wrong: one item for each paper."""

from __future__ import annotations

from validation.errata import s0, s1, s2, s3
from validation.item import Item

__all__ = ["ITEMS"]

ITEMS: tuple[Item, ...] = (s0.ITEM, s1.ITEM, s2.ITEM, s3.ITEM)
