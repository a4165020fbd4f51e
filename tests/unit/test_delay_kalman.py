"""DelayKalmanFilter: the best estimate of what came, behind filterpy's verbs."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest
from filterpy.common import Saver
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tests.strategies import models, positive, seeds
from tests.theory.delays import F1, H1, Q1, R1, World, constant_arrivals, random_arrivals
from tests.theory.test_delay_kalman_recursions import TABLE
from ufirext import Model
from ufirext.channels import BernoulliDelay, CompensatedBernoulli, StampedLoss, TimeStamped
from ufirext.errors import HorizonError, UfirextError
from ufirext.filters.kalman import DelayKalmanFilter

EXACT = ("exact", "augmented")
METHODS = (*EXACT, "correlated", "white")
few = settings(max_examples=25)


def configured(model: Model, P0: Any, **options: Any) -> DelayKalmanFilter:
    f = DelayKalmanFilter(model.dim_x, model.dim_z, model.dim_u, **options)
    f.F, f.H, f.Q, f.R, f.P = model.F, model.H, model.Q, model.R, P0
    f.B = model.B
    return f


def vehicle(**options: Any) -> DelayKalmanFilter:
    return configured(Model(F1, H1, Q1, R1), 10.0 * np.eye(2), **options)


def played(f: DelayKalmanFilter, world: World, d: np.ndarray, steps: int) -> list[np.ndarray]:
    """The estimates when the world's disturbances are d."""
    states = []
    for step in range(1, steps + 1):
        f.predict()
        for i, arrival in enumerate(world.arrivals):
            if arrival.step == step:
                f.update(world.measured[i] @ d, delay=step - arrival.origin)
        states.append(f.x.ravel().copy())
    return states


# -- optimal and honest ------------------------------------------------------------------


@few
@given(models(max_x=4, max_z=2), seeds, st.integers(0, 4))
def test_the_augmented_filter_gives_the_best_estimate_of_all_that_came(model, seed, longest):
    """Any F and Q (singular included), any delays, out of order, several in a step, losses."""
    rng = np.random.default_rng(seed)
    P0 = positive(rng, model.dim_x)
    world = World(model.F, model.H, model.Q, model.R, P0, 8, random_arrivals(rng, 8, longest))
    d = np.sqrt(np.maximum(np.diag(world.cov), 0.0)) * rng.normal(size=len(world.cov))
    f = configured(model, P0, max_delay=longest, method="augmented")
    for step, x in enumerate(played(f, world, d, 8), start=1):
        best = world.best(step) @ d
        assert_allclose(x, best, atol=1e-7 * max(1.0, np.abs(best).max()))
    assert_allclose(f.P, world.covariance(world.best(8), 8), atol=1e-7 * max(1.0, np.abs(f.P).max()))


@few
@given(models(kinds=("marginal", "oscillating", "unstable"), max_x=3, max_z=2), seeds, st.integers(0, 3))
def test_the_exact_filter_believes_its_true_covariance(model, seed, longest):
    rng = np.random.default_rng(seed)
    P0 = positive(rng, model.dim_x)
    world = World(model.F, model.H, model.Q, model.R, P0, 7, random_arrivals(rng, 7, longest))
    f = configured(model, P0, max_delay=longest)
    # The filter is linear: what it makes of every disturbance alone is its whole error.
    responses = [played(copy.deepcopy(f), world, d, 7)[-1] for d in np.eye(len(world.cov))]
    played(f, world, np.zeros(len(world.cov)), 7)
    true = world.covariance(np.array(responses).T, 7)
    assert_allclose(f.P, true, atol=1e-7 * np.abs(world.covariance(0.0 * world.states[7], 7)).max())


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_exact_and_augmented_agree_at_constant_delay(delay):
    zs = np.random.default_rng(0).normal(size=60).cumsum()
    exact, augmented = (vehicle(max_delay=delay, method=method) for method in EXACT)
    for n in range(60):
        for f in (exact, augmented):
            f.predict()
            if n >= delay:
                f.update(zs[n - delay], delay=delay)
        assert_allclose(exact.x, augmented.x, rtol=1e-8, atol=1e-8)
        assert_allclose(exact.P, augmented.P, rtol=1e-8)
        assert_allclose(exact.S, augmented.S, rtol=1e-8)
        assert exact.log_likelihood == pytest.approx(augmented.log_likelihood, rel=1e-8)


