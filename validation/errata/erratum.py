"""A printed equation that is wrong, as a claim that a number decides."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from validation.claims import Claim, Reported, Tolerance, relative
from validation.item import Item, Outcome, Table
from validation.papers import ERRATA, Paper
from validation.report.words import number, reported
from validation.study import Study

__all__ = ["Erratum", "Numbers", "errata_item"]

ROUNDING = relative(1e-9)


@dataclass(frozen=True)
class Numbers:
    """One quantity, three ways.

    Attributes
    ----------
    printed : float or Interval
        As the printed equation gives it, taken literally, or what the text promises of it.
    ours : float
        As the library gives it.
    truth : float or Interval
        From a computation that uses neither: a simulation, a peer, a count.
    tolerance : Tolerance
        Of ours against the truth.
    standard_error : float
        Where the truth is simulated.
    unit : str
    """

    printed: Reported
    ours: float
    truth: Reported
    tolerance: Tolerance = ROUNDING
    standard_error: float = 0.0
    unit: str = ""


@dataclass(frozen=True)
class Erratum:
    """What is printed, what is right, and how the difference shows.

    Attributes
    ----------
    equation : str
        Its number, or where the text is.
    quantity : str
        What is computed three ways.
    printed, right : str
        Both forms in words or letters.
    numbers : callable
        Study -> Numbers.
    """

    equation: str
    quantity: str
    printed: str
    right: str
    numbers: Callable[[Study], Numbers]

    @property
    def name(self) -> str:
        """Name of the claim."""
        return f"{self.equation}: {self.quantity}"


def errata_item(paper: Paper, errata: Sequence[Erratum], misprints: str) -> Item:
    """The item of a paper's errata; `misprints` are those that no number decides."""
    key = f"errata-{paper.key}"
    return Item(
        id=key,
        paper=ERRATA,
        title=f"Printed equations of {paper.key.upper()} that are wrong",
        run=partial(_run, key, tuple(errata), f"Misprints that no number decides: {misprints}"),
        claims=[erratum.name for erratum in errata],
        assumptions=[
            "Reported is what the printed equation gives, taken literally; the prediction is a computation "
            "that uses neither. A printed equation that turned out right would fail the suite."
        ],
    )


def _run(key: str, errata: Sequence[Erratum], misprints: str, study: Study) -> Outcome:
    claims, rows = [], []
    for erratum in errata:
        found = erratum.numbers(study)
        claim = Claim(
            paper="errata",
            item=key,
            name=erratum.name,
            reported=found.printed,
            ours=found.ours,
            tolerance=found.tolerance,
            standard_error=found.standard_error,
            because=f"Printed: {erratum.printed}. Right: {erratum.right}.",
            expected=found.truth,
            unit=found.unit,
        )
        if claim.agrees:
            raise ValueError(f"{claim.key}: what is printed gives the right number, {found.printed}")
        claims.append(claim)
        rows.append((erratum.name, reported(found.printed), reported(found.truth), number(found.ours)))
    columns = ("equation", "as printed", "independent", "ours")
    return Outcome(claims, [Table("Each number three ways", columns, rows)], notes=[misprints])
