"""Numbers, tolerances and counts in words, the same in every form of the report."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from typing import NamedTuple

from validation.claims import Claim, Interval, Reported, Tolerance, Verdict
from validation.results import Drift

__all__ = [
    "MEANING",
    "Reason",
    "allowed",
    "counted",
    "number",
    "ours",
    "reasons",
    "reported",
    "sentence",
    "shift",
    "unavailable",
]

MEANING = {
    Verdict.REPRODUCED: "equal up to the printed digits, or the statement holds",
    Verdict.SAMPLING: "equal up to the chance of the simulated runs",
    Verdict.EXPLAINED: "another number, which the reason given predicts",
    Verdict.DIFFERS: "another number, and no reason that predicts it",
    Verdict.CANNOT_RUN: "what it needs is not here",
    Verdict.NOT_RUN: "promised, but nobody ran it",
}


def number(value: float | str, digits: int = 4) -> str:
    """Four significant digits; large and small ones with a power of ten."""
    if isinstance(value, str):
        return value
    if not value or isinstance(value, int) or not math.isfinite(value):
        return {"inf": "∞", "-inf": "−∞", "nan": "–", "0.0": "0", "-0.0": "0"}.get(str(value), str(value))
    text = f"{value:.{digits}g}"
    if "e" in text:
        mantissa, _, power = text.partition("e")
        return f"{mantissa}e{int(power)}"
    return text


def reported(value: Reported | None) -> str:
    """A printed number as a number, a statement in its words."""
    if value is None:
        return "–"
    return str(value) if isinstance(value, Interval) else number(value)


def ours(claim: Claim) -> str:
    """Our number with its unit, and the standard error of the comparison where there is one."""
    if claim.ours is None:
        return "–"
    error = f" ± {number(claim.standard_error, 2)}" if claim.standard_error else ""
    return f"{number(claim.ours)}{error}{' ' if claim.unit else ''}{claim.unit}"


def allowed(tolerance: Tolerance) -> str:
    """What a tolerance allows."""
    parts = [
        number(tolerance.absolute, 2) if tolerance.absolute else "",
        _share(tolerance.relative) if tolerance.relative else "",
        f"{tolerance.sigmas:g} s.e." if tolerance.sigmas else "",
    ]
    return " + ".join(filter(None, parts)) or "exact"


def _share(fraction: float) -> str:
    return f"{100 * fraction:.3g} %" if fraction >= 1e-4 else f"{number(fraction, 2)} relative"


def counted(claims: Iterable[Claim]) -> dict[Verdict, int]:
    """Verdict -> how many, in the order of the verdicts, those that occur."""
    counts = Counter(claim.verdict for claim in claims)
    return {verdict: counts[verdict] for verdict in Verdict if counts[verdict]}


class Reason(NamedTuple):
    """A reason, and the claims that share it."""

    text: str
    claims: list[Claim]

    @property
    def names(self) -> str:
        """The claims by name, the first few of many."""
        shown = [claim.name for claim in self.claims[:2]]
        more = len(self.claims) - len(shown)
        return ", ".join(shown) + (f" and {more} more" if more else "")

    @property
    def predictions(self) -> str:
        """What the reason predicts for them, each number once."""
        return "; ".join(dict.fromkeys(reported(c.expected) for c in self.claims if c.expected is not None))


def reasons(claims: Iterable[Claim]) -> list[Reason]:
    """Why claims differ or cannot be run, in their order; a reason that several share comes once."""
    shared: dict[str, list[Claim]] = {}
    for claim in claims:
        if claim.because and not claim.agrees:
            shared.setdefault(sentence(claim.because), []).append(claim)
    return [Reason(text, found) for text, found in shared.items()]


def unavailable(claims: Iterable[Claim]) -> list[str]:
    """What could not be run here, and because of what, one line for each reason."""
    missing = reasons(claim for claim in claims if claim.verdict is Verdict.CANNOT_RUN)
    return [f"{len(r.claims)} claims cannot be run here. {r.text}" for r in missing]


def sentence(text: str) -> str:
    """With a capital and a full stop; a symbol in front stays as it is."""
    first = text.split(" ", 1)[0]
    begun = text[0].upper() + text[1:] if first.isalpha() and (len(first) > 1 or first == "a") else text
    return begun if begun.endswith((".", "?", "!")) else f"{begun}."


def shift(moved: Drift) -> tuple[str, str]:
    """Before and after, in words."""
    return _state(moved.before, "new claim"), _state(moved.after, "no such claim any more")


def _state(claim: Claim | None, absent: str) -> str:
    if claim is None:
        return absent
    return f"{number(claim.ours, 10) if claim.ours is not None else '–'} ({claim.verdict})"
