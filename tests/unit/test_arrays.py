"""What may enter the library, and what it says about the rest."""

from __future__ import annotations

import datetime
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.strategies import positive
from ufirext import (
    CovarianceError,
    HorizonError,
    Model,
    NonFiniteError,
    ShapeError,
    UfirextError,
    UFIRFilter,
    filter_series,
)
from ufirext._arrays import (
    check_covariance,
    column,
    covariance,
    finite,
    integer,
    matrix,
    number,
    one_of,
    readings,
    readonly,
    real,
    square,
    symmetric,
)


@pytest.mark.parametrize(
    "value", [1, 2.5, np.float32(2.5), np.array(2.5), np.array(3, dtype=object), Decimal(3), np.True_]
)
def test_number_is_one_number(value):
    assert type(number(value, "q")) is float
    assert number(value, "q") == value


@pytest.mark.parametrize(
    "value", ["1", b"1", None, [1.0], np.ones((1, 1)), 1j, np.timedelta64(1, "ns"), np.ma.masked]
)
def test_number_refuses_everything_else(value):
    with pytest.raises(ShapeError, match="q must be a number, got"):
        number(value, "q")


@pytest.mark.parametrize("value", [1, [1, 2], [[1], [2]], np.array([True]), np.float32(2.5), [[]]])
def test_real_makes_a_fresh_float64_array(value):
    array = real(value, "A")
    assert array.dtype == np.float64
    np.testing.assert_array_equal(array, np.asarray(value, dtype=float))


def test_objects_that_are_numbers_and_none_stay_what_they_were():
    mixed = [None, 1, 2.5, Fraction(1, 2), Decimal(3)]
    np.testing.assert_array_equal(real(mixed, "A"), [np.nan, 1, 2.5, 0.5, 3])
    np.testing.assert_array_equal(real(np.array([[1, 2.5]], dtype=object), "A"), [[1.0, 2.5]])
    np.testing.assert_array_equal(real([[True, np.int8(3)]], "A"), [[1.0, 3.0]])


@pytest.mark.parametrize(
    "value",
    [10**400, -(10**5000), [1.0, 10**5000], Decimal("1e400"), Fraction(10**400), np.longdouble("1e400")],
    ids=["large", "larger", "in a list", "decimal", "fraction", "long double"],
)
def test_numbers_beyond_float64_are_refused(value):
    with pytest.raises(NonFiniteError, match=r"A must be (numbers below|finite)"):
        finite(real(value, "A"), "A")


def test_a_word_is_one_of_those_allowed():
    one_of("skip", ("extend", "skip"), "missing")
    for wrong in ("drop", None, ["skip"], np.array(["skip", "extend"]), np.array("skip")):
        with pytest.raises(UfirextError, match="missing must be one of 'extend', 'skip', got"):
            one_of(wrong, ("extend", "skip"), "missing")


def test_real_never_shares_memory_with_the_caller():
    mine = np.zeros(3)
    assert not np.shares_memory(real(mine, "A"), mine)


NO_NUMBERS = [
    "4",
    b"4",
    ["1", "2"],
    [1.0, "2"],
    [None, "2"],
    np.array([1.0, b"2"], dtype=object),
    np.str_("4"),
    np.datetime64("NaT"),
    np.datetime64("2026-01-01", "ns"),
    np.timedelta64(4, "ns"),
    np.array(["2026-01-01"], dtype="datetime64[ns]"),
    np.array([4], dtype="timedelta64[s]"),
    [1.0, np.datetime64("NaT")],
    [None, np.timedelta64(4, "ns")],
    [1, np.timedelta64(4, "ns")],
    datetime.timedelta(seconds=4),
    [1.0, np.complex128(2.0), None],
]


@pytest.mark.parametrize("value", [1j, [1 + 0j], "text", [[1], [2, 3]], {"a": 1}, [object()], *NO_NUMBERS])
def test_real_refuses_what_is_no_array_of_real_numbers(value):
    with pytest.raises(ShapeError, match="A must be an array of real numbers, got"):
        real(value, "A")


