"""Segments: associative, exact, and blind to how a window is cut and slid."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.strategies import models, seeds
from ufirext.errors import UnobservableWindow
from ufirext.minimum_variance import minimum_variance_gain
from ufirext.segments import (
    SlidingFold,
    closing,
    combine,
    covariance,
    estimate,
    known_start,
    split,
    transition,
)


def leaves_of(model, zs):
    """Segments of a stream, the last one without a transition."""
    weighted = model.H.T @ np.linalg.inv(model.R)
    J, still = weighted @ model.H, np.zeros(model.dim_x)
    steps = [transition(model.F, still, model.Q, weighted @ z, J) for z in zs[:-1]]
    return [*steps, closing(weighted @ zs[-1], J)]


def folded(segments):
    whole = segments[0]
    for segment in segments[1:]:
        whole = combine(whole, segment)
    return whole


def random_segment(rng, n=3):
    root, other = rng.normal(size=(n, n)), rng.normal(size=(n, 2))
    return transition(
        rng.normal(size=(n, n)), rng.normal(size=n), root @ root.T, rng.normal(size=n), other @ other.T
    )


def close(actual, expected, tolerance=1e-9):
    np.testing.assert_allclose(actual, expected, atol=tolerance * (np.abs(expected).max() + 1.0))


@given(seeds)
def test_combination_is_associative(seed):
    rng = np.random.default_rng(seed)
    a, b, c = (random_segment(rng) for _ in range(3))
    one, other = combine(combine(a, b), c), combine(a, combine(b, c))
    for left, right in zip(one[:5], other[:5], strict=True):
        close(left, right)


@given(
    models(kinds=("stable", "marginal", "oscillating", "unstable"), max_x=3),
    st.integers(4, 10),
    st.integers(0, 9),
    seeds,
)
def test_a_folded_window_is_the_minimum_variance_estimate_and_its_split_the_smoothed_one(
    model, horizon, lag, seed
):
    lag = min(lag, horizon - 1)
    try:
        gain = minimum_variance_gain(model, horizon, lag)
    except UnobservableWindow:
        pytest.fail("these kinds are observable")
    zs = np.random.default_rng(seed).normal(size=(horizon, model.dim_z))
    leaves = leaves_of(model, zs)
    whole = folded(leaves)
    x = estimate(whole)
    if x is None:
        return  # left to the recursion on gains
    close(x, gain.K_now @ zs.ravel(), 1e-7)
    close(covariance(whole), gain.P_now, 1e-7)
    n, at = model.dim_x, horizon - 1 - lag
    first = folded(leaves[:at]) if at else closing(np.zeros(n), np.zeros((n, n)))
    found = split(first, folded(leaves[at:]))
    assert found is not None
    close(found[0], gain.K @ zs.ravel(), 1e-7)
    close(found[1], gain.P, 1e-7)
    close(found[2], gain.P_cross, 1e-7)


@given(seeds, st.integers(1, 12))
def test_a_sliding_fold_equals_the_fold_made_afresh(seed, longest):
    rng = np.random.default_rng(seed)
    leaves = [random_segment(rng) for _ in range(60)]
    fold, start, stop = SlidingFold(leaves.__getitem__), 0, 0
    while stop < 55:
        stop += int(rng.integers(1, 4))
        start = min(max(start, stop - longest) + int(rng.integers(0, 2)), stop)
        if rng.random() < 0.2:
            place = int(rng.integers(start, stop)) if start < stop else start
            leaves[place] = random_segment(rng)
            fold.changed(place)
        got = fold(start, stop)
        if start == stop:
            assert got is None
            continue
        assert got is not None
        for mine, afresh in zip(got[:5], folded(leaves[start:stop])[:5], strict=True):
            close(mine, afresh, 1e-7)


def test_a_known_start_is_the_kalman_filter():
    rng = np.random.default_rng(2)
    F, H, Q, R = rng.normal(size=(2, 2)), rng.normal(size=(1, 2)), np.diag([0.3, 0.1]), np.array([[0.7]])
    x, P = np.array([1.0, -1.0]), np.diag([2.0, 3.0])
    zs = rng.normal(size=(4, 1))
    whole = known_start(x, P)
    weighted = H.T / R[0, 0]
    for i, z in enumerate(zs):
        K = P @ H.T / (H @ P @ H.T + R)
        x, P = x + K @ (z - H @ x), P - K @ H @ P
        last = i == len(zs) - 1
        step = (weighted @ z, weighted @ H)
        whole = combine(whole, closing(*step) if last else transition(F, np.zeros(2), Q, *step))
        if not last:
            x, P = F @ x, F @ P @ F.T + Q
    close(whole.b, x, 1e-12)
    close(whole.C, P, 1e-12)


def test_what_is_not_determined_is_not_estimated():
    n = 2
    blind = closing(np.zeros(n), np.zeros((n, n)))
    assert estimate(blind) is None
    with pytest.raises(RuntimeError, match="does not determine"):
        covariance(blind)
    one = closing(np.array([1.0, 0.0]), np.diag([1.0, 0.0]))
    assert estimate(one) is None
    assert split(blind, one) is None
    # Forgotten before it matters: the second state is not seen, and does not reach the next one.
    forgets = transition(np.diag([1.0, 0.0]), np.zeros(n), np.eye(n), one.eta, one.J)
    close(estimate(forgets), [1.0, 0.0])


def test_information_too_ill_conditioned_to_square_is_left_alone():
    weak = closing(np.ones(2), np.array([[1.0, 1.0], [1.0, 1.0 + 1e-11]]))
    assert estimate(weak) is None
