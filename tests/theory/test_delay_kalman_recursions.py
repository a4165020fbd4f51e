"""Kalman filters for late measurements: optimal, honest, or a paper's baseline that is neither."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tests import oracles
from tests.strategies import models, positive, random_model, seeds
from tests.theory.delays import F1, H1, Q1, R1, Arrival, World, constant_arrivals, random_arrivals
from ufirext import Model
from ufirext.channels import TimeStamped
from ufirext.recursions import (
    Delayed,
    Lifted,
    augmented_model,
    innovation_gain,
    lift,
    predict,
    predict_delayed,
    predict_lifted,
    update,
    update_delayed,
)

METHODS = ("exact", "correlated", "white", "augmented")
# Table of section 7: true one-axis position RMSE, m, and the filter's own belief.
TABLE = {
    1: {"white": (5.14, 5.61), "correlated": (5.13, 5.13), "exact": (5.13, 5.13), "augmented": (5.13, 5.13)},
    3: {
        "white": (12.61, 18.0),
        "correlated": (11.80, 14.9),
        "exact": (11.41,) * 2,
        "augmented": (11.41,) * 2,
    },
    10: {"white": (66.2, 101), "correlated": (63.8, 95), "exact": (45.45,) * 2, "augmented": (45.45,) * 2},
}


class Run(NamedTuple):
    """The estimates of a filter as maps of the disturbances, and the covariances it believes in."""

    estimates: list[np.ndarray]
    believed: list[np.ndarray]


def run(
    model: Model, P0, steps: int, arrivals: list[Arrival], world: World, longest: int, method: str
) -> Run:
    """A filter on a world: its state is a matrix, one column for each disturbance."""
    n, size = model.dim_x, world.states[0].shape[1]
    start = np.zeros((n, size))
    channel = TimeStamped(longest)
    state = Delayed(start, P0)
    lifted = Lifted(np.vstack([start] * (longest + 1)), lift(np.zeros(n), P0, longest + 1).P)
    estimates, believed = [start], [P0]
    for step in range(1, steps + 1):
        state = predict_delayed(state, model.F, model.Q, depth=longest)
        lifted = Lifted(
            np.vstack([model.F @ lifted.x[:n], lifted.x[:-n]]) if longest else model.F @ lifted.x,
            predict_lifted(Lifted(np.zeros(len(lifted.P)), lifted.P), model.F, model.Q).P,
        )
        for i in (i for i, arrival in enumerate(arrivals) if arrival.step == step):
            delay, z = step - arrivals[i].origin, world.measured[i]
            if method == "augmented":
                H, R = channel.lifted(model.H, model.R, delay, np.zeros(len(lifted.P)), lifted.P)
                lifted = Lifted(*update(lifted.x, lifted.P, z, H, R)[:2])
            else:
                row = channel.effective(model, delay, past=state.past)._replace(
                    offset=np.zeros((model.dim_z, 1))
                )
                state = advance(state, z, row, method)
        estimates.append(lifted.x[:n] if method == "augmented" else state.x)
        believed.append(lifted.P[:n, :n] if method == "augmented" else state.P)
    return Run(estimates, believed)


def advance(state: Delayed, z, row, method: str) -> Delayed:
    """`update_delayed` of many disturbances at once: the gain does not depend on z."""
    after, posterior = update_delayed(state._replace(x=state.x[:, 0]), z[:, 0], row, method)
    return after._replace(x=state.x + posterior.K @ (z - row.H @ state.x))


# -- on time ----------------------------------------------------------------------


@given(models(), seeds)
def test_without_delay_every_method_is_the_kalman_filter_of_the_books(model, seed):
    rng = np.random.default_rng(seed)
    x0, P0, zs = rng.normal(size=model.dim_x), positive(rng, model.dim_x), rng.normal(size=(12, model.dim_z))
    states, covariances = oracles.book_kalman(model.F, model.H, model.Q, model.R, x0, P0, list(zs))
    state = {method: Delayed(x0, P0) for method in ("exact", "correlated", "white")}
    lifted, row = lift(x0, P0, 3), TimeStamped(2).effective(model)
    H = TimeStamped(2).lifted(model.H, model.R, 0, lifted.x, lifted.P)[0]
    for z, x, P in zip(zs, states, covariances, strict=True):
        tolerance = 1e-9 * max(np.abs(P).max(), np.abs(x).max(), 1.0)
        for method in state:
            state[method] = predict_delayed(state[method], model.F, model.Q, depth=2)
            state[method] = update_delayed(state[method], z, row, method)[0]
            assert_allclose(state[method].x, x, atol=tolerance)
            assert_allclose(state[method].P, P, atol=tolerance)
        lifted = predict_lifted(lifted, model.F, model.Q)
        lifted = Lifted(*update(lifted.x, lifted.P, z, H, model.R)[:2])
        assert_allclose(lifted.x[: model.dim_x], x, atol=tolerance)
        assert_allclose(lifted.P[: model.dim_x, : model.dim_x], P, atol=tolerance)


@given(models(kinds=("stable", "oscillating", "marginal")), seeds)
def test_the_papers_information_form_is_the_kalman_filter_once_p_is_read_as_information(model, seed):
    rng = np.random.default_rng(seed)
    x, P = rng.normal(size=model.dim_x), positive(rng, model.dim_x)
    xi, Pi = x.copy(), P.copy()
    for z in rng.normal(size=(10, model.dim_z)):
        x, P = update(*predict(x, P, model.F, model.Q), z, model.H, model.R)[:2]
        prior = model.F @ Pi @ model.F.T + model.Q
        information = np.linalg.inv(prior) + model.H.T @ np.linalg.inv(model.R) @ model.H
        Pi = np.linalg.inv(information)
        gain = Pi @ model.H.T @ np.linalg.inv(model.R)
        xi = model.F @ xi + gain @ (z - model.H @ model.F @ xi)
        assert_allclose(x, xi, rtol=1e-7, atol=1e-7)
        assert_allclose(P, Pi, rtol=1e-7, atol=1e-7)


def test_columns_stay_columns():
    state, posterior = update_delayed(
        predict_delayed(Delayed(np.zeros((2, 1)), np.eye(2)), F1, Q1, np.ones((2, 1)), depth=1),
        np.array([[3.0]]),
        TimeStamped(1).effective(Model(F1, H1, Q1, R1), 1),
    )
    assert state.x.shape == (2, 1)
    assert posterior.y.shape == (1, 1)


def test_a_singular_innovation_covariance_takes_in_what_is_there():
    P = np.diag([1.0, 0.0])
    H, R = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), np.zeros((3, 3))
    x, after, *_ = update(np.zeros(2), P, np.array([2.0, 2.0, 0.0]), H, R)
    assert_allclose(x, [2.0, 0.0], atol=1e-12)
    assert_allclose(after, np.zeros((2, 2)), atol=1e-12)


@given(seeds, st.integers(1, 3))
def test_units_of_the_measurements_do_not_matter_to_the_gain(seed, m):
    rng = np.random.default_rng(seed)
    C, S, units = rng.normal(size=(4, m)), positive(rng, m), 10.0 ** rng.uniform(-12, 12, m)
    scaled = innovation_gain(C * units, S * np.outer(units, units))
    assert_allclose(scaled * units, innovation_gain(C, S), rtol=1e-9, atol=1e-12)


# -- constant delay ----------------------------------------------------------------------


@pytest.mark.parametrize("delay", TABLE)
@pytest.mark.parametrize("method", METHODS)
def test_error_and_belief_are_those_of_the_table(delay, method):
    steps, P0 = 70 + 5 * delay, 10.0 * np.eye(2)
    arrivals = constant_arrivals(steps, delay)
    world = World(F1, H1, Q1, R1, P0, steps, arrivals)
    result = run(Model(F1, H1, Q1, R1), P0, steps, arrivals, world, delay, method)
    true = np.sqrt(world.covariance(result.estimates[-1], steps)[0, 0])
    belief = np.sqrt(result.believed[-1][0, 0])
    assert (true, belief) == pytest.approx(TABLE[delay][method], rel=3e-3)


@pytest.mark.parametrize("delay", TABLE)
def test_monte_carlo_gives_the_same_errors_within_sampling(delay):
    rng = np.random.default_rng(delay)
    steps, runs, P0 = 60 + 5 * delay, 4000, 10.0 * np.eye(2)
    arrivals = constant_arrivals(steps, delay)
    world = World(F1, H1, Q1, R1, P0, steps, arrivals)
    used = np.sqrt(np.diag(world.cov)) > 0
    draws = rng.multivariate_normal(np.zeros(used.sum()), world.cov[np.ix_(used, used)], size=runs)
    for method in METHODS:
        result = run(Model(F1, H1, Q1, R1), P0, steps, arrivals, world, delay, method)
        errors = draws @ (world.states[-1] - result.estimates[-1])[0, used]
        squares = errors**2
        expected = TABLE[delay][method][0] ** 2
        assert abs(squares.mean() - expected) < 5 * squares.std() / np.sqrt(runs) + 6e-3 * expected


@given(models(kinds=("stable", "oscillating", "marginal", "unstable")), seeds, st.integers(1, 4))
def test_at_constant_delay_the_optimum_is_the_punctual_filter_moved_forward(model, seed, delay):
    rng = np.random.default_rng(seed)
    steps, P0 = 14, positive(rng, model.dim_x)
    zs = rng.normal(size=(steps, model.dim_z))
    x0 = rng.normal(size=model.dim_x)
    punctual, _ = oracles.book_kalman(model.F, model.H, model.Q, model.R, x0, P0, list(zs))
    power = np.linalg.matrix_power(model.F, delay)
    state, lifted = Delayed(x0, P0), lift(x0, P0, delay + 1)
    channel = TimeStamped(delay)
    for step in range(1, steps + 1):
        state = predict_delayed(state, model.F, model.Q, depth=delay)
        lifted = predict_lifted(lifted, model.F, model.Q)
        if step <= delay:
            continue
        z, expected = zs[step - delay - 1], power @ punctual[step - delay - 1]
        state = update_delayed(state, z, channel.effective(model, delay, past=state.past))[0]
        H, R = channel.lifted(model.H, model.R, delay, lifted.x, lifted.P)
        lifted = Lifted(*update(lifted.x, lifted.P, z, H, R)[:2])
        size = max(np.abs(expected).max(), np.sqrt(np.abs(lifted.P).max()), 1.0)
        assert_allclose(lifted.x[: model.dim_x], expected, atol=1e-9 * size)
        assert_allclose(state.x, expected, atol=1e-6 * size)


def test_the_augmented_model_is_the_lifted_recursion_as_a_model():
    model = Model(F1, H1, Q1, R1, B=[[0.5], [1.0]])
    big, rng = augmented_model(model, 3), np.random.default_rng(0)
    x, P = np.zeros(8), np.zeros((8, 8))
    P[:2, :2] = np.eye(2)
    lifted = lift(np.zeros(2), np.eye(2), 4)
    for _ in range(6):
        u, z = rng.normal(size=1), rng.normal(size=1)
        x, P = update(*predict(x, P, big.F, big.Q, big.B @ u), z, big.H, big.R)[:2]
        lifted = predict_lifted(lifted, F1, Q1, model.B @ u)
        lifted = Lifted(*update(lifted.x, lifted.P, z, big.H, big.R)[:2])
        assert_allclose(lifted.x, x, atol=1e-12)
        assert_allclose(lifted.P, P, atol=1e-12)


# -- any delays ----------------------------------------------------------------------


@given(models(), seeds, st.integers(1, 4))
def test_the_augmented_filter_is_the_best_linear_estimate_of_all_that_came(model, seed, longest):
    """Any F (singular included), any Q, out of order, with losses."""
    rng = np.random.default_rng(seed)
    P0, arrivals = positive(rng, model.dim_x), random_arrivals(rng, 8, longest)
    world = World(model.F, model.H, model.Q, model.R, P0, 8, arrivals)
    result = run(model, P0, 8, arrivals, world, longest, "augmented")
    for step in range(1, 9):
        best = world.covariance(world.best(step), step)
        size = np.abs(world.covariance(0.0 * world.states[step], step)).max()
        assert_allclose(world.covariance(result.estimates[step], step), best, atol=1e-8 * size)
        assert_allclose(result.believed[step], best, atol=1e-8 * size)


@given(models(kinds=("oscillating", "marginal", "unstable")), seeds, st.integers(1, 3))
def test_the_exact_recursion_believes_its_true_covariance_for_any_delays(model, seed, longest):
    rng = np.random.default_rng(seed)
    P0, arrivals = positive(rng, model.dim_x), random_arrivals(rng, 10, longest)
    world = World(model.F, model.H, model.Q, model.R, P0, 10, arrivals)
    result = run(model, P0, 10, arrivals, world, longest, "exact")
    for step in range(1, 11):
        size = np.abs(world.covariance(0.0 * world.states[step], step)).max()
        true = world.covariance(result.estimates[step], step)
        assert_allclose(result.believed[step], true, atol=1e-7 * size)


def test_the_exact_recursion_is_within_a_few_tenths_of_a_percent_of_the_optimum():
    rng, P0 = np.random.default_rng(3), 10.0 * np.eye(2)
    ratios = []
    for _ in range(4):
        arrivals = random_arrivals(rng, 60, 4, lost=0.1)
        world = World(F1, H1, Q1, R1, P0, 60, arrivals)
        model = Model(F1, H1, Q1, R1)
        exact, best = (run(model, P0, 60, arrivals, world, 4, method) for method in ("exact", "augmented"))
        total = [sum(np.sqrt(P[0, 0]) for P in result.believed[20:]) for result in (exact, best)]
        ratios.append(total[0] / total[1])
    assert min(ratios) >= 1.0 - 1e-9
    assert max(ratios) < 1.005


@pytest.mark.parametrize("method", ["white", "correlated"])
def test_the_papers_baselines_do_not_know_their_error(method):
    P0, arrivals = 10.0 * np.eye(2), constant_arrivals(60, 3)
    world = World(F1, H1, Q1, R1, P0, 60, arrivals)
    result = run(Model(F1, H1, Q1, R1), P0, 60, arrivals, world, 3, method)
    assert result.believed[-1][0, 0] > 1.5 * world.covariance(result.estimates[-1], 60)[0, 0]


@given(seeds)
def test_the_order_of_arrival_within_a_step_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    model = random_model(seed, 3, 2, "stable")
    lifted = lift(rng.normal(size=3), positive(rng, 3), 4)
    for _ in range(4):
        lifted = predict_lifted(lifted, model.F, model.Q)
    results = []
    rows = [(delay, rng.normal(size=2)) for delay in range(4)]
    for order in (rows, rows[::-1]):
        state = lifted
        for delay, z in order:
            H, R = TimeStamped(3).lifted(model.H, model.R, delay, state.x, state.P)
            state = Lifted(*update(state.x, state.P, z, H, R)[:2])
        results.append(state)
    assert_allclose(results[0].x, results[1].x, atol=1e-9)
    assert_allclose(results[0].P, results[1].P, atol=1e-9)


def test_known_inputs_between_origin_and_arrival_leave_no_bias():
    rng = np.random.default_rng(8)
    model, channel = Model(F1, H1, 0.0 * Q1, R1), TimeStamped(3)
    x, history = np.array([5.0, -1.0]), []
    state = Delayed(x, 1e-12 * np.eye(2))
    lifted = lift(x, 1e-12 * np.eye(2), 4)
    for step in range(30):
        Bu = rng.normal(size=2)
        x = F1 @ x + Bu
        history.append(x)
        state = predict_delayed(state, F1, model.Q, Bu, depth=3)
        lifted = predict_lifted(lifted, F1, model.Q, Bu)
        if step >= 3:
            row = channel.effective(model, 3, past=state.past)
            state, posterior = update_delayed(state, H1 @ history[step - 3], row)
            assert_allclose(posterior.y, 0.0, atol=1e-9)
            assert_allclose(lifted.x[6:], history[step - 3], atol=1e-9)
    assert_allclose(state.x, x, atol=1e-9)


@pytest.mark.parametrize("ratio", [1e-14, 1e-9, 1e-4, 1e-2, 1.0, 1e6])
def test_the_covariance_keeps_its_digits_however_good_the_measurement(ratio):
    """Against the information form, which is exact where the measurement is good."""
    P = np.array([[2.0, 1.2], [1.2, 1.0]])
    after = update(np.zeros(2), P, np.zeros(1), H1, np.array([[ratio]])).P
    exact = np.linalg.inv(np.linalg.inv(P) + H1.T @ H1 / ratio)
    assert_allclose(after, exact, rtol=1e-9 + 1e-15 / ratio, atol=1e-13 * ratio)
    assert after[0, 0] == pytest.approx(2.0 * ratio / (2.0 + ratio), rel=1e-12)
    assert np.array_equal(after, after.T)
