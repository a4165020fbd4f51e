"""What an item promised is what it is held to."""

from __future__ import annotations

import pytest

from tests.validation.items import claim, crashing, good, item
from validation.claims import Verdict
from validation.item import CannotRun, Item, Outcome, recorded_tracks
from validation.registry import all_items
from validation.runner import Result, chosen, run_item
from validation.study import Study


def result(run: object) -> Result:
    return run_item(item(run), Study("s3-try"))  # type: ignore[arg-type]


def verdicts(found: Result) -> dict[str, Verdict]:
    return {claim.name: claim.verdict for claim in found.outcome.claims}


def test_claims_come_in_the_order_of_the_promise() -> None:
    assert list(verdicts(result(good)).values()) == [Verdict.REPRODUCED] * 2
    assert list(verdicts(result(good))) == ["a", "b"]


def test_a_claim_that_is_not_returned_was_not_run_and_fails() -> None:
    found = result(lambda study: Outcome([claim("a", 1.0)]))
    assert verdicts(found) == {"a": Verdict.REPRODUCED, "b": Verdict.NOT_RUN}
    assert found.fails


def test_an_item_that_raises_leaves_its_claims_not_run_and_says_why() -> None:
    found = result(crashing)
    assert set(verdicts(found).values()) == {Verdict.NOT_RUN}
    assert found.outcome.claims[0].because == "ZeroDivisionError: by zero"


def test_an_item_without_its_data_cannot_be_run_and_does_not_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("UFIREXT_DATA", raising=False)

    def run(study: Study) -> Outcome:
        recorded_tracks()
        raise AssertionError

    found = result(run)
    assert set(verdicts(found).values()) == {Verdict.CANNOT_RUN}
    assert not found.fails


def test_a_folder_that_is_none_cannot_be_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UFIREXT_DATA", "no/such/folder")
    with pytest.raises(CannotRun, match="not a folder"):
        recorded_tracks()


@pytest.mark.parametrize(
    "claims",
    [
        [claim("a", 1.0), claim("b", 1.0), claim("c", 1.0)],
        [claim("a", 1.0), claim("a", 1.0)],
        [claim("a", 1.0), claim("b", 1.0, item="s3-other")],
    ],
)
def test_claims_that_were_not_promised_are_refused(claims: list[object]) -> None:
    found = result(lambda study: Outcome(claims))  # type: ignore[arg-type]
    assert set(verdicts(found).values()) == {Verdict.NOT_RUN}


def test_items_are_chosen_by_name_beginning_or_pattern() -> None:
    names = ["s3-fig-1", "s3-fig-10", "s3-table-2", "s0-fig-3"]
    items = [item(good, name=f"s3-{name}") for name in names]
    assert [i.id for i in chosen(items, ["s3-s3-fig-1"])] == ["s3-s3-fig-1"]
    assert len(chosen(items, ["s3-s3-fig"])) == 2
    assert len(chosen(items, ["*-fig-*"])) == 3
    assert len(chosen(items, [])) == 4
    with pytest.raises(ValueError, match="no item matches nothing; there are s3-s3-fig-1"):
        chosen(items, ["nothing"])


def test_an_item_has_its_papers_key_and_distinct_claims() -> None:
    with pytest.raises(ValueError, match="key of its paper"):
        item(good, name="fig-1")
    with pytest.raises(ValueError, match="distinct names"):
        item(good, claims=("a", "a"))


def test_every_table_and_figure_of_the_four_papers_has_an_item() -> None:
    papers = {
        "s0": ["fig-3", "fig-4", "fig-5"],
        "s1": [f"fig-{n}" for n in range(2, 8)],
        "s2": ["table-1", "table-2", *(f"fig-{n}" for n in range(2, 6))],
        "s3": ["table-1", "table-2", *(f"fig-{n}" for n in range(1, 5))],
        "errata": ["s0", "s1", "s2", "s3"],
    }
    wanted = {f"{paper}-{name}" for paper, names in papers.items() for name in names}
    assert wanted <= {i.id for i in all_items()}


@pytest.mark.parametrize("found", all_items(), ids=lambda i: i.id)
def test_every_item_says_what_it_is(found: Item) -> None:
    assert found.title
    assert found.open_questions or found.assumptions
