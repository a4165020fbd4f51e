"""Claims as data: what a source reports, what comes out here, and the verdict that follows from both."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

__all__ = [
    "AtLeast",
    "AtMost",
    "Claim",
    "Interval",
    "Reported",
    "Tolerance",
    "Verdict",
    "absolute",
    "printed",
    "relative",
    "sampling",
]


class Verdict(StrEnum):
    """What can be said of a claim."""

    REPRODUCED = "reproduced"
    SAMPLING = "within sampling"
    EXPLAINED = "differs, explained"
    DIFFERS = "differs"
    CANNOT_RUN = "cannot be run"
    NOT_RUN = "not run"

    @property
    def fails(self) -> bool:
        """Whether the suite fails by it: an unexplained difference, or a claim that nobody ran."""
        return self in (Verdict.DIFFERS, Verdict.NOT_RUN)


@dataclass(frozen=True)
class Tolerance:
    """How far two numbers may be apart. Tolerances add up: ``printed(4) + sampling(2)``.

    Attributes
    ----------
    absolute : float
        In the units of the claim.
    relative : float
        Fraction of the reported number.
    sigmas : float
        Multiple of the claim's standard error.
    """

    absolute: float = 0.0
    relative: float = 0.0
    sigmas: float = 0.0

    def __post_init__(self) -> None:
        for name in ("absolute", "relative", "sigmas"):
            value = getattr(self, name)
            if not (value >= 0.0 and math.isfinite(value)):
                raise ValueError(f"{name} must be finite and not negative, got {value!r}")

    def __add__(self, other: Tolerance) -> Tolerance:
        return Tolerance(
            self.absolute + other.absolute, self.relative + other.relative, self.sigmas + other.sigmas
        )

    def exact(self, reported: float) -> float:
        """The part that is not due to chance."""
        return self.absolute + (self.relative * abs(reported) if math.isfinite(reported) else 0.0)


def printed(decimals: int) -> Tolerance:
    """Half a unit of the last of the printed decimals."""
    return Tolerance(absolute=0.5 * 10.0**-decimals)


def sampling(sigmas: float) -> Tolerance:
    """So many standard errors of the claim."""
    return Tolerance(sigmas=sigmas)


def absolute(width: float) -> Tolerance:
    """A width in the units of the claim, to be argued where it is used."""
    return Tolerance(absolute=width)


def relative(fraction: float) -> Tolerance:
    """A fraction of the reported number, to be argued where it is used."""
    return Tolerance(relative=fraction)


@dataclass(frozen=True)
class Interval:
    """A statement that a number lies in [low, high]; `words` say it as the source does."""

    low: float
    high: float
    words: str = ""

    def distance(self, value: float) -> float:
        """How far `value` is outside, 0 inside; infinite for NaN."""
        if math.isnan(value):
            return math.inf
        return max(self.low - value, value - self.high, 0.0)

    def __str__(self) -> str:
        if self.words:
            return self.words
        if math.isinf(self.low):
            return f"≤ {self.high:.4g}"
        return f"≥ {self.low:.4g}" if math.isinf(self.high) else f"{self.low:.4g} to {self.high:.4g}"


def AtMost(bound: float, words: str = "") -> Interval:
    """The statement that a number is at most `bound`: "better than", for a ratio and 1."""
    return Interval(-math.inf, bound, words)


def AtLeast(bound: float, words: str = "") -> Interval:
    """The statement that a number is at least `bound`: "diverges", for an error and a large one."""
    return Interval(bound, math.inf, words)


Reported = float | Interval
"""A printed number, or a statement about one."""


@dataclass(frozen=True)
class Claim:
    """One statement of a source, held against one number of ours.

    Attributes
    ----------
    paper, item, name : str
        `Paper.key`, `Item.id`, and the claim's own name, unique in its item.
    reported : float or Interval
        The printed number, or a statement: ``AtMost(1.0, "UFIR is better")``, ``AtLeast(1e3, "diverges")``.
    ours : float or None
        None where it cannot be computed; `because` says why.
    tolerance : Tolerance
        ``printed(4) + sampling(2)``: nothing else is allowed for a difference.
    standard_error : float
        Of ours against reported by chance, with that of the source where its size is known.
    because : str
        Why ours differs from what is reported.
    expected : float or Interval or None
        What the explanation predicts for ours. A difference is explained only while ours agrees with it
        within the tolerance, so that an explanation does not hide the next mistake.
    unit : str
    ran : bool
        False for a claim that its item promised and did not return.

    Examples
    --------
    >>> from validation.claims import Claim, printed, sampling
    >>> Claim("s3", "s3-table-2", "step, smoother", 0.0062, 0.00613, printed(4) + sampling(2), 2e-4).verdict
    <Verdict.SAMPLING: 'within sampling'>
    """

    paper: str
    item: str
    name: str
    reported: Reported
    ours: float | None
    tolerance: Tolerance
    standard_error: float = 0.0
    because: str = ""
    expected: Reported | None = None
    unit: str = ""
    ran: bool = True

    def __post_init__(self) -> None:
        if not (self.standard_error >= 0.0 and math.isfinite(self.standard_error)):
            raise ValueError(f"{self.key}: standard_error must be finite, >= 0, got {self.standard_error!r}")
        if self.tolerance.sigmas and not self.standard_error and self.ours is not None:
            raise ValueError(f"{self.key}: sampling() needs a standard_error, got 0")
        if self.ours is None and not self.because:
            raise ValueError(f"{self.key}: a claim that cannot be run must say because of what")
        if (self.expected is None) != (not self.because) and self.ours is not None:
            raise ValueError(f"{self.key}: because and expected go together, got only one of them")

    @property
    def key(self) -> str:
        """Unique in the suite."""
        return f"{self.item}: {self.name}"

    @property
    def verdict(self) -> Verdict:
        """What follows from the numbers; nobody chooses it."""
        if not self.ran:
            return Verdict.NOT_RUN
        if self.ours is None:
            return Verdict.CANNOT_RUN
        if _agrees(self.ours, self.reported, self.tolerance.exact(_scale(self.reported))):
            return Verdict.REPRODUCED
        if _agrees(self.ours, self.reported, self._allowed(self.reported)):
            return Verdict.SAMPLING
        if self.expected is not None and _agrees(self.ours, self.expected, self._allowed(self.expected)):
            return Verdict.EXPLAINED
        return Verdict.DIFFERS

    @property
    def agrees(self) -> bool:
        """Whether ours is what is reported, up to the tolerance."""
        return self.verdict in (Verdict.REPRODUCED, Verdict.SAMPLING)

    @property
    def scale(self) -> float:
        """What counts as large for ours: the bound of a statement, the exact part of the tolerance else."""
        if isinstance(self.reported, Interval):
            return _scale(self.reported)
        return self.tolerance.exact(self.reported)

    def _allowed(self, reported: Reported) -> float:
        return self.tolerance.exact(_scale(reported)) + self.tolerance.sigmas * self.standard_error


def _scale(reported: Reported) -> float:
    if isinstance(reported, Interval):
        return max((abs(end) for end in (reported.low, reported.high) if math.isfinite(end)), default=0.0)
    return reported


def _agrees(ours: float, reported: Reported, allowed: float) -> bool:
    """Whether ours is what is reported up to `allowed`; an infinite number agrees with its like only."""
    if isinstance(reported, Interval):
        return reported.distance(ours) <= allowed
    return ours == reported or abs(ours - reported) <= allowed
