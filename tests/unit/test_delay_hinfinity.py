"""DelayHInfinityFilter: the bound it promises, measured by playing every disturbance to the filter itself."""

from __future__ import annotations

import copy
import pickle
import warnings
from typing import Any

import numpy as np
import pytest
from filterpy.common import Saver
from filterpy.hinfinity import HInfinityFilter
from numpy.testing import assert_allclose

from tests.theory.delays import F1, H1, Q1, R1, Arrival, World
from ufirext.channels import BernoulliDelay
from ufirext.errors import UfirextError
from ufirext.filters.hinfinity import DelayHInfinityFilter
from ufirext.filters.kalman import DelayKalmanFilter
from ufirext.recursions import ThetaTooLarge

FORMS = ("posterior", "prior")
STEPS = 9
# Out of order, lost (4 and 7), at most one a step.
ARRIVALS = [
    Arrival(1, 1),
    Arrival(3, 2),
    Arrival(4, 3),
    Arrival(6, 6),
    Arrival(7, 5),
    Arrival(8, 8),
    Arrival(9, 9),
]
PUNCTUAL = [Arrival(step, step) for step in range(1, STEPS + 1)]


def vehicle(make: Any = DelayHInfinityFilter, **options: Any) -> Any:
    f = make(2, 1, **options)
    f.F, f.H, f.Q, f.R, f.P = F1, H1, 0.1 * Q1, R1, 2.0 * np.eye(2)
    return f


def world(arrivals: list[Arrival]) -> World:
    return World(F1, H1, 0.1 * Q1, R1, 2.0 * np.eye(2), STEPS, arrivals)


def errors(f: Any, plant: World, d: np.ndarray) -> np.ndarray:
    """The errors that f bounds, step by step, when the plant's disturbances are d."""
    found = []
    for step in range(1, STEPS + 1):
        f.predict()
        prior = plant.states[step] @ d - f.x.ravel()
        for i, arrival in enumerate(plant.arrivals):
            if arrival.step == step:
                f.update(plant.measured[i] @ d, delay=step - arrival.origin)
        found.append(prior if f.form == "prior" else plant.states[step] @ d - f.x.ravel())
    return np.array(found)


def largest_gain(f: Any, plant: World, thetas: Any) -> float:
    """sup sum theta_n |e_n|^2_S / |d|^2 by the response of the filter to every disturbance alone."""
    root = np.linalg.cholesky(f.weight).T
    scale = np.sqrt(np.broadcast_to(thetas, STEPS))[:, None]
    columns = np.linalg.cholesky(plant.cov + 1e-15 * np.eye(len(plant.cov))).T
    responses = [(scale * (errors(copy.deepcopy(f), plant, d) @ root.T)).ravel() for d in columns]
    return float(np.linalg.norm(np.array(responses), 2) ** 2)


def exists(plant: World, theta: float, **options: Any) -> bool:
    try:
        errors(vehicle(theta=theta, **options), plant, np.zeros(len(plant.cov)))
    except ThetaTooLarge:
        return False
    return True


def limit(plant: World, **options: Any) -> float:
    low, high = 1e-6, 1e2
    while high / low > 1.0001:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if exists(plant, middle, **options) else (low, middle)
    return low


