"""A size that is none is an error of shape, and says what it would have counted."""

import pytest

from ufirext import (
    DelayHInfinityFilter,
    DelayKalmanFilter,
    FMSFilterSmoother,
    ShapeError,
    UFIRFilter,
    kinematic,
)

FILTERS = {
    "ufir": UFIRFilter,
    "fms": lambda *dims: FMSFilterSmoother(*dims, horizon=8),
    "kalman": DelayKalmanFilter,
    "h-infinity": DelayHInfinityFilter,
}
COUNTED = {"dim_x": "states", "dim_z": "measured components", "dim_u": "inputs"}
NO_SIZES = [-1, 2.0, "2", None, True, [2]]


@pytest.mark.parametrize("place", range(3))
@pytest.mark.parametrize("make", FILTERS.values(), ids=FILTERS)
def test_of_a_filter(make, place):
    name = list(COUNTED)[place]
    for wrong in NO_SIZES if name == "dim_u" else [0, *NO_SIZES]:
        sizes = [2, 1, 1]
        sizes[place] = wrong
        message = f"{name} must be .*, got .*; it is the number of {COUNTED[name]}"
        with pytest.raises(ShapeError, match=message):
            make(*sizes)


@pytest.mark.parametrize("wrong", [0, *NO_SIZES])
def test_of_a_kinematic_model(wrong):
    with pytest.raises(ShapeError, match=r"dim must be .*; it is the number of axes"):
        kinematic(1, wrong, 1.0)


@pytest.mark.parametrize("wrong", [3, *NO_SIZES])
def test_an_order_without_a_model(wrong):
    with pytest.raises(ShapeError, match=r"order must be .*; it is the highest derivative among the states"):
        kinematic(wrong, 1, 1.0)


@pytest.mark.parametrize("wrong", [2, *NO_SIZES])
def test_a_component_that_z_does_not_have(wrong):
    with pytest.raises(ShapeError, match=r"start must be .*; it is a component of z"):
        DelayKalmanFilter(4, 2).update_sequential(wrong, [1.0])