@pytest.mark.parametrize("method", ["correlated", "white"])
def test_the_baselines_are_worse_and_do_not_know_it(method):
    steps = 20
    world = World(F1, H1, Q1, R1, 10.0 * np.eye(2), steps, constant_arrivals(steps, 3))
    f, best = vehicle(max_delay=3, method=method), vehicle(max_delay=3)
    responses = [played(copy.deepcopy(f), world, d, steps)[-1] for d in np.eye(len(world.cov))]
    played(f, world, np.zeros(len(world.cov)), steps)
    played(best, world, np.zeros(len(world.cov)), steps)
    true = world.covariance(np.array(responses).T, steps)[0, 0]
    assert true > 1.04 * best.P[0, 0]
    assert f.P[0, 0] > 1.5 * true


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("delay", TABLE)
def test_the_filter_errs_and_believes_as_the_table_says(delay, method):
    """Constant delay: the gain of the class settles, and its true error follows from it."""
    steps = 70 + 5 * delay
    f = vehicle(max_delay=delay, method=method)
    for step in range(1, steps + 1):
        f.predict()
        f.update(0.0 if step > delay else None, delay=delay if step > delay else 0)
    true, believed = TABLE[delay][method]
    assert np.sqrt(f.P[0, 0]) == pytest.approx(believed, rel=3e-3)
    # e_n = (I - K Hb) F e_{n-1} + .. as one linear map of the disturbances, played to the settled filter.
    world = World(F1, H1, Q1, R1, np.zeros((2, 2)), 40 + 3 * delay, constant_arrivals(40 + 3 * delay, delay))
    last, estimate = 40 + 3 * delay, np.zeros_like(world.states[0])
    Hb = H1 @ np.linalg.matrix_power(np.linalg.inv(F1), delay)
    for step in range(1, last + 1):
        estimate = F1 @ estimate
        for i, arrival in enumerate(world.arrivals):
            if arrival.step == step:
                estimate = estimate + f.K @ (world.measured[i] - Hb @ estimate)
    if method != "augmented":  # its K acts on the innovation of the older state
        assert np.sqrt(world.covariance(estimate, last)[0, 0]) == pytest.approx(true, rel=1e-2)


def test_smoothed_states_are_the_best_estimates_of_older_states():
    rng = np.random.default_rng(4)
    world = World(F1, H1, Q1, R1, 10.0 * np.eye(2), 9, random_arrivals(rng, 9, 3))
    d = rng.normal(size=len(world.cov))
    f = vehicle(max_delay=3, method="augmented")
    played(f, world, d, 9)
    Z = np.vstack([world.measured[i] for i in world.known_at(9)])
    for lag in range(4):
        x, P = f.smoothed(lag)
        gain = np.linalg.solve(Z @ world.cov @ Z.T, Z @ world.cov @ world.states[9 - lag].T).T
        assert_allclose(x.ravel(), gain @ Z @ d, atol=1e-8)
        assert_allclose(P, world.covariance(gain @ Z, 9 - lag), atol=1e-8)
    with pytest.raises(HorizonError, match="lag must be between 0 and 3"):
        f.smoothed(4)
    with pytest.raises(UfirextError, match="method='augmented'"):
        vehicle(max_delay=3).smoothed(1)


def test_a_prediction_is_what_the_next_predicts_would_give():
    f = vehicle()
    f.predict()
    f.update(3.0)
    x, P = f.predicted(3)
    for _ in range(3):
        f.predict()
    assert_allclose(x, f.x)
    assert_allclose(P, f.P)


