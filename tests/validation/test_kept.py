"""The results that are checked in are those of the items there are, and the documentation shows them."""

from __future__ import annotations

from pathlib import Path

import pytest

from validation.registry import all_items
from validation.report.markdown import docs_page
from validation.results import kept
from validation.study import Mode

PAGE = Path(__file__).parents[2] / "docs" / "validation.md"


@pytest.mark.parametrize("mode", ["quick", "full"])
def test_every_claim_was_run_and_none_differs_without_a_reason(mode: Mode) -> None:
    found = kept(mode)
    assert found is not None, f"run python -m validation --{mode} --keep"
    promised = [(item.id, name) for item in all_items() for name in item.claims]
    assert [(claim.item, claim.name) for claim in found.claims] == promised
    assert [claim.key for claim in found.claims if claim.verdict.fails] == []


def test_the_documentation_shows_the_results_that_are_kept() -> None:
    summaries = [summary for summary in (kept("full"), kept("quick")) if summary is not None]
    assert PAGE.read_text(encoding="utf-8") == docs_page(all_items(), summaries), (
        "run python -m validation docs"
    )