# -- the bound ---------------------------------------------------------------------------


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("arrivals", [PUNCTUAL, ARRIVALS], ids=["punctual", "late and lost"])
def test_the_bound_is_kept_and_nearly_met_at_its_limit_and_nothing_exists_beyond(form, arrivals):
    plant, options = world(arrivals), {"form": form, "max_delay": 0 if arrivals is PUNCTUAL else 2}
    theta = 0.999 * limit(plant, **options)
    gain = largest_gain(vehicle(theta=theta, **options), plant, theta)
    assert 0.99 < gain <= 1.0 + 1e-9
    assert not exists(plant, 1.002 * theta, **options)
    kalman = largest_gain(vehicle(theta=0.0, **options), plant, theta)
    assert kalman > gain


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("S", [np.diag([1.0, 0.01]), np.array([[2.0, 0.5], [0.5, 1.0]])])
def test_the_weight_of_the_errors_counts(form, S):
    plant = world(ARRIVALS)
    options = {"form": form, "S": S, "max_delay": 2}
    theta = 0.999 * limit(plant, **options)
    assert 0.99 < largest_gain(vehicle(theta=theta, **options), plant, theta) <= 1.0 + 1e-9


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("policy", ["auto", "sequence", "callable", "clipped"])
def test_thetas_that_change_keep_their_weighted_sum(form, policy):
    plant = world(ARRIVALS)
    top = limit(plant, form=form, max_delay=2)
    schedule = [top * (0.95 if step % 2 else 0.2) for step in range(STEPS)]
    theta = {
        "auto": "auto",
        "sequence": schedule,
        "callable": lambda n: schedule[n - 1],
        "clipped": 3.0 * top,
    }
    f = vehicle(theta=theta[policy], form=form, max_delay=2, on_violation="clip", fraction=0.8)
    spy, thetas = copy.deepcopy(f), []
    for step in range(1, STEPS + 1):
        spy.predict()
        delays = [step - arrival.origin for arrival in plant.arrivals if arrival.step == step]
        spy.update(0.0 if delays else None, delay=sum(delays))
        thetas.append(spy.theta_used)
        assert thetas[-1] < spy.theta_max
    if policy in ("sequence", "callable"):
        assert_allclose(thetas, schedule)
    if policy == "auto":
        assert [theta == 0.0 for theta in thetas] == [step in (2, 5) for step in range(1, STEPS + 1)]
    assert (spy.guarantee.clipped > 0) == (policy == "clipped")
    assert spy.guarantee.steps == STEPS
    assert spy.guarantee.theta == (min(thetas), max(thetas))
    gain = largest_gain(f, plant, thetas)
    assert 0.3 < gain <= 1.0 + 1e-9


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("delay", [0, 2])
def test_the_filter_computes_its_own_worst_case(form, delay):
    f = vehicle(theta=1e-3, form=form, max_delay=2)
    arrivals = [Arrival(step, step - delay) for step in range(delay + 1, STEPS + 1)]
    told, played = f.worst_case_gain(STEPS, delay).gain, largest_gain(f, world(arrivals), 1e-3)
    if delay == 0:
        assert told == pytest.approx(played, rel=1e-6)
    assert told <= 1.0
    f.predict()
    x = f.x.copy()
    f.worst_case_gain(5)
    assert_allclose(f.x, x)


def test_a_worst_case_of_rows_that_are_not_known_is_refused():
    f = vehicle(theta=1e-3, channel=BernoulliDelay(0.8))
    with pytest.raises(UfirextError, match="the coming rows must be known"):
        f.worst_case_gain(5)


# -- its neighbours ----------------------------------------------------------------------


@pytest.mark.parametrize("form", FORMS)
def test_with_theta_zero_it_is_the_kalman_filter(form):
    rng = np.random.default_rng(0)
    kalman = vehicle(DelayKalmanFilter, max_delay=3, method="augmented")
    f = vehicle(theta=0.0, form=form, max_delay=3)
    for step in range(60):
        z = None if step % 6 == 5 else rng.normal(size=1)
        for filter_ in (f, kalman):
            filter_.predict()
            filter_.update(z, delay=min(step, step % 4))
        for name in ("x", "P", "K", "y", "S", "x_prior", "P_prior"):
            assert_allclose(getattr(f, name), getattr(kalman, name), rtol=1e-12, atol=1e-12, err_msg=name)


@pytest.mark.parametrize("form", [*FORMS, "mixed"])
def test_measurements_of_one_step_count_like_one_stacked_measurement(form):
    rng = np.random.default_rng(1)
    one, two = (vehicle(theta=1e-3, form=form) for _ in range(2))
    H, R = np.vstack([H1, [[0.0, 1.0]]]), np.diag([R1[0, 0], 2.0])
    for _ in range(10):
        z = rng.normal(size=2)
        for f in (one, two):
            f.predict()
        one.update(z, R=R, H=H)
        two.update(z[:1])
        two.update(z[1:], R=R[1:, 1:], H=H[1:])
        if form == "posterior":
            assert_allclose(two.x, one.x, atol=1e-10)
        assert_allclose(two.P, one.P, rtol=1e-9)
    assert one.guarantee.steps == two.guarantee.steps == 10


@pytest.mark.parametrize("form", FORMS)
def test_p_is_what_the_next_prediction_starts_from(form):
    f = vehicle(theta=1e-2, form=form)
    for n in range(5):
        f.predict()
        f.update(float(n))
        P = f.P.copy()
        f.predict()
        assert_allclose(f.P_prior, F1 @ P @ F1.T + 0.1 * Q1)
        f.update(float(n))


def filterpys(gamma: float) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        hinf = HInfinityFilter(2, 1, 0, gamma=gamma)
    hinf.F, hinf.H, hinf.P = F1, H1, 2.0 * np.eye(2)
    hinf.V, hinf.W, hinf.Q = R1, 0.1 * Q1, np.diag([1.0, 0.5])
    hinf.x = np.array([[1.0], [2.0]])
    return hinf


def test_a_filter_of_filterpys_hinfinity_goes_over():
    hinf = filterpys(0.01)
    f = DelayHInfinityFilter.from_filterpy(hinf, form="prior")
    assert (f.theta, f.form) == (0.01, "prior")
    for name, value in {
        "F": F1,
        "H": H1,
        "Q": hinf.W,
        "R": R1,
        "P": hinf.P,
        "weight": hinf.Q,
        "x": hinf.x,
    }.items():
        assert_allclose(getattr(f, name), value, err_msg=name)
    assert DelayHInfinityFilter.from_filterpy(hinf, theta="auto", max_delay=2).theta == "auto"


