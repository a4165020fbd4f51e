"""Witnesses from outside: convex solvers certify the gains, other libraries filter the same data."""

from __future__ import annotations

from validation.item import Item
from validation.witnesses import certificates, peers

__all__ = ["ITEMS"]

ITEMS: tuple[Item, ...] = (certificates.ITEM, peers.ITEM)