# -- filterpy's filter -------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("max_delay", [0, 2])
def test_without_delays_it_is_filterpys_kalman_filter(method, max_delay):
    rng = np.random.default_rng(1)
    kf = KalmanFilter(2, 1, 1)
    kf.F, kf.H, kf.Q, kf.R, kf.P = F1.copy(), H1.copy(), Q1.copy(), R1.copy(), 5.0 * np.eye(2)
    kf.B, kf.x = np.array([[0.5], [1.0]]), np.array([[1.0], [2.0]])
    kf.alpha = 1.02
    f = DelayKalmanFilter.from_filterpy(kf, method=method, max_delay=max_delay)
    for step in range(50):
        z = None if step % 7 == 3 else rng.normal(size=1)
        R = 2.0 if step % 5 == 0 else None
        F = np.array([[1.0, 0.5], [0.0, 1.0]]) if step % 6 == 0 else None
        u = rng.normal(size=(1, 1))
        for filter_ in (kf, f):
            filter_.predict(u=u, F=F)
            filter_.update(z, R=R)
        for name in ("x", "P", "K", "y", "S", "SI", "x_prior", "P_prior", "x_post", "P_post"):
            if z is not None or name not in ("K", "S", "SI"):
                assert_allclose(getattr(f, name), getattr(kf, name), rtol=1e-9, atol=1e-9, err_msg=name)
        if z is not None:
            assert f.log_likelihood == pytest.approx(kf.log_likelihood)


def test_long_streams_of_a_constant_model_stay_filterpys_numbers():
    rng = np.random.default_rng(2)
    kf = KalmanFilter(2, 1)
    kf.F, kf.H, kf.Q, kf.R = F1.copy(), H1.copy(), Q1.copy(), R1.copy()
    f = DelayKalmanFilter.from_filterpy(kf)
    for z in rng.normal(size=(3000, 1)).cumsum(axis=0):
        for filter_ in (kf, f):
            filter_.predict()
            filter_.update(z)
        assert_allclose(f.x, kf.x, rtol=1e-10, atol=1e-10)
    for name in ("P", "K", "y", "S", "x_prior", "P_prior", "x_post", "P_post"):
        assert_allclose(getattr(f, name), getattr(kf, name), rtol=1e-10, atol=1e-10, err_msg=name)


# -- what comes in part, twice, too late -------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_a_missing_component_is_a_measurement_of_the_others(method):
    rng = np.random.default_rng(3)
    model = Model(np.kron(np.eye(2), F1), np.kron(np.eye(2), H1), np.kron(np.eye(2), Q1), positive(rng, 2))
    f, g = (configured(model, np.eye(4), max_delay=2, method=method) for _ in range(2))
    for step in range(12):
        z, delay = rng.normal(size=2), min(step, step % 3)
        for filter_ in (f, g):
            filter_.predict()
        f.update([z[0], np.nan], delay=delay)
        g.update(z[:1], H=model.H[:1], R=model.R[:1, :1], delay=delay)
        assert_allclose(f.x, g.x, atol=1e-10)
        assert_allclose(f.P, g.P, atol=1e-10)
        assert f.y[1, 0] == 0.0
        assert f.log_likelihood == pytest.approx(g.log_likelihood)


@pytest.mark.parametrize("method", EXACT)
def test_a_duplicate_is_dropped_and_a_repeat_with_fresh_noise_is_kept(method):
    duplicate, fresh = vehicle(channel=StampedLoss(), method=method), vehicle(max_delay=1, method=method)
    for f in (duplicate, fresh):
        f.predict()
        f.update(1.0)
        f.predict()
        x, P = f.x.copy(), f.P.copy()
        f.update(1.0, delay=1)
        if f is duplicate:
            assert_allclose(f.x, x)
            assert_allclose(f.P, P)
            assert f.dropped == 1
        else:
            assert np.trace(f.P) < np.trace(P) - 0.1
            assert f.dropped == 0


def test_dropping_duplicates_keeps_the_filter_honest():
    """Taken in twice, the same noise counts as two: the filter believes too much and errs more."""
    rng = np.random.default_rng(11)
    channel, runs, errors = StampedLoss(on_time=0.5), 100, {"dropped": [], "taken": []}
    beliefs = {}
    for _ in range(runs):
        x, truth = rng.multivariate_normal(np.zeros(2), 10.0 * np.eye(2)), []
        for _ in range(25):
            x = F1 @ x + rng.multivariate_normal(np.zeros(2), Q1)
            truth.append(x)
        arrivals = channel.sample(rng, [[x[0]] for x in truth], R=R1)
        for name, options in (("dropped", {"channel": channel}), ("taken", {"max_delay": 1})):
            f = vehicle(**options)
            beliefs[name] = f
            for packets in arrivals:
                f.predict()
                for packet in packets:
                    f.update(packet.z, delay=packet.delay)
            errors[name].append([(f.x[0, 0] - x[0]) ** 2, f.P[0, 0]])
    (true, believed), (true_taken, believed_taken) = (np.mean(errors[name], axis=0) for name in errors)
    spread = np.std([e[0] for e in errors["dropped"]]) / np.sqrt(runs)
    assert abs(true - believed) < 4 * spread
    assert true_taken > believed_taken
    assert believed_taken < believed