MASKED = [
    (np.ma.array([1.0, 9.9], mask=[False, True]), [1.0, np.nan]),
    (np.ma.array([1, 9], mask=[False, True]), [1.0, np.nan]),
    (np.ma.array([1.5, 9.9], mask=[False, True], dtype=np.float32), [1.5, np.nan]),
    (np.ma.array([1, None], mask=[True, False], dtype=object), [np.nan, np.nan]),
    ([1.0, np.ma.masked], [1.0, np.nan]),
    ([[1.0, np.ma.masked], (2.0, 3.0)], [[1.0, np.nan], [2.0, 3.0]]),
    ([np.ma.array([1.0, 2.0], mask=[True, False]), [3, 4]], [[np.nan, 2.0], [3.0, 4.0]]),
    (np.ma.masked, np.nan),
]


@pytest.mark.parametrize(("value", "expected"), MASKED)
def test_a_masked_entry_is_missing_among_measurements_and_refused_elsewhere(value, expected):
    np.testing.assert_array_equal(readings(value, "z"), expected)
    assert type(readings(value, "z")) is np.ndarray
    with pytest.raises(NonFiniteError, match="A must have no masked entries, whose numbers mean nothing"):
        real(value, "A")


def test_a_masked_array_without_masked_entries_is_its_data():
    mine = np.ma.array([[1.0, 2.0]], mask=False)
    for array in (real(mine, "A"), readings(mine, "A"), real([mine[0]], "A")):
        np.testing.assert_array_equal(array, [[1.0, 2.0]])
        assert type(array) is np.ndarray
        assert not np.shares_memory(array, mine)


def test_finite_says_where_it_is_not():
    with pytest.raises(NonFiniteError, match=r"A must be finite, got NaN or inf at \(0, 1\), \(1, 0\)"):
        finite(np.array([[0, np.nan], [np.inf, 1]]), "A")
    array = np.ones(2)
    assert finite(array, "A") is array


@pytest.mark.parametrize("large", [[1e200, 1e200], [-1e308, 1e308], [1e308, 1e308]])
def test_large_numbers_are_finite(large):
    array = np.array(large)
    assert finite(array, "A") is array


@pytest.mark.parametrize("bad", [[np.inf, -np.inf], [np.inf, 1.0], [np.nan, np.inf], [-np.inf, -np.inf]])
def test_infinities_are_refused_without_a_warning(bad):
    with pytest.raises(NonFiniteError, match="A must be finite"):
        finite(np.array(bad), "A")


def test_matrix_takes_the_shape_it_is_asked_for():
    assert matrix([[1, 2], [3, 4]], (2, None), "A").shape == (2, 2)
    assert matrix(3, (1, 1), "A").tolist() == [[3.0]]
    with pytest.raises(ShapeError, match=r"H must have shape \(2, 4\) \(dim_z, dim_x\), got \(2, 3\)"):
        matrix(np.ones((2, 3)), (2, 4), "H", "(dim_z, dim_x)")
    with pytest.raises(ShapeError, match=r"H must have shape \(any, 4\), got \(4,\)"):
        matrix(np.ones(4), (None, 4), "H")
    with pytest.raises(ShapeError, match=r"F must have shape \(2, 2\), got \(\)"):
        matrix(1.0, (2, 2), "F")


def test_a_scalar_square_is_a_multiple_of_the_identity():
    np.testing.assert_array_equal(square(2.0, 3, "Q"), 2.0 * np.eye(3))
    with pytest.raises(NonFiniteError):
        square(np.inf, 2, "Q")


@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.integers(0, 6), st.floats(-8, 8))
def test_every_covariance_of_any_rank_and_scale_passes(seed, size, rank, exponent):
    rng = np.random.default_rng(seed)
    units = 10.0 ** rng.uniform(-exponent, exponent, size) if exponent > 0 else np.ones(size)
    P = positive(rng, size, rank=min(rank, size)) * np.outer(units, units)
    np.testing.assert_array_equal(covariance(P, size, "P"), P)


@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.floats(-12, 12))
def test_a_negative_direction_never_passes(seed, size, exponent):
    rng = np.random.default_rng(seed)
    basis = np.linalg.qr(rng.normal(size=(size, size)))[0]
    values = rng.uniform(0.5, 2.0, size)
    values[0] = -0.01
    with pytest.raises(CovarianceError, match="P must be positive semidefinite"):
        check_covariance(10.0**exponent * symmetric(basis * values @ basis.T), "P")


def test_a_lopsided_matrix_is_no_covariance():
    with pytest.raises(CovarianceError, match=r"R must be symmetric, got a difference of 0\.5 to its"):
        covariance([[1.0, 0.5], [0.0, 1.0]], 2, "R")


