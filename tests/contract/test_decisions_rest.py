"""The decisions UNOBSERVABLE and horizon, delays, and the small print."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import ufirext
from ufirext import Model, UFIRFilter, UnobservableWindow, best_horizon, kinematic, ufir_gain

from .models import constant_velocity, flat, plane, ramp_F, run, trajectory, vector, walk
from .naive import BookKalman, Row, window_estimate


@pytest.mark.contract("UNOBSERVABLE")
def test_gain_functions_raise():
    with pytest.raises(UnobservableWindow):
        ufir_gain(kinematic(1, 1, 1.0), 1)
    with pytest.raises(UnobservableWindow):
        ufir_gain(Model(ramp_F(), [[0.0, 1.0]]), 30)


@pytest.mark.contract("UNOBSERVABLE")
@pytest.mark.parametrize("verb", ["predict", "update"])
def test_a_horizon_that_can_never_determine_the_state_is_refused_at_the_first_step(column, verb):
    f = UFIRFilter(3, 1, horizon=2)
    f.F = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
    f.H = np.array([[1.0, 0.0, 0.0]])
    with pytest.raises(UnobservableWindow, match=r"at least 3.*got 2") as raised:
        f.predict() if verb == "predict" else f.update(1.0)
    assert raised.value.shortest == 3


@pytest.mark.contract("UNOBSERVABLE")
@pytest.mark.parametrize("H", [[[0.0, 0.0]], [[0.0, 1.0]]], ids=["nothing", "speed"])
def test_a_model_unobservable_at_every_horizon_is_a_kalman_filter(ufir, column, rng, H):
    f = constant_velocity(ufir, column, x0=(3, 1))
    f.H = np.array(H)
    book = BookKalman(flat(f.x), f.P.copy())
    for _ in range(60):
        z = 1.0 + rng.standard_normal(1)
        run(f, [z])
        book.predict(f.F, f.Q)
        book.update(z, f.H, f.R)
        np.testing.assert_allclose(flat(f.x), book.x, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(f.P, book.P, rtol=1e-8)
        assert not f.ready


@pytest.mark.contract("horizon")
def test_an_integer_horizon_is_kept(ufir):
    f = plane(ufir)
    assert f.horizon == ufir.horizon
    run(f, [[n, n] for n in range(60)])
    f.R = 100.0 * np.eye(2)
    run(f, [[n, n] for n in range(60)])
    assert f.horizon == ufir.horizon


@pytest.mark.contract("horizon")
@pytest.mark.parametrize("horizon", [0, -3, 2.5, "long", None, [8]])
def test_an_impossible_horizon_is_refused(horizon):
    with pytest.raises(ValueError, match="horizon"):
        UFIRFilter(2, 1, horizon=horizon)
    f = UFIRFilter(2, 1, horizon=8)
    with pytest.raises(ValueError, match="horizon"):
        f.horizon = horizon
    assert f.horizon == 8


@pytest.mark.contract("horizon")
@pytest.mark.parametrize(("before", "after"), [(8, 20), (20, 8)])
def test_the_horizon_may_be_changed_in_mid_life(column, rng, before, after):
    """After as many rows as the new window holds, the old one is forgotten."""
    f, twin = (
        constant_velocity(UFIRFilter, column, horizon=before),
        constant_velocity(UFIRFilter, column, horizon=after),
    )
    zs = walk(rng, 90, 1)
    run(f, zs[:40])
    f.horizon = after
    assert f.horizon == after
    run(f, zs[40 : 40 + after])
    run(twin, zs[: 40 + after])
    for z in zs[40 + after :]:
        run(f, [z])
        run(twin, [z])
        np.testing.assert_allclose(f.x, twin.x, rtol=1e-9, atol=1e-9)


@pytest.mark.contract("horizon")
@pytest.mark.parametrize("after", [5, 12, 40])
def test_what_a_shorter_or_longer_window_has_published_waits_to_be_read(rng, after):
    """P_prior and S lean on the window before, whose steps and rows the new one forgets."""
    late, soon = (constant_velocity(UFIRFilter, horizon=30) for _ in range(2))
    noises = [np.eye(2) * (5.0 if n % 7 == 0 else 0.1) for n in range(402)]
    for n, (z, Q) in enumerate(zip(walk(rng, 402, 1), noises, strict=True)):
        if n == 400:
            late.horizon = soon.horizon = after
        for f in (late, soon):
            f.predict(Q=Q)
            _ = soon.P
            f.update(z)
    for name in ("P_prior", "S", "P", "K"):
        np.testing.assert_allclose(getattr(late, name), getattr(soon, name), rtol=1e-9)


@pytest.mark.contract("horizon")
@pytest.mark.parametrize("q", [1e-6, 1e-2, 100.0])
def test_by_default_the_horizon_comes_from_the_model(column, q):
    f = plane(UFIRFilter, column, q=q)
    run(f, [[n, n] for n in range(10)])
    assert f.horizon == best_horizon(Model(f.F, f.H, f.Q, f.R))
    assert 2 + 2 <= f.horizon <= 200


@pytest.mark.contract("horizon")
def test_without_process_noise_the_automatic_horizon_is_the_longest(column):
    f = plane(UFIRFilter, column, q=0.0)
    run(f, [[n, n] for n in range(10)])
    assert f.horizon == 200


@pytest.mark.contract("horizon")
def test_the_automatic_horizon_follows_the_model_at_most_once_per_horizon(column):
    f = constant_velocity(UFIRFilter, column, q=1.0)
    run(f, [0.0])
    horizons = [f.horizon]
    for n in range(200):
        f.R = np.array([[1.0 if n % 2 else 1e4]])
        run(f, [0.0])
        horizons.append(f.horizon)
    changes = [n for n in range(1, 201) if horizons[n] != horizons[n - 1]]
    assert changes
    for earlier, later in pairwise(changes):
        assert later - earlier >= horizons[earlier]


@pytest.mark.contract("horizon")
def test_arguments_of_one_call_do_not_change_the_automatic_horizon(column):
    f = constant_velocity(UFIRFilter, column, q=1.0)
    run(f, [0.0])
    horizon = f.horizon
    for _ in range(3 * horizon):
        f.predict(F=ramp_F(0.01), Q=1e-9 * np.eye(2))
        f.update(vector([0.0], column), R=np.array([[1e6]]), H=np.array([[1.0, 0.01]]))
        assert f.horizon == horizon


@pytest.mark.contract("horizon")
def test_the_adaptive_horizon_needs_no_Q(column, rng):
    f = constant_velocity(UFIRFilter, column, horizon="adaptive")
    f.Q = np.zeros((2, 2))
    states = trajectory(f.F, (0.0, 1.0), 300)
    errors = []
    for x in states:
        run(f, [x[0] + rng.standard_normal()])
        errors.append(flat(f.x)[0] - x[0])
        assert isinstance(f.horizon, int)
    assert f.horizon >= 11  # a straight line deserves a long window
    assert np.sqrt(np.mean(np.square(errors[100:]))) < 0.7


@pytest.mark.contract("small print")
def test_K_is_what_the_newest_row_moves_x_by(make, column, rng):
    f, twin = plane(make, column), plane(make, column)
    for z in walk(rng, 60, 2):
        nudge = rng.standard_normal(2)
        run(f, [z])
        twin.predict()
        moved, _ = twin.get_update(z + nudge)
        np.testing.assert_allclose(flat(moved) - flat(f.x), f.K @ nudge, rtol=1e-8, atol=1e-8)
        twin.update(z)


@pytest.mark.contract("small print")
def test_with_unit_R_K_is_G_H(ufir, column, rng):
    f = constant_velocity(ufir, column)
    f.R = np.eye(1)
    for n, z in enumerate(walk(rng, 60, 1)):
        run(f, [z])
        if n:
            np.testing.assert_allclose(f.K, f.G @ f.H.T, rtol=1e-9, atol=1e-12)


@pytest.mark.contract("small print")
def test_alpha_and_M_act_on_P_and_in_warm_up_only(ufir, column, rng):
    f, twin = constant_velocity(ufir, column), constant_velocity(ufir, column)
    f.alpha = 1.2
    f.M = np.array([[0.3], [0.1]])
    for n, z in enumerate(walk(rng, 60, 1)):
        f.predict()
        twin.predict()
        f.update_correlated(z)
        twin.update(z)
        if n:
            np.testing.assert_allclose(f.x, twin.x, rtol=1e-9, atol=1e-9)
    assert f.ready


@pytest.mark.contract("small print")
@pytest.mark.parametrize("z", [[np.inf, 1.0], [1.0, -np.inf], [np.nan, np.inf]], ids=str)
def test_an_infinite_measurement_is_refused_and_leaves_no_trace(ufir, column, rng, z):
    f, twin = plane(ufir, column), plane(ufir, column)
    for good in walk(rng, 30, 2):
        f.predict()
        twin.predict()
        with pytest.raises(ValueError, match="finite"):
            f.update(z)
        f.update(good)
        twin.update(good)
        np.testing.assert_array_equal(f.x, twin.x)


@pytest.mark.contract("small print")
@pytest.mark.parametrize(
    "R", [np.zeros((2, 2)), np.ones((2, 2)), np.diag([1.0, 0.0])], ids=["zero", "ones", "half"]
)
def test_a_singular_R_is_no_obstacle(ufir, column, R):
    f = plane(ufir, column)
    f.R = R
    states = trajectory(f.F, (1.0, 0.5, -3.0, -0.2), 60)
    for x in states:
        run(f, [x[::2]])
        assert np.isfinite(f.x).all()
        assert np.isfinite(f.P).all()
    np.testing.assert_allclose(flat(f.x), states[-1], atol=1e-5)


@pytest.mark.contract("small print")
@pytest.mark.parametrize("window", ["arrivals", "origins"])
def test_delayed_rows_join_the_window_at_their_origin(ufir, column, rng, window):
    """Rows 0 to 2 steps late, out of order, from the first step on: origins 0 and -1 lie before it."""
    f = constant_velocity(ufir, column, window=window)
    rows = []
    for n in range(1, 60):
        delay = int(rng.integers(3))
        rows.append((n, Row(n - delay, n - delay + rng.standard_normal(1), f.H.copy(), f.R.copy())))
        f.predict()
        f.update(rows[-1][1].z, delay=delay)
        inside = [
            row
            for arrival, row in rows
            if (row.origin if window == "origins" else arrival) > n - ufir.horizon
        ]
        if len({row.origin for row in inside}) >= min(4, ufir.horizon):  # else it may reach further back
            x, P = window_estimate(inside, f.F, f.Q, n)
            np.testing.assert_allclose(flat(f.x), x, rtol=1e-8, atol=1e-8)
            np.testing.assert_allclose(f.P, P, rtol=1e-7, atol=1e-8)


@pytest.mark.contract("small print")
def test_delayed_rows_in_warm_up_count_as_soon_as_the_state_is_determined(ufir, column):
    f = constant_velocity(ufir, column, x0=(100, 50))
    f.predict()
    f.predict()
    f.update(1.0, delay=1)
    assert not f.ready
    f.update(3.0)
    assert f.ready
    np.testing.assert_allclose(flat(f.x), [3.0, 2.0], rtol=1e-9)


@pytest.mark.contract("small print")
def test_rows_older_than_the_window_are_dropped_and_counted(ufir, column, rng):
    f, twin = (
        constant_velocity(ufir, column, window="origins"),
        constant_velocity(ufir, column, window="origins"),
    )
    for z in walk(rng, 60, 1):
        run(f, [z])
        run(twin, [z])
        f.update(1e6, delay=ufir.horizon)
        np.testing.assert_array_equal(f.x, twin.x)
    assert (f.dropped, twin.dropped) == (60, 0)


@pytest.mark.contract("small print")
@pytest.mark.parametrize("delay", [-1, 1.5, "late"])
def test_an_impossible_delay_is_refused(ufir, delay):
    f = constant_velocity(ufir)
    f.predict()
    with pytest.raises(ValueError, match="delay"):
        f.update(1.0, delay=delay)


def test_every_error_of_the_library_is_a_value_error():
    assert issubclass(UnobservableWindow, ufirext.UfirextError)
    assert issubclass(ufirext.UfirextError, ValueError)
