"""A quick look at a matrix passes nothing that the closer look refuses, and knows what is plainly right."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.strategies import seeds
from ufirext.filters._checks import Check, Covariance, General, Square

NUMBERS = st.one_of(
    st.sampled_from([0.0, -0.0, 1.0, -1.0, 1e-320, 1e300, np.nan, np.inf, -np.inf]), st.floats(-3.0, 3.0)
)


def matrices(rows: int, columns: int) -> st.SearchStrategy[np.ndarray]:
    return arrays(float, (rows, columns), elements=NUMBERS)


def agrees(check: Check, value: np.ndarray) -> None:
    raw = check.quick(value)
    if raw is not None:
        np.testing.assert_array_equal(check(value), value)
        assert raw == value.tobytes()


@given(value=matrices(2, 3))
def test_general(value):
    agrees(General((2, 3), "H", "(dim_z, dim_x)"), value)


@given(value=matrices(3, 3))
def test_square(value):
    agrees(Square(3, "F"), value)


@pytest.mark.parametrize("size", [1, 2, 3, 6])
@given(data=st.data())
def test_covariance(size, data):
    value = data.draw(matrices(size, size))
    kind = data.draw(st.sampled_from(["any", "symmetric", "diagonal"]))
    if kind == "symmetric":
        value = np.triu(value) + np.triu(value, 1).T
    elif kind == "diagonal":
        value = np.where(np.eye(size, dtype=bool), value, 0.0)
    agrees(Covariance(size, "Q"), value)


@given(seed=seeds, size=st.integers(1, 7), rank=st.integers(1, 7))
def test_covariances_of_few_sources_and_variances_of_zero_are_plainly_right(seed, size, rank):
    rng = np.random.default_rng(seed)
    sources = rng.normal(size=(size, min(rank, size)))
    check = Covariance(size, "Q")
    product = sources @ sources.T
    assert check.quick(0.5 * (product + product.T)) is not None
    if check.few:
        assert check.quick(np.diag(rng.uniform(0.0, 2.0, size) * (rng.random(size) < 0.5))) is not None


@pytest.mark.parametrize(
    "value",
    [[[1.0, 0.0], [0.0, 1.0]], np.eye(2, dtype=int), np.eye(2, dtype=">f8"), np.eye(3), np.eye(2)[0], 1.0],
)
def test_what_is_no_plain_array_of_the_shape_gets_the_closer_look(value):
    assert Square(2, "F").quick(value) is None


def test_the_order_of_memory_does_not_matter():
    value = np.asfortranarray([[1.0, 2.0], [3.0, 4.0]])
    assert Square(2, "F").quick(value) == np.array([[1.0, 2.0], [3.0, 4.0]]).tobytes()
