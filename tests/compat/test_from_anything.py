"""from_filterpy says what is missing of what is no filter; a filter that was taken over goes its own way."""

import numpy as np
import pytest
from filterpy.hinfinity import HInfinityFilter
from filterpy.kalman import FixedLagSmoother, KalmanFilter

from ufirext import DelayHInfinityFilter, DelayKalmanFilter, FMSFilterSmoother, UfirextError, UFIRFilter

TAKES_OVER = {
    "ufir": UFIRFilter.from_filterpy,
    "fms": lambda kf: FMSFilterSmoother.from_filterpy(kf, horizon=8),
    "kalman": DelayKalmanFilter.from_filterpy,
}


@pytest.mark.parametrize("take_over", TAKES_OVER.values(), ids=TAKES_OVER)
@pytest.mark.parametrize(
    ("given", "lacking"),
    [
        (3, "dim_x, dim_z, F, H, Q, R, B, P, x, M, alpha, inv"),
        (None, "dim_x, dim_z, F, H"),
        (np.eye(2), "dim_x, dim_z, F, H"),
        (FixedLagSmoother(2, 1), "M, alpha, inv"),
        (KalmanFilter, "dim_x, dim_z, F, H"),
    ],
    ids=["number", "none", "array", "smoother", "class"],
)
def test_what_is_no_kalman_filter_is_told_what_it_lacks(take_over, given, lacking):
    message = rf"kf must be a filterpy\.kalman\.KalmanFilter, .*, got a .* without .*{lacking}.*; give"
    for kind in (TypeError, UfirextError):
        with pytest.raises(kind, match=message):
            take_over(given)


@pytest.mark.parametrize("given", [3, None, KalmanFilter(2, 1), HInfinityFilter])
def test_what_is_no_h_infinity_filter_is_told_what_it_lacks(given):
    message = r"hinf must be a filterpy\.hinfinity\.HInfinityFilter, .*, got a .* without .*gamma"
    with pytest.raises(TypeError, match=message):
        DelayHInfinityFilter.from_filterpy(given)


@pytest.mark.filterwarnings("ignore:This code is likely incorrect:DeprecationWarning")
def test_an_h_infinity_filter_keeps_its_arrays_to_itself():
    theirs = HInfinityFilter(2, 1, 0, gamma=0.0)
    theirs.F, theirs.H = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    theirs.W, theirs.V = np.eye(2), np.eye(1)
    ours = DelayHInfinityFilter.from_filterpy(theirs)
    theirs.F[0, 1] = theirs.Q[0, 0] = theirs.P[0, 0] = theirs.x[0] = 5.0
    np.testing.assert_array_equal(ours.F, [[1.0, 1.0], [0.0, 1.0]])
    for name, value in (("weight", np.eye(2)), ("P", np.eye(2)), ("x", np.zeros((2, 1)))):
        np.testing.assert_array_equal(getattr(ours, name), value)
