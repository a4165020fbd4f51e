"""Uribe-Murcia et al. (2022): six figures on networks with and without time stamps."""

from __future__ import annotations

from validation.item import Item
from validation.s1 import figs_2_to_5, figs_6_7

__all__ = ["ITEMS"]

ITEMS: tuple[Item, ...] = (*figs_2_to_5.PICTURES, *figs_6_7.PICTURES)