@pytest.mark.parametrize("method", METHODS)
def test_a_measurement_from_before_the_start_is_dropped_and_counted(method):
    f = vehicle(max_delay=3, method=method)
    f.predict()
    x, P = f.x.copy(), f.P.copy()
    f.update(5.0, delay=2)
    assert f.dropped == 1
    assert_allclose(f.x, x)
    assert_allclose(f.P, P)
    f.update(5.0, delay=1)
    assert f.dropped == 1
    assert f.P[0, 0] < P[0, 0]


# -- inputs and edits --------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_known_inputs_and_edits_between_origin_and_arrival_leave_no_residual(method):
    rng = np.random.default_rng(6)
    f = configured(Model(F1, H1, 0.0 * Q1, R1, B=[[0.5], [1.0]]), np.eye(2), max_delay=3, method=method)
    truth = np.zeros(2)
    past = [truth]
    for step in range(40):
        u = rng.normal()
        truth = F1 @ truth + np.array([0.5, 1.0]) * u
        f.predict(u=u)
        if step % 4 == 1:
            # The state is moved before this step's measurement ..
            truth = truth + np.array([3.0, -1.0])
            f.x = f.x + np.array([[3.0], [-1.0]])
        past.append(truth)
        delay = min(step, step % 4)
        f.update(past[-1 - delay][:1], delay=delay)
        assert_allclose(f.y, 0.0, atol=1e-9)
        if step % 4 == 2:
            # .. or after it, and what was measured before comes later still.
            truth = truth + np.array([1.0, 2.0])
            f.x += np.array([[1.0], [2.0]])
            f.update(past[-2][:1], delay=1)
            assert_allclose(f.y, 0.0, atol=1e-9)
        if step % 4 == 3:
            # The row of the step in which x was moved, made before that.
            f.update(past[-2][:1], delay=1)
            assert_allclose(f.y, 0.0, atol=1e-9)
        assert_allclose(f.x.ravel(), truth, atol=1e-9)


@pytest.mark.parametrize("method", EXACT)
@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_another_p_from_outside_leaves_every_covariance_possible(method, size):
    f = vehicle(max_delay=3, method=method)
    for step in range(30):
        f.predict()
        if step % 5 == 4:
            f.P = size * np.eye(2)
        f.update(float(step), delay=min(step, step % 4))
        assert np.linalg.eigvalsh(f.P)[0] > 0.0
        assert np.linalg.eigvalsh(f.S)[0] > 0.0
        assert np.isfinite(f.x).all()


def test_another_p_of_the_present_state_keeps_what_older_states_are_given_it():
    f, g = (vehicle(max_delay=2, method="augmented") for _ in range(2))
    for n in range(6):
        for filter_ in (f, g):
            filter_.predict()
            filter_.update(float(n))
    f.predict()
    g.predict()
    g.P = g.P.copy() * 1.0
    for filter_ in (f, g):
        filter_.update(4.0, delay=1)
    assert_allclose(f.x, g.x, rtol=1e-12)
    assert_allclose(f.P, g.P, rtol=1e-12)


# -- channels without stamps -------------------------------------------------------------


