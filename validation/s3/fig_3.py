"""Figure 3: slowly changing acceleration, triangle."""

from __future__ import annotations

from validation.item import Item
from validation.papers import S3
from validation.s3 import table_2
from validation.s3.scenario import OPEN, SLOW_CLAIMS, runner

__all__ = ["ITEM"]

ITEM = Item(
    id="s3-fig-3",
    paper=S3,
    title="Figure 3: slowly changing acceleration, triangle",
    run=runner("s3-fig-3", "triangle"),
    claims=SLOW_CLAIMS,
    parameters=table_2.ITEM.parameters,
    open_questions=OPEN,
    assumptions=table_2.ITEM.assumptions,
)
