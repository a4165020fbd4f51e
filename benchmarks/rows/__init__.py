"""One module per group of rows, each with a list ROWS; a new group is one more name in GROUPS."""

from __future__ import annotations

import importlib

from benchmarks.harness import Row

__all__ = ["GROUPS", "all_rows"]

GROUPS = (
    "streaming",
    "edits",
    "holes",
    "varying",
    "fms",
    "delays",
    "trackers",
    "fleet",
    "parts",
    "series",
    "gains",
    "imports",
)


def all_rows() -> list[Row]:
    """Every row, in the order of the table."""
    return [row for group in GROUPS for row in importlib.import_module(f"benchmarks.rows.{group}").ROWS]
