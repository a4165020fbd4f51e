"""Does a filter keep what it says? Chi-square tests, worst disturbances and guarantees."""

from __future__ import annotations

from .chi_square import Consistency, consistency, nees, nis
from .guarantee import Guarantee
from .worst_case import WorstCase, worst_case_gain

__all__ = ["Consistency", "Guarantee", "WorstCase", "consistency", "nees", "nis", "worst_case_gain"]