@pytest.mark.parametrize(("theirs", "ours"), [("W", "Q"), ("V", "R"), ("gamma", "theta")])
def test_the_letters_of_filterpys_hinfinity_are_not_taken_in_silence(theirs, ours):
    f = vehicle()
    with pytest.raises(AttributeError, match=f"filterpy's {theirs} is {ours}") as caught:
        setattr(f, theirs, 0.1)
    assert isinstance(caught.value, UfirextError)
    assert not hasattr(f, theirs)


def test_unlike_filterpys_it_is_the_kalman_filter_for_gamma_zero():
    hinf = filterpys(0.0)
    f = DelayHInfinityFilter.from_filterpy(hinf)
    kalman = vehicle(DelayKalmanFilter)
    kalman.x = hinf.x
    for n in range(20):
        for filter_ in (hinf, f, kalman):
            filter_.predict()
            filter_.update(np.array([[20.0 * (n % 3)]]))
    assert_allclose(f.x, kalman.x, rtol=1e-12)
    assert np.abs(hinf.x - kalman.x).max() > 0.1


def test_the_papers_pairing_diverges_where_the_real_filter_does_not_and_promises_nothing():
    low, high = (limit(world(PUNCTUAL), form=form) for form in ("prior", "posterior"))
    theta = 0.5 * (low + high)
    gains = {
        form: largest_gain(vehicle(theta=theta, form=form), world(PUNCTUAL), theta)
        for form in ("posterior", "mixed")
    }
    assert gains["posterior"] <= 1.0
    assert gains["mixed"] > 1.2
    assert not vehicle(theta=theta, form="mixed").guarantee.holds


# -- refusals ----------------------------------------------------------------------------


@pytest.mark.parametrize("form", [*FORMS, "mixed"])
def test_a_refusal_names_the_step_and_leaves_the_filter_as_it_was(form):
    f = vehicle(theta=1e-4, form=form, max_delay=1)
    for n in range(5):
        f.predict()
        f.update(float(n))
    before = {name: np.array(getattr(f, name)) for name in ("x", "P", "x_prior", "P_prior")}
    f.theta = 10.0
    if form == "prior":
        with pytest.raises(ThetaTooLarge, match="at step 6") as caught:
            f.predict()
    else:
        f.predict()
        before = {name: np.array(getattr(f, name)) for name in ("x", "P", "x_prior", "P_prior")}
        with pytest.raises(ThetaTooLarge, match="at step 6") as caught:
            f.update(5.0)
    assert caught.value.theta == 10.0
    assert caught.value.step == 6
    for name, value in before.items():
        assert_allclose(getattr(f, name), value, err_msg=name)
    f.theta = 0.999 * caught.value.theta_max
    if form == "prior":
        f.predict()
    f.update(5.0)
    assert f.theta_used == pytest.approx(0.999 * f.theta_max)


@pytest.mark.parametrize("form", FORMS)
def test_a_long_gap_ends_a_guarantee_of_fixed_theta_and_not_that_of_auto(form):
    fixed, auto = vehicle(theta=0.01, form=form), vehicle(theta="auto", form=form)
    for f in (fixed, auto):
        f.predict()
        f.update(1.0)
    with pytest.raises(ThetaTooLarge):  # noqa: PT012
        for _ in range(300):
            fixed.predict()
            fixed.update(None)
    for _ in range(300):
        auto.predict()
        auto.update(None)
    auto.predict()
    auto.update(2.0)
    assert np.isfinite(auto.P).all()
    assert auto.guarantee.theta[0] == 0.0


@pytest.mark.parametrize(("form", "theta"), [("prior", "auto"), ("posterior", "auto"), ("posterior", 0.001)])
@pytest.mark.parametrize("before", [0, 3, 80])
def test_a_step_that_is_open_has_no_theta_and_does_not_count(before, form, theta):
    """Looking changes nothing: the same filter, never asked on the way, says the same at the end."""
    f, quiet = vehicle(theta=theta, form=form), vehicle(theta=theta, form=form)
    for step in range(1, before + 1):
        for each in (f, quiet):
            each.predict()
            each.update(float(step))
    closed = before
    for z in (1.0, None, "no update", 2.0, 3.0):
        for each in (f, quiet):
            each.predict()
        assert f.theta_used is None
        assert f.guarantee.steps == closed
        assert f.theta_max > 0.0
        closed += 1
        if z == "no update":
            continue  # the next predict() closes this step
        for each in (f, quiet):
            each.update(z)
        assert f.guarantee.steps == closed
        assert (f.theta_used == 0.0) == (z is None and theta == "auto")
        assert f.guarantee.theta[0] <= f.theta_used <= f.guarantee.theta[1]
    assert f.guarantee == quiet.guarantee
    assert f.theta_used == quiet.theta_used
    assert_allclose(f.P, quiet.P, rtol=1e-12)


