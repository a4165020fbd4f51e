"""Which horizon is best: from the model, from data, and while the data come."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.lib.stride_tricks import sliding_window_view

from tests.oracles import Constant, Record, stacked
from tests.strategies import models
from ufirext import Model, best_horizon, kinematic, ufir_gain
from ufirext.adaptive import HorizonBank, bank_candidates
from ufirext.gains import observability_index
from ufirext.horizon import horizon_criterion
from ufirext.window import model_window

RATIOS = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)

# One model for each number of states of an axis; the best horizons lie between 5 and 30.
AXES = {
    1: Model([[1.0]], [[1.0]], Q=0.05, R=1.0),
    2: kinematic(1, 1, 1.0, q=0.01, r=1.0),
    3: kinematic(2, 1, 1.0, q=1e-3, r=1.0),
}


def simulate(model: Model, steps: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    values, vectors = np.linalg.eigh(model.Q)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    states = np.zeros((steps, model.dim_x))
    for t in range(1, steps):
        states[t] = model.F @ states[t - 1] + root @ rng.normal(size=model.dim_x)
    noise = rng.normal(size=(steps, model.dim_z)) @ np.linalg.cholesky(model.R).T
    return states, states @ model.H.T + noise


def estimates(model: Model, zs: np.ndarray, horizon: int) -> np.ndarray:
    """(steps, dim_x), NaN until the first full window."""
    result = np.full((len(zs), model.dim_x), np.nan)
    windows = sliding_window_view(zs, horizon, axis=0).transpose(0, 2, 1).reshape(len(zs) - horizon + 1, -1)
    result[horizon - 1 :] = windows @ ufir_gain(model, horizon).K.T
    return result


def prediction_errors(model: Model, zs: np.ndarray, horizon: int) -> np.ndarray:
    """Squared R-weighted errors of z_t against H F x_{t-1}, NaN where there is no estimate."""
    foretold = np.full(zs.shape, np.nan)
    foretold[1:] = estimates(model, zs, horizon)[:-1] @ (model.H @ model.F).T
    white = (zs - foretold) @ np.linalg.inv(np.linalg.cholesky(model.R)).T
    return (white**2).sum(axis=1)


def naive_criterion(model: Model, horizons: range) -> np.ndarray:
    """tr(R^-1 H P_N H') from one design for each N."""
    weight = np.linalg.inv(model.R)
    return np.array([np.trace(weight @ model.H @ ufir_gain(model, N).P @ model.H.T) for N in horizons])


@given(models())
def test_the_one_pass_criterion_is_that_of_separate_designs(model):
    nu = observability_index(model)
    assume(nu is not None)
    assume(nu <= model.dim_x)
    assume(model_window(model, nu + 2).condition < 1e4)
    criterion = horizon_criterion(model, nu, 60)
    np.testing.assert_allclose(criterion, naive_criterion(model, range(nu, nu + len(criterion))), rtol=1e-8)


@given(models(max_x=4))
def test_the_best_horizon_is_the_naive_minimum_above_the_floor(model):
    nu = observability_index(model)
    assume(nu is not None)
    assume(nu <= model.dim_x)
    assume(model_window(model, nu + 2).condition < 1e4)
    floor, cap = nu + 2, 80
    values = naive_criterion(model, range(floor, cap + 1))
    chosen = best_horizon(model, longest=cap)
    assert floor <= chosen <= cap
    assert values[chosen - floor] <= values.min() * (1.0 + 1e-8)


@pytest.mark.parametrize("tau", [0.1, 1.0])
@pytest.mark.parametrize("ratio", RATIOS)
def test_for_constant_velocity_the_closed_form_is_right_within_one(ratio, tau):
    """N = sqrt(12 sigma_v / (tau sigma_w)), sigma_w the standard deviation of a step's velocity increment."""
    sigma_v, sigma_w = ratio * tau, 1.0
    model = Model([[1, tau], [0, 1]], [[1, 0]], Q=np.diag([0.0, sigma_w**2]), R=sigma_v**2)
    literal = 2 + int(horizon_criterion(model, 2, 200).argmin())
    closed = np.sqrt(12 * sigma_v / (tau * sigma_w))
    assert abs(literal - closed) <= 1.0
    assert best_horizon(model) == max(literal, observability_index(model) + 2)


def test_without_process_noise_longer_is_always_better():
    assert best_horizon(kinematic(1, 1, 1.0, q=0.0)) == 200
    assert best_horizon(kinematic(1, 1, 1.0, q=0.0), longest=77) == 77


def test_a_deadbeat_minimum_is_not_chosen():
    """With next to no measurement noise the literal minimum is the shortest window; two rows are spared."""
    model = kinematic(1, 1, 1.0, q=1.0, r=1e-6)
    assert horizon_criterion(model, 2, 50).argmin() == 0
    assert best_horizon(model) == 4


@pytest.mark.parametrize("model", AXES.values(), ids=str)
def test_the_best_horizon_does_not_depend_on_units(model):
    D = np.logspace(-3, 4, model.dim_x)
    scaled = Model(
        model.F * np.outer(D, 1 / D), 1e3 * model.H / D, Q=model.Q * np.outer(D, D), R=1e6 * model.R
    )
    _, zs = simulate(model, 400, seed=0)
    assert best_horizon(scaled) == best_horizon(model)
    assert best_horizon(scaled, 1e3 * zs) == best_horizon(model, zs)


@given(models(max_x=3), st.integers(1, 12))
def test_leaving_the_newest_row_out_is_the_prediction_of_one_row_less(model, extra):
    """z_n - H x^_n with z_n left out of the window of N rows = z_n - H F x^_{n-1} of the window of N - 1."""
    nu = observability_index(model)
    assume(nu is not None)
    assume(nu <= model.dim_x)
    horizon = nu + extra
    assume(model_window(model, horizon - 1).condition < 1e4)
    zs = np.random.default_rng(extra).normal(size=(horizon, model.dim_z))
    without = [Record(i, i, model.H, model.R, zs[i]) for i in range(horizon - 1)]
    window = stacked(without, Constant(model.F), Constant(model.Q), horizon - 1)
    scale = np.linalg.norm(window.C, axis=0)
    scale[scale == 0] = 1.0
    W = np.linalg.inv(np.linalg.cholesky(window.V))
    x_old = np.linalg.lstsq(W @ window.C / scale, W @ window.Z, rcond=1e-11)[0] / scale
    left_out = zs[-1] - model.H @ window.T @ x_old
    predicted = zs[-1] - model.H @ model.F @ ufir_gain(model, horizon - 1).K @ zs[:-1].ravel()
    np.testing.assert_allclose(predicted, left_out, atol=1e-8 * (1.0 + np.abs(predicted).max()))


@given(models(max_x=3), st.integers(0, 12))
def test_the_residual_variance_is_R_plus_HPH_minus_twice_HGH(model, extra):
    """V(N) = cov(z_n - H x^_n) by stacking, against P and the weighted noise power G = K R K'."""
    nu = observability_index(model)
    assume(nu is not None)
    assume(nu <= model.dim_x)
    horizon = nu + extra
    assume(model_window(model, horizon).condition < 1e4)
    gain = ufir_gain(model, horizon)
    records = [Record(i, i, model.H, model.R, np.zeros(model.dim_z)) for i in range(horizon)]
    window = stacked(records, Constant(model.F), Constant(model.Q), horizon - 1)
    left = window.E - gain.K @ window.D
    newest = np.zeros((model.dim_z, len(window.V)))
    newest[:, -model.dim_z :] = np.eye(model.dim_z)
    residual = newest - model.H @ gain.K
    V = residual @ window.V @ residual.T + model.H @ left @ window.Qs @ left.T @ model.H.T
    G = gain.K @ window.V @ gain.K.T
    identity = model.R + model.H @ gain.P @ model.H.T - 2.0 * model.H @ G @ model.H.T
    np.testing.assert_allclose(V, identity, atol=1e-9 * (np.abs(model.R).max() + np.abs(V).max()))


def test_the_choice_from_data_is_that_of_a_plain_search():
    model = AXES[2]
    _, zs = simulate(model, 600, seed=3)
    horizons = range(4, 41)
    scores = [prediction_errors(model, zs, N)[40:].mean() for N in horizons]
    chosen = best_horizon(model, zs, longest=40)
    assert scores[chosen - 4] <= min(scores) * 1.002


@pytest.mark.parametrize("states", [1, 2, 3])
def test_the_horizon_from_data_is_close_to_the_best_in_hindsight(states):
    """Median over ten series of the error with the chosen horizon, relative to the best one: at most 6 %."""
    model = AXES[states]
    ratios = []
    for seed in range(10):
        truth, zs = simulate(model, 1000, seed)
        errors = {
            N: np.nanmean(((estimates(model, zs, N) - truth)[60:] @ model.H.T) ** 2)
            for N in range(3, 61)
            if observability_index(model) <= N
        }
        ratios.append(errors[best_horizon(model, zs, longest=60)] / min(errors.values()))
    assert np.median(ratios) <= 1.06


@pytest.mark.parametrize("loss", [0.1, 0.4])
def test_missing_rows_hardly_change_the_horizon_from_data(loss):
    model = AXES[2]
    _, zs = simulate(model, 2000, seed=1)
    holed = zs.copy()
    holed[np.random.default_rng(2).random(2000) < loss] = np.nan
    full, some = best_horizon(model, zs), best_horizon(model, holed)
    value = {N: prediction_errors(model, zs, N)[100:].mean() for N in (full, some)}
    assert value[some] <= 1.03 * value[full]


@pytest.mark.parametrize("states", [1, 2, 3])
def test_the_bank_is_nearly_as_good_as_the_best_fixed_horizon(states):
    """Root-mean-square error of the online choice against the best candidate in hindsight: 4 % at most."""
    model = AXES[states]
    truth, zs = simulate(model, 20_000, seed=4)
    candidates = bank_candidates(observability_index(model))
    states_of = np.array([estimates(model, zs, N) for N in candidates])
    scores = np.array([prediction_errors(model, zs, N) for N in candidates])
    bank = HorizonBank(candidates)
    chosen = np.empty(len(zs), dtype=int)
    for t in range(len(zs)):
        bank.score(scores[:, t])
        chosen[t] = candidates.index(bank.best)
    errors = ((states_of - truth) @ model.H.T)[:, 100:, 0]
    online = errors[chosen[100:], np.arange(errors.shape[1])]
    assert np.sqrt(np.mean(online**2)) <= 1.04 * np.sqrt(np.mean(errors**2, axis=1)).min()


def test_the_bank_follows_a_change_of_regime():
    """Calm motion wants a long window; a manoeuvre brings the short ones back, and is forgotten."""
    calm, wild = kinematic(1, 1, 1.0, q=1e-6), kinematic(1, 1, 1.0, q=5.0)
    candidates = bank_candidates(2)
    bank = HorizonBank(candidates)

    def feed(model: Model, steps: int, seed: int) -> int:
        _, zs = simulate(model, steps, seed)
        for row in np.array([prediction_errors(model, zs, N) for N in candidates]).T:
            bank.score(row)
        return bank.best

    assert feed(calm, 600, seed=0) >= 21
    assert feed(wild, 300, seed=1) <= 6
    assert feed(calm, 1500, seed=2) >= 21
