"""Table 1: work for a step and memory, FMS filter-smoother against fixed-lag Kalman smoother."""

from __future__ import annotations

from validation.claims import Claim, Tolerance, printed
from validation.item import Item, Outcome, Table
from validation.papers import S3
from validation.s3.tracking import A, C, D, M, gain
from validation.study import Study

__all__ = ["ITEM"]


def run(study: Study) -> Outcome:
    """Count the products of the online step from the shape of the gain that is applied."""
    n, q = len(A), len(C)
    H = gain().H
    multiplications = H[:n].size
    kalman = 4 * n**3 + 8 * n**2 + 6 * n + 1
    rows = [
        ("multiplications for x_i", f"n M = {n * M}", multiplications),
        ("multiplications for x_{i-d}", f"n M = {n * M}", H[n:].size),
        ("fixed-lag Kalman smoother", f"4n³ + 8n² + 6n + 1 = {kalman}", "as printed"),
        ("values stored", f"M = {M}, against d = {D}", H.shape[1]),
    ]
    claims = [
        Claim("s3", ITEM.id, "multiplications for each output", n * M * q, multiplications, printed(0)),
        Claim("s3", ITEM.id, "values stored", M, H.shape[1], Tolerance()),
    ]
    return Outcome(claims, [Table("Counted on the gain that is applied", ("", "paper", "ours"), rows)])


ITEM = Item(
    id="s3-table-1",
    paper=S3,
    title="Table 1: online computation and memory",
    run=run,
    claims=("multiplications for each output", "values stored"),
    parameters={"n": "3", "M": "15", "d": "5", "q": "1"},
    open_questions=["Whether a flop is a product, a sum or both: n M counts products only."],
    assumptions=["A flop is a multiplication, on both sides."],
)