@pytest.mark.parametrize("channel", [BernoulliDelay(0.5), CompensatedBernoulli(0.5, 0.9)])
@pytest.mark.parametrize("method", EXACT)
def test_knowing_the_law_of_an_unknown_delay_beats_ignoring_it(channel, method):
    rng = np.random.default_rng(12)
    squares = {"known": [], "ignored": []}
    filters = {"known": vehicle(channel=channel, method=method), "ignored": vehicle()}
    x, truth = np.array([0.0, 15.0]), []
    for _ in range(1500):
        x = F1 @ x + rng.multivariate_normal(np.zeros(2), 0.01 * Q1)
        truth.append(x)
    arrivals = channel.sample(rng, [[x[0]] for x in truth], R=R1)
    for f in filters.values():
        f.Q, f.x = 0.01 * Q1, [0.0, 15.0]
    for state, packets in zip(truth, arrivals, strict=True):
        for name, f in filters.items():
            f.predict()
            for packet in packets:
                f.update(packet.z, delay=packet.delay)
            squares[name].append((f.x[0] - state[0]) ** 2)
    assert np.mean(squares["known"]) < 0.7 * np.mean(squares["ignored"])
    # .. and its P tells its error, which the other one's does not.
    assert np.mean(squares["known"]) == pytest.approx(filters["known"].P[0, 0], rel=0.35)
    assert np.mean(squares["ignored"]) > 2.0 * filters["ignored"].P[0, 0]


# -- refusals ----------------------------------------------------------------------------


def test_a_singular_transition_is_refused_where_it_must_be_inverted_and_nothing_is_lost():
    F = np.array([[1.0, 1.0], [0.0, 0.0]])
    model = Model(F, H1, Q1, R1)
    f, g = (
        configured(model, np.eye(2), max_delay=1),
        configured(model, np.eye(2), max_delay=1, method="augmented"),
    )
    for filter_ in (f, g):
        filter_.predict()
        filter_.update(1.0)
        filter_.predict()
    x, P = f.x.copy(), f.P.copy()
    with pytest.raises(UfirextError, match="method='augmented'"):
        f.update(2.0, delay=1)
    assert_allclose(f.x, x)
    assert_allclose(f.P, P)
    f.update(2.0)
    g.update(2.0, delay=1)
    assert g.P[0, 0] < P[0, 0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "best"}, "method must be one of 'exact', 'augmented', 'correlated', 'white', got 'best'"),
        ({"max_delay": 2, "channel": TimeStamped(2)}, "give one of them"),
        ({"channel": 3}, "channel must be a Channel"),
        ({"max_delay": -1}, "max_delay must be at least 0"),
        ({"max_delay": 1.5}, "max_delay must be an integer"),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        DelayKalmanFilter(2, 1, **options)


@pytest.mark.parametrize("method", METHODS)
def test_a_delay_the_filter_was_not_made_for_is_refused(method):
    f = vehicle(max_delay=2, method=method)
    for _ in range(5):
        f.predict()
    for delay, message in (
        (3, "between 0 and 2, got 3; raise max_delay"),
        (-1, "at least 0"),
        (1.0, "integer"),
    ):
        with pytest.raises(HorizonError, match=message):
            f.update(1.0, delay=delay)
    with pytest.raises(HorizonError, match="give the filter a max_delay"):
        vehicle(method=method).update(1.0, delay=1)
    with pytest.raises(HorizonError, match="no time stamps"):
        vehicle(channel=BernoulliDelay(0.5), method=method).update(1.0, delay=1)


# -- copies ------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda f: pickle.loads(pickle.dumps(f))])
def test_a_copy_goes_on_as_the_original_does(method, duplicate):
    f = vehicle(max_delay=3, method=method)
    for n in range(10):
        f.predict()
        f.update(float(n), delay=min(n, n % 4))
    g = duplicate(f)
    for n in range(10, 20):
        for filter_ in (f, g):
            filter_.predict()
            filter_.update(float(n), delay=n % 4)
        assert np.array_equal(f.x, g.x)
        assert np.array_equal(f.P, g.P)


def test_filterpys_saver_and_repr_see_a_whole_filter():
    f = vehicle(max_delay=2, method="augmented")
    saver = Saver(f)
    for n in range(8):
        f.predict()
        f.update(float(n), delay=min(n, 2))
        saver.save()
    saver.to_array()
    assert saver.x.shape == (8, 2, 1)
    assert "method = augmented" in repr(f)
    assert "max_delay = 2" in repr(f)
    assert (f.method, f.max_delay, f.channel, f.ready) == ("augmented", 2, TimeStamped(2), True)
