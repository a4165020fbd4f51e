"""ufir and fms are the library's gains in dlqe's terms."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.control.plants import CART, plants
from ufirext import Model, best_horizon, fms_gain, ufir_gain
from ufirext.control import create_ufir_iosystem, fms, ufir

spare = st.integers(0, 15)


@given(plants(), spare)
def test_the_filter_gain_is_that_of_ufir_gain(drawn, extra):
    plant, shortest, rng = drawn
    RN = np.diag(rng.uniform(0.1, 3.0, plant.noutputs))
    K, npg = ufir(plant, shortest + extra, RN, form="filter")
    gain = ufir_gain(Model(plant.A, plant.C, R=RN), shortest + extra)
    size = np.abs(gain.K).max()
    np.testing.assert_allclose(K, gain.K, rtol=0, atol=1e-10 * size)
    np.testing.assert_allclose(npg, gain.G, rtol=0, atol=1e-10 * size**2)


@given(plants(feedthrough=False), spare, st.integers(0, 3))
def test_the_predictor_gain_is_that_of_the_paper(drawn, extra, lag):
    plant, shortest, rng = drawn
    horizon = shortest + extra + lag
    q = rng.normal(size=(plant.ninputs, plant.ninputs))
    QN, RN = q @ q.T, np.diag(rng.uniform(0.1, 1.0, plant.noutputs))
    paper, error = outcome(lambda: fms_gain(plant.A, plant.C, QN, RN, horizon, lag, G=plant.B))
    ours, refusal = outcome(lambda: fms(plant, QN, RN, horizon, lag))
    assert type(error) is type(refusal)
    if paper is None:
        return
    n = plant.nstates
    K, P = ours
    np.testing.assert_allclose(K, paper.H[n:], rtol=0, atol=1e-9 * np.abs(paper.H).max())
    np.testing.assert_allclose(P, paper.P[n:, n:], rtol=0, atol=1e-8 * np.abs(paper.P).max())


def outcome(call):
    """(value, None) or (None, ValueError)."""
    try:
        return call(), None
    except ValueError as error:
        return None, error


def test_the_covariance_goes_to_that_of_dlqe_as_the_horizon_grows():
    _, P, _ = ct.dlqe(CART, [[0.5]], [[0.01]])
    gaps = [np.abs(fms(CART, [[0.5]], [[0.01]], horizon)[1] - P).max() for horizon in (5, 10, 20, 80)]
    assert gaps == sorted(gaps, reverse=True)
    assert gaps[-1] < 1e-12


def test_the_covariance_of_a_ramp_is_that_of_least_squares():
    ramp = ct.ss([[1, 1], [0, 1]], [[0], [1]], [[1, 0]], 0, dt=1)
    N = 10
    _, npg = ufir(ramp, N, form="filter")
    assert npg[0, 0] == pytest.approx(2 * (2 * N - 1) / (N * (N + 1)), rel=1e-12)


def test_auto_takes_the_best_horizon_under_the_noises():
    est = create_ufir_iosystem(CART, "auto", [[0.04]], QN=[[0.5]])
    assert est.horizon == best_horizon(Model(CART.A, CART.C, 0.5 * CART.B @ CART.B.T, 0.04))
    assert ufir(CART, "auto", [[0.04]], QN=[[0.5]])[0].shape == (2, est.horizon)


def test_rows_are_weighted_by_the_noise_of_their_sensor():
    plant = ct.ss([[1.0]], [[1.0]], [[1.0], [1.0]], 0, dt=True)
    K, _ = ufir(plant, 1, np.diag([1.0, 3.0]), form="filter")
    np.testing.assert_allclose(K, [[0.75, 0.25]], atol=1e-14)


def test_long_windows_of_unstable_plants_keep_their_digits():
    plant = ct.ss([[1.2, 0.3], [0.0, 1.1]], [[0.0], [1.0]], [[1.0, 0.0]], 0, dt=True)
    est = create_ufir_iosystem(plant, 120)
    assert np.abs(est.C).max() < 10
    # Deadbeat on noise-free data: the gains on y and u fit together.
    x, Y, U, X = np.array([1e-6, -1e-6]), [], np.random.default_rng(0).normal(size=130) * 1e-6, []
    for u in U:
        X.append(x)
        Y.append(plant.C @ x)
        x = plant.A @ x + plant.B @ [u]
    found = ct.input_output_response(est, np.arange(130), np.vstack([np.array(Y).T, U])).outputs
    scale = np.abs(X[120:]).max()
    np.testing.assert_allclose(found[:, 120:], np.array(X).T[:, 120:], rtol=0, atol=1e-10 * scale)
