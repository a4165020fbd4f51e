"""Items, one module each."""

from __future__ import annotations

from validation.item import Item

__all__ = ["ITEMS"]

ITEMS: tuple[Item, ...] = ()