DOORS = {
    "covariance": lambda P: covariance(P, len(P), "P"),
    "check": lambda P: check_covariance(np.array(P, dtype=float), "P"),
    "filter": lambda P: setattr(UFIRFilter(len(P), len(P), horizon=9), "P", P),
    "quick look": lambda P: setattr(UFIRFilter(len(P), len(P), horizon=9), "R", P),
    "series": lambda P: filter_series(Model(np.eye(len(P)), np.eye(len(P))), [P[0]] * 9, 4, Rs=[P] * 9),
}


@pytest.mark.parametrize("door", DOORS.values(), ids=DOORS)
@pytest.mark.parametrize("size", [2, 5])
@pytest.mark.parametrize("other", [1e10, 1e20, 1e300])
def test_no_other_entry_is_so_large_that_a_bad_one_passes(door, size, other):
    """Sums, scales and factors drown or overflow in the largest entry: wherever it stands."""
    for i, j in ((0, size - 1), (size - 1, 0)):
        negative, lopsided, indefinite, steep = (np.eye(size) for _ in range(4))
        negative[i, i], negative[j, j] = -1.0, other
        lopsided[j, j], lopsided[i, j], lopsided[j, i] = other, 0.9 * other**0.5, -0.9 * other**0.5
        indefinite[i, i], indefinite[j, j] = 1.0 / other, other
        indefinite[i, j] = indefinite[j, i] = 2.0
        steep[i, i] = 1.0 / other
        steep[i, j] = steep[j, i] = other
        for wrong, message in (
            (negative, "positive semidefinite, got the variance -1"),
            (lopsided, "symmetric"),
            (indefinite, "positive semidefinite"),
            (steep, "positive semidefinite"),
        ):
            with pytest.raises(CovarianceError, match=message):
                door(wrong)


def test_what_rounding_leaves_is_a_covariance_still():
    """P - K S K' of a perfect measurement: a variance of -1e-16 where there is none."""
    P = np.array([[0.7, 0.3, 0.1], [0.3, 0.8, 0.2], [0.1, 0.2, 0.9]])
    P -= np.outer(P[0], P[0]) / P[0, 0]
    P[0, 0], P[0, 1] = -1e-16, 1e-17
    check_covariance(P, "P")


@pytest.mark.parametrize("value", [[1, 2], [[1, 2]], [[1], [2]], np.array([1.0, 2.0])])
def test_a_column_comes_in_any_of_the_usual_forms(value):
    np.testing.assert_array_equal(column(value, 2, "z"), [1.0, 2.0])


@pytest.mark.parametrize("value", [[1], [1, 2, 3], [[1, 2], [3, 4]], np.ones((2, 2))])
def test_a_column_of_another_size_is_refused(value):
    with pytest.raises(ShapeError, match="z must hold 2 numbers, got shape"):
        column(value, 2, "z")


@pytest.mark.parametrize("value", [5, np.int64(5), np.uint8(5)])
def test_integers_of_any_make_are_integers(value):
    number = integer(value, "horizon", 1)
    assert type(number) is int
    assert number == 5


@pytest.mark.parametrize("value", [5.0, "5", None, True, np.True_, [5], np.array([5, 6])])
def test_what_is_no_integer_is_refused_with_advice(value):
    with pytest.raises(HorizonError, match=r"horizon must be an integer, got .*; take 3"):
        integer(value, "horizon", 1, advice="take 3")


@pytest.mark.parametrize(("value", "wanted"), [(0, "at least 1"), (-3, "at least 1")])
def test_an_integer_below_its_range_is_refused(value, wanted):
    with pytest.raises(HorizonError, match=f"lag must be {wanted}, got {value}"):
        integer(value, "lag", 1)


def test_an_integer_above_its_range_is_refused():
    with pytest.raises(HorizonError, match="lag must be between 0 and 4, got 5"):
        integer(5, "lag", 0, 4)


def test_readonly_arrays_cannot_be_written():
    array = readonly(np.zeros(2))
    with pytest.raises(ValueError, match="read-only"):
        array[0] = 1.0


@pytest.mark.parametrize("error", [ShapeError, NonFiniteError, CovarianceError, HorizonError])
def test_every_refusal_is_a_value_error_of_the_library(error):
    assert issubclass(error, UfirextError)
    assert issubclass(error, ValueError)