def test_a_given_theta_bounds_the_error_before_the_update_whatever_comes():
    f = vehicle(theta=0.001, form="prior")
    for z in (1.0, None, 2.0):
        f.predict()
        assert f.theta_used == 0.001
        f.update(z)
        assert f.theta_used == 0.001


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"form": "both"}, "form must be one of 'posterior', 'prior', 'mixed', got 'both'"),
        ({"on_violation": "ignore"}, "on_violation must be one of 'raise', 'clip', got 'ignore'"),
        ({"theta": -1.0}, "theta must be a finite number, not negative"),
        ({"theta": np.nan}, "theta must be a finite number"),
        ({"theta": "large"}, "theta must be 'auto', a number"),
        ({"theta": []}, "at least one number"),
        ({"theta": [0.1, -0.1]}, r"theta\[1\] must be a finite number, not negative"),
        ({"theta": None}, "theta must be a number"),
        ({"theta": ["0.1"]}, r"theta\[0\] must be a number, got '0.1'"),
        ({"theta": np.timedelta64(1, "ns")}, "theta must be a number"),
        ({"theta": np.array([0.1, np.nan])}, r"theta\[1\] must be a finite number"),
        ({"fraction": "0.3"}, "fraction must be a number, got '0.3'"),
        ({"fraction": 1.0}, "fraction must lie between 0 and 1"),
        ({"fraction": 0.0}, "fraction must lie between 0 and 1"),
        ({"S": [[1.0, 0.0], [0.0, -1.0]]}, "weight must be positive semidefinite"),
        ({"S": np.eye(3)}, "weight must have shape"),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(UfirextError, match=message):
        DelayHInfinityFilter(2, 1, **options)


def test_a_sequence_may_be_an_array_and_its_last_theta_goes_on():
    f = vehicle(theta=np.array([0.001, 0.002]))
    used = []
    for n in range(4):
        f.predict()
        f.update(float(n))
        used.append(f.theta_used)
    assert used == [0.001, 0.002, 0.002, 0.002]


def test_a_function_that_returns_no_theta_is_refused():
    f = vehicle(theta=lambda step: -1.0)
    f.predict()
    with pytest.raises(UfirextError, match=r"theta\(1\) must be a finite number, not negative"):
        f.update(1.0)


# -- what it says ------------------------------------------------------------------------


def test_edits_of_the_weight_in_place_count():
    f, g = vehicle(theta=0.01), vehicle(theta=0.01, S=np.diag([1.0, 3.0]))
    f.weight[1, 1] = 3.0
    for filter_ in (f, g):
        filter_.predict()
        filter_.update(1.0)
    assert_allclose(f.P, g.P)
    assert f.theta_max == pytest.approx(g.theta_max)


def test_the_guarantee_counts_steps_and_tells_what_is_bounded():
    f = vehicle(theta=0.01, max_delay=2)
    assert f.guarantee.steps == 0
    for n in range(4):
        f.predict()
        f.update(float(n))
    assert f.guarantee.steps == 4
    assert f.guarantee.theta == (0.01, 0.01)
    assert f.guarantee.theta_max > 0.01
    for word in ("a-posteriori", "after the update", "delays up to 2 steps included", "theta = 0.01"):
        assert word in str(f.guarantee)
    assert "guarantee = H-infinity" in repr(f)
    unknown = vehicle(theta=0.01, channel=BernoulliDelay(0.8))
    assert "unknown delay" in str(unknown.guarantee)


@pytest.mark.parametrize("form", [*FORMS, "mixed"])
@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda f: pickle.loads(pickle.dumps(f))])
def test_a_copy_goes_on_as_the_original_does(form, duplicate):
    f = vehicle(theta=1e-3, form=form, max_delay=2)
    for n in range(6):
        f.predict()
        f.update(float(n), delay=min(n, n % 3))
    g = duplicate(f)
    for n in range(6, 12):
        for filter_ in (f, g):
            filter_.predict()
            filter_.update(float(n), delay=n % 3)
        assert np.array_equal(f.x, g.x)
        assert np.array_equal(f.P, g.P)
    assert f.guarantee == g.guarantee


def test_filterpys_saver_takes_it_down():
    f = vehicle(theta="auto", max_delay=1)
    saver = Saver(f)
    for n in range(6):
        f.predict()
        f.update(float(n))
        saver.save()
    saver.to_array()
    assert saver.x.shape == (6, 2, 1)
    assert saver.theta_max.shape == (6,)
