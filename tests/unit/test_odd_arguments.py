"""Whatever is given where something else belongs, the error is the library's own."""

import numpy as np
import pytest

from ufirext import (
    DelayHInfinityFilter,
    DelayKalmanFilter,
    Fleet,
    FMSFilterSmoother,
    Model,
    ShapeError,
    UfirextError,
    UFIRFilter,
    augmented_model,
    best_horizon,
    certify,
    filter_series,
    kinematic,
    minimum_variance_gain,
    ofir,
    series_plan,
    ufir_gain,
    worst_case_gain,
)
from ufirext.diagnostics import consistency

RAMP = kinematic(1, 1, 1.0)
ODD = [
    None, 3, -1, 2.5, np.nan, np.inf, 1j, "a", b"a", True, [], {}, {1}, (1, 2), range(3), object(), abs,
    KeyError, [[1], [1, 2]], [[[1], [1, 2]]], np.array(3), np.array("a"), np.array([None, 1]),
    np.zeros((0, 0)), np.zeros((2, 2, 2)), -np.eye(2), np.array([[1j, 0.0], [0.0, 1.0]]),
    np.datetime64("2026"), RAMP,
]  # fmt: skip
GAIN = np.array([[0.5], [0.1]])


def filled(kind):
    f = kind(2, 1, **({"horizon": 8} if kind in (UFIRFilter, FMSFilterSmoother) else {}))
    f.F, f.H = RAMP.F, RAMP.H
    for n in range(20):
        f.predict()
        f.update(float(n))
    return f


def worst(**given):
    told = {"K": [GAIN] * 3, "F": RAMP.F, "H": RAMP.H, "Q": RAMP.Q, "R": 1.0, "P0": np.eye(2)}
    return worst_case_gain(**{**told, **given})


FUNCTIONS = {
    "a model for ufir_gain": lambda odd: ufir_gain(odd, 5),
    "a model for minimum_variance_gain": lambda odd: minimum_variance_gain(odd, 5),
    "a model for ofir": lambda odd: ofir(odd, 5, 1.0),
    "a model for best_horizon": lambda odd: best_horizon(odd),
    "a model for filter_series": lambda odd: filter_series(odd, np.zeros(9), 5),
    "a model for series_plan": lambda odd: series_plan(odd, 5),
    "a model for augmented_model": lambda odd: augmented_model(odd, 2),
    "a model for a fleet": lambda odd: Fleet(odd, 5),
    "a model for certify": lambda odd: certify(ufir_gain(RAMP, 5), odd),
    "rho": lambda odd: ofir(RAMP, 5, 1.0, rho=odd),
    "noise": lambda odd: filter_series(RAMP, np.zeros(9), 5, noise=odd),
    "Fs": lambda odd: filter_series(RAMP, np.zeros(9), 5, Fs=odd),
    "delays": lambda odd: filter_series(RAMP, np.zeros(9), 5, delays=odd),
    "ages of a fleet": lambda odd: Fleet(RAMP, 5, 2).step(np.zeros(2), odd),
    "slots": lambda odd: Fleet(RAMP, 5, 2).leave(odd),
    "dof": lambda odd: consistency([1.0, 2.0], odd),
    "level": lambda odd: consistency([1.0, 2.0], 1, odd),
    "H-infinity's theta": lambda odd: DelayHInfinityFilter(2, 1, theta=None if callable(odd) else odd),
    **{f"worst case, {name}": lambda odd, name=name: worst(**{name: odd})
       for name in ("K", "F", "H", "Q", "R", "P0", "S", "theta", "form")},
}  # fmt: skip
VERBS = {
    "measurement_of_state": lambda f, odd: f.measurement_of_state(odd),
    "batch_filter": lambda f, odd: f.batch_filter(odd),
    "batch_filter, Fs": lambda f, odd: f.batch_filter([1.0, 2.0], Fs=odd),
    "batch_filter, us": lambda f, odd: f.batch_filter([1.0, 2.0], us=odd),
    "rts_smoother": lambda f, odd: f.rts_smoother(odd, np.zeros((3, 2, 2))),
    "rts_smoother, Ps": lambda f, odd: f.rts_smoother(np.zeros((3, 2)), odd),
    "rts_smoother, Fs": lambda f, odd: f.rts_smoother(np.zeros((3, 2)), np.zeros((3, 2, 2)), Fs=odd),
    "alpha": lambda f, odd: setattr(f, "alpha", odd),
}


@pytest.mark.parametrize("door", FUNCTIONS.values(), ids=FUNCTIONS)
def test_given_to_functions(door):
    refused = 0
    for odd in ODD:
        try:
            door(odd)
        except UfirextError:
            refused += 1
    assert refused > len(ODD) // 2


@pytest.mark.parametrize("kind", [UFIRFilter, FMSFilterSmoother, DelayKalmanFilter, DelayHInfinityFilter])
@pytest.mark.parametrize("verb", VERBS.values(), ids=VERBS)
def test_given_to_filters(kind, verb):
    f, refused = filled(kind), 0
    for odd in ODD:
        try:
            verb(f, odd)
        except UfirextError:
            refused += 1
    assert refused > len(ODD) // 2
    assert np.isfinite(f.x).all()


def test_a_fading_memory_beyond_all_numbers_is_none():
    with pytest.raises(UfirextError, match=r"alpha must be .* with a finite square, got 1e\+200"):
        DelayKalmanFilter(2, 1).alpha = 1e200


def test_nothing_to_weigh_has_the_worst_case_zero():
    assert worst(S=0.0).gain == 0.0


@pytest.mark.parametrize("theta", [-1.0, [1.0, -1.0, 1.0], [1.0, 2.0]])
def test_a_worst_case_asks_for_thetas_that_are_not_negative_and_one_a_step(theta):
    with pytest.raises(UfirextError, match=r"theta must be a number that is not negative, or \(3,\) of them"):
        worst(theta=theta)


@pytest.mark.parametrize("kind", [UFIRFilter, FMSFilterSmoother, DelayKalmanFilter, DelayHInfinityFilter])
def test_the_likelihood_of_a_measurement_is_that_of_its_own_sensor(kind):
    """After an update by a sensor with more rows, S is its S; that of the filter's H and R is asked for."""
    f, twin = filled(kind), filled(kind)
    for g, rows in ((f, 3), (twin, 1)):
        g.predict()
        g.update(np.full(rows, np.nan), H=np.tile(RAMP.H, (rows, 1)), R=100.0 * np.eye(rows))
    twin.update(np.nan)
    assert f.log_likelihood_of(21.0) == pytest.approx(twin.log_likelihood_of(21.0), rel=1e-12)


def test_smoothing_asks_for_what_batch_filter_gives():
    f = filled(UFIRFilter)
    means, covariances, *_ = f.batch_filter(np.arange(9.0))
    as_lists = f.rts_smoother(means.tolist(), covariances.tolist())
    np.testing.assert_array_equal(as_lists[0], f.rts_smoother(means, covariances)[0])
    with pytest.raises(ShapeError, match=r"got \(9, 2, 1\) and \(8, 2, 2\)"):
        f.rts_smoother(means, covariances[:8])
    covariances[3, 0, 0] = np.nan
    with pytest.raises(UfirextError, match="Ps must be finite"):
        f.rts_smoother(means, covariances)


def test_a_gain_that_is_nan_is_no_optimum():
    model = Model([[1.0]], [[1.0]], Q=0.1)
    gain = ufir_gain(model, 4)
    spoilt = type(gain).__mro__[1](gain.K * np.nan, gain.G, gain.P, 4)
    assert not certify(spoilt, model).optimal
