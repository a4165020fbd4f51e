"""A verdict follows from the numbers and from nothing else."""

from __future__ import annotations

import doctest
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import validation.claims
from validation.claims import (
    AtLeast,
    AtMost,
    Claim,
    Interval,
    Tolerance,
    Verdict,
    absolute,
    printed,
    relative,
    sampling,
)

numbers = st.floats(-1e6, 1e6)


def claim(reported: Any, ours: float | None, tolerance: Tolerance, error: float = 0.0, **rest: Any) -> Claim:
    return Claim("paper", "paper-item", "name", reported, ours, tolerance, error, **rest)


@pytest.mark.parametrize(
    ("ours", "verdict"),
    [
        (0.04774, Verdict.REPRODUCED),
        (0.0491, Verdict.SAMPLING),
        (0.0463, Verdict.SAMPLING),
        (0.0508, Verdict.DIFFERS),
        (-0.0477, Verdict.DIFFERS),
        (math.nan, Verdict.DIFFERS),
        (math.inf, Verdict.DIFFERS),
    ],
)
def test_printed_digits_come_before_sampling(ours: float, verdict: Verdict) -> None:
    assert claim(0.0477, ours, printed(4) + sampling(2), 1e-3).verdict is verdict


@given(numbers, numbers)
def test_without_tolerance_only_the_number_itself_is_reproduced(reported: float, ours: float) -> None:
    expected = Verdict.REPRODUCED if reported == ours else Verdict.DIFFERS
    assert claim(reported, ours, Tolerance()).verdict is expected


@given(numbers, numbers, st.floats(0.0, 1e3), st.floats(0.0, 1e3))
def test_more_tolerance_never_takes_an_agreement_back(
    reported: float, ours: float, a: float, b: float
) -> None:
    if claim(reported, ours, absolute(a)).agrees:
        assert claim(reported, ours, absolute(a) + absolute(b)).agrees


def test_tolerances_add_up() -> None:
    assert printed(2) + sampling(2) + relative(0.1) + absolute(0.5) == Tolerance(0.505, 0.1, 2.0)


@pytest.mark.parametrize("width", [-1.0, math.inf, math.nan])
def test_a_tolerance_is_finite_and_not_negative(width: float) -> None:
    with pytest.raises(ValueError, match="finite and not negative"):
        absolute(width)


def test_a_statement_holds_on_its_side_of_the_bound() -> None:
    assert claim(AtMost(1.0), 0.9, Tolerance()).verdict is Verdict.REPRODUCED
    assert claim(AtMost(1.0), 1.01, Tolerance()).verdict is Verdict.DIFFERS
    assert claim(AtMost(1.0), 1.01, sampling(2), 0.01).verdict is Verdict.SAMPLING
    assert claim(AtLeast(1e3, "diverges"), math.inf, Tolerance()).verdict is Verdict.REPRODUCED
    assert claim(AtLeast(1e3, "diverges"), 10.0, Tolerance()).verdict is Verdict.DIFFERS
    assert claim(Interval(1.0, 2.0), math.nan, Tolerance()).verdict is Verdict.DIFFERS


def test_infinite_numbers_agree_with_their_like_only() -> None:
    assert claim(math.inf, math.inf, Tolerance()).agrees
    assert not claim(math.inf, 1e300, relative(0.5)).agrees
    assert not claim(1.0, math.inf, relative(0.5)).agrees


def test_a_difference_is_explained_only_while_ours_is_what_the_explanation_predicts() -> None:
    reason = {"because": "another metric", "expected": 0.276}
    assert claim(0.0477, 0.2765, absolute(1e-3), **reason).verdict is Verdict.EXPLAINED
    assert claim(0.0477, 0.3, absolute(1e-3), **reason).verdict is Verdict.DIFFERS
    assert claim(0.0477, 0.0475, absolute(1e-3), **reason).verdict is Verdict.REPRODUCED


@pytest.mark.parametrize("rest", [{"because": "it differs"}, {"expected": 1.0}])
def test_a_reason_without_a_prediction_and_a_prediction_without_a_reason_are_refused(rest: Any) -> None:
    with pytest.raises(ValueError, match="go together"):
        claim(0.0, 1.0, Tolerance(), **rest)


def test_what_cannot_be_run_says_because_of_what() -> None:
    with pytest.raises(ValueError, match="because of what"):
        claim(1.0, None, Tolerance())
    assert claim(1.0, None, Tolerance(), because="no data").verdict is Verdict.CANNOT_RUN


def test_sampling_needs_a_standard_error() -> None:
    with pytest.raises(ValueError, match="standard_error"):
        claim(1.0, 1.0, sampling(2))


def test_only_unexplained_differences_and_claims_that_nobody_ran_fail() -> None:
    assert {verdict for verdict in Verdict if verdict.fails} == {Verdict.DIFFERS, Verdict.NOT_RUN}
    assert claim(1.0, None, Tolerance(), because="crashed", ran=False).verdict is Verdict.NOT_RUN


def test_the_example_of_a_claim_is_right() -> None:
    assert doctest.testmod(validation.claims).failed == 0
