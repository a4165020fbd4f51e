"""All items of the suite, in the order of the report."""

from __future__ import annotations

from validation import beyond, errata, s0, s1, s2, s3, witnesses
from validation.item import Item

__all__ = ["all_items"]


def all_items() -> tuple[Item, ...]:
    """Every item; a new one is named in its package's `ITEMS`."""
    items = (*s0.ITEMS, *s1.ITEMS, *s2.ITEMS, *s3.ITEMS, *errata.ITEMS, *beyond.ITEMS, *witnesses.ITEMS)
    ids = [item.id for item in items]
    twice = {name for name in ids if ids.count(name) > 1}
    if twice:
        raise ValueError(f"ids of items must be distinct, got twice: {', '.join(sorted(twice))}")
    return items
