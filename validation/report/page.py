"""The report as one page that needs nothing beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from validation.claims import Verdict
from validation.papers import ERRATA, GROUPS
from validation.report import words
from validation.results import Drift, Summary
from validation.runner import Result

__all__ = ["report_page"]

CLASSES = {
    Verdict.REPRODUCED: "good",
    Verdict.SAMPLING: "fair",
    Verdict.EXPLAINED: "odd",
    Verdict.DIFFERS: "bad",
    Verdict.CANNOT_RUN: "off",
    Verdict.NOT_RUN: "bad",
}


def report_page(
    results: Sequence[Result], summary: Summary, moved: Sequence[Drift], pictures: Mapping[str, str]
) -> str:
    """The page as text; `pictures` has SVG by item."""
    environment = Environment(
        loader=PackageLoader("validation.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals.update(words=words, classes=CLASSES, verdicts=list(Verdict))
    odd = words.reasons(c for c in summary.claims if c.paper != ERRATA.key)
    return environment.get_template("report.html.j2").render(
        groups=[(paper, [r for r in results if r.item.paper == paper]) for paper in GROUPS],
        summary=summary,
        total=words.counted(summary.claims),
        odd=odd,
        failed=[claim for claim in summary.claims if claim.verdict.fails],
        moved=moved,
        pictures={name: Markup(picture) for name, picture in pictures.items()},
    )
