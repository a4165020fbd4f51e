"""A lag is a state of the window; what is none is told how many states there are, at every door."""

import numpy as np
import pytest

from ufirext import (
    FMSFilterSmoother,
    HorizonError,
    UFIRFilter,
    filter_series,
    fms_gain,
    kinematic,
    minimum_variance_gain,
    ofir,
    series_plan,
    ufir_gain,
)
from ufirext.distributed.part import chunk_length

RAMP = kinematic(1, 1, 1.0)


def filled(f):
    f.F, f.H = RAMP.F, RAMP.H
    for k in range(12):
        f.predict()
        f.update(float(k))
    return f


DOORS = {
    "ufir_gain": lambda horizon, lag: ufir_gain(RAMP, horizon, lag),
    "minimum_variance_gain": lambda horizon, lag: minimum_variance_gain(RAMP, horizon, lag),
    "ofir": lambda horizon, lag: ofir(RAMP, horizon, 1.0, lag=lag),
    "series_plan": lambda horizon, lag: series_plan(RAMP, horizon, lag),
    "filter_series": lambda horizon, lag: filter_series(RAMP, np.zeros(20), horizon, lag=lag),
    "chunk_length": lambda horizon, lag: chunk_length(RAMP, horizon, lag=lag),
    "UFIRFilter.smoothed": lambda horizon, lag: filled(UFIRFilter(2, 1, horizon=horizon)).smoothed(lag),
    "FMSFilterSmoother": lambda horizon, lag: FMSFilterSmoother(2, 1, horizon=horizon, lag=lag),
    "FMSFilterSmoother.smoothed": lambda horizon, lag: filled(
        FMSFilterSmoother(2, 1, horizon=horizon)
    ).smoothed(lag),
}


@pytest.mark.parametrize("door", DOORS.values(), ids=DOORS)
@pytest.mark.parametrize("horizon", [5, 9])
def test_outside_the_window(door, horizon):
    door(horizon, horizon - 1)
    for lag in (-1, horizon, 2.0, None):
        held = f"the window holds {horizon} states, up to the newest one"
        with pytest.raises(HorizonError, match=f"lag must be .*, got {lag}; {held}"):
            door(horizon, lag)


def test_a_window_of_one_step_holds_one_state():
    with pytest.raises(HorizonError, match="got 1; the window holds 1 state, up to the newest one"):
        ufir_gain(kinematic(0, 1, 1.0), 1, 1)


def test_in_the_letters_of_the_paper():
    with pytest.raises(HorizonError, match=r"got 7; the window \[i-6, i\) holds no state older than x_{i-6}"):
        fms_gain(RAMP.F, RAMP.H, RAMP.Q, RAMP.R, M=6, d=7)
