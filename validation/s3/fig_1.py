"""Figure 1: suddenly changing acceleration, step."""

from __future__ import annotations

from validation.item import Item
from validation.papers import S3
from validation.s3 import table_2
from validation.s3.scenario import JUMP_CLAIMS, OPEN, runner

__all__ = ["ITEM"]

ITEM = Item(
    id="s3-fig-1",
    paper=S3,
    title="Figure 1: suddenly changing acceleration, step",
    run=runner("s3-fig-1", "step", jumps=(200, 400)),
    claims=JUMP_CLAIMS,
    parameters=table_2.ITEM.parameters,
    open_questions=OPEN,
    assumptions=table_2.ITEM.assumptions,
)
