"""Known inputs on a full window are one constant product: what comes out is what step by step would."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.strategies import seeds
from ufirext import Model, UFIRFilter, kinematic
from ufirext.engines.plan import plan
from ufirext.filters._state import POSTED, SLOW, WATCHED

from .streams import MODELS, Stream, reference

PUBLISHED = ("x", "P", "x_prior", "P_prior", "x_post", "P_post", "y", "K", "S", "z", "log_likelihood")
B = {
    2: [[0.5], [1.0]],
    3: [[0.5, 0.0], [1.0, -1.0], [0.0, 2.0]],
    4: [[1.0, 0.0], [0.0, 0.0], [0.0, 1.0], [2.0, 1.0]],
}


def filter_of(model, horizon):
    f = UFIRFilter(model.dim_x, model.dim_z, horizon=horizon)
    f.F, f.H, f.Q, f.R, f.B = model.F, model.H, model.Q, model.R, np.array(B[model.dim_x])
    return f


def played(f, steps, rng, every=1):
    """Inputs at every step or at some."""
    for step in range(steps):
        f.predict(rng.normal(size=(f.B.shape[1], 1)) if step % every == 0 else None)
        f.update(rng.normal(size=(f.dim_z, 1)))
    return f


def edit(filters, rng):
    """x moved from outside, in place or assigned, sometimes twice."""
    delta, form = rng.normal(size=(filters[0].dim_x, 1)), rng.integers(4)
    for f in filters:
        if form in (0, 3):
            f.x[:] += delta
        if form == 1:
            f.x[-1] = delta[0]
        if form in (2, 3):
            f.x = f.x + delta


def hot(f):
    return f._state.mode in (POSTED, WATCHED) and f._state.ring.inputs is not None


@pytest.mark.parametrize("name", MODELS)
@given(seed=seeds, horizon=st.sampled_from([4, 5, 12]), edits=st.booleans())
def test_every_published_field_is_that_of_the_slow_path(name, horizon, seed, edits):
    """Some steps with u, some without; x unread, read before or after update(), edited, assigned; rows lost,
    late, weighted.
    """
    rng, model = np.random.default_rng(seed), MODELS[name]
    quick, slow = filter_of(model, horizon), filter_of(model, horizon)
    size, been_hot = quick.B.shape[1], False
    for step in range(6 * horizon + 20):
        u = rng.normal(size=(size, 1)) if rng.random() < 0.7 else None
        if u is not None and rng.random() < 0.3:
            u = [u[:, 0], u.tolist(), 0.0][rng.integers(3)]
        z = step * 0.1 + rng.normal(size=(model.dim_z, 1))
        given = [(z,), (None,), (z, 2.0 * model.R), (z, model.R, model.H)]
        kind = rng.integers(4) if rng.random() < 0.04 else 0
        for f in (quick, slow):
            f.predict(u)
        assert slow.P is not None  # looking at P leaves the hot path at every step
        if rng.random() < 0.2:
            np.testing.assert_allclose(quick.x, slow.x, rtol=1e-9, atol=1e-9, err_msg=f"prior, step {step}")
        if edits and rng.random() < 0.03:
            edit((quick, slow), rng)
        for f in (quick, slow):
            f.update(*given[kind])
        been_hot |= hot(quick)
        assert slow.P is not None
        if edits and rng.random() < 0.5:
            edit((quick, slow), rng)
        if rng.random() < 0.05:
            quick = copy.deepcopy(quick) if rng.random() < 0.5 else pickle.loads(pickle.dumps(quick))
        if rng.random() < 0.1:
            for which in PUBLISHED:
                ours, theirs = (np.array(getattr(f, which), dtype=float) for f in (quick, slow))
                np.testing.assert_allclose(ours, theirs, rtol=1e-8, atol=1e-8, err_msg=f"{which} at {step}")
    assert been_hot or horizon == 12


def test_the_hot_path_holds_over_many_laps_and_does_not_drift():
    rng = np.random.default_rng(3)
    f = played(filter_of(kinematic(1, 2, 0.1, q=0.5, r=1.0), 10), 20, rng)
    assert hot(f)
    for _ in range(5_000):
        f.predict(rng.normal(size=(2, 1)))
        assert f._state.mode != SLOW
        f.update(rng.normal(size=(2, 1)))
    fresh = filter_of(kinematic(1, 2, 0.1, q=0.5, r=1.0), 10)
    fresh._state = reference(kinematic(1, 2, 0.1, q=0.5, r=1.0), 10)._state
    fresh.B = np.array(B[4])
    rng = np.random.default_rng(4)
    again = np.random.default_rng(4)
    played(f, 10, rng)
    played(fresh, 10, again)
    np.testing.assert_allclose(f.x, fresh.x, rtol=0, atol=1e-12)


@pytest.mark.parametrize("gap", [1, 3, 9, 10, 11, 12, 40, 700])
def test_looking_brings_the_ring_up_to_date_however_long_it_waited(gap):
    """P, K or S read after so many hot steps: the ring then says what it would have said all along."""
    model = kinematic(1, 1, 0.1, q=0.5, r=1.0)
    f, slow = filter_of(model, 10), filter_of(model, 10)
    rngs = np.random.default_rng(gap), np.random.default_rng(gap)
    for g, rng in zip((f, slow), rngs, strict=True):
        played(g, 30, rng)
    for _ in range(3):
        played(f, gap, rngs[0])
        for _ in range(gap):
            played(slow, 1, rngs[1])
            assert slow.P is not None
        for which in PUBLISHED:
            np.testing.assert_allclose(getattr(f, which), getattr(slow, which), rtol=1e-9, atol=1e-11)
        for lag in (1, 9):
            for ours, theirs in zip(f.smoothed(lag), slow.smoothed(lag), strict=True):
                np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-11)
        for g, rng in zip((f, slow), rngs, strict=True):
            g.predict([0.3])
            g.update(rng.normal(size=1), delay=2)  # a late row finds its place


def test_inputs_that_are_over_are_forgotten():
    f = played(filter_of(kinematic(1, 1, 0.1, q=0.5, r=1.0), 5), 20, np.random.default_rng(0))
    for step in range(2_000):
        f.predict()
        f.update(0.1 * step)
    assert f._state.ring.inputs is None
    np.testing.assert_allclose(f.x.ravel(), [199.9, 1.0], rtol=1e-10)


def test_edits_of_x_are_known_changes_too():
    """Edited, assigned, edited and assigned at every step: the hot path holds, and x moves by just that."""
    model = kinematic(1, 1, 0.1, q=0.5, r=1.0)
    f = played(filter_of(model, 5), 20, np.random.default_rng(0))
    for step in range(600):
        x = f.x.copy()
        if step % 2:
            f.x[0] += 3.0
        if step % 3:
            f.x = f.x + np.array([[0.0], [0.1]])
        np.testing.assert_allclose(f.x - x, [[3.0 * (step % 2)], [0.1 * (step % 3 > 0)]], rtol=0, atol=1e-9)
        x = f.x.copy()
        f.predict([0.5])
        assert f._state.mode != SLOW
        np.testing.assert_allclose(f.x, model.F @ x + [[0.25], [0.5]], rtol=1e-12, atol=1e-9)
        f.update(f.x[0])
        assert hot(f)


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_an_edit_to_what_is_no_number_is_refused_at_the_next_verb(wrong):
    f = played(filter_of(kinematic(1, 1, 0.1, q=0.5, r=1.0), 5), 20, np.random.default_rng(0))
    assert hot(f)
    f.x[0] = wrong
    with pytest.raises(ValueError, match="x must be finite"):
        f.predict([1.0])
    g = played(filter_of(kinematic(1, 1, 0.1, q=0.5, r=1.0), 5), 20, np.random.default_rng(0))
    with pytest.raises(ValueError, match="x must be finite"):
        g.x = np.array([[wrong], [0.0]])
    assert np.isfinite(g.x).all()


def test_who_looks_at_P_at_every_step_is_spared_the_coming_and_going():
    f = played(filter_of(kinematic(1, 1, 0.1, q=0.5, r=1.0), 5), 20, np.random.default_rng(0))
    been = 0
    for _ in range(300):
        played(f, 1, np.random.default_rng(1))
        been += hot(f)
        assert f.P is not None
    assert been < 12
    played(f, 100, np.random.default_rng(1))
    assert hot(f)


@pytest.mark.parametrize("u", [[np.nan], [np.inf], [1.0, 2.0], "left", [[1j]]])
def test_an_input_that_is_none_is_refused_with_reasons_and_nothing_lost(u):
    f = played(filter_of(kinematic(1, 1, 0.1, q=0.5, r=1.0), 5), 20, np.random.default_rng(0))
    twin = copy.deepcopy(f)
    with pytest.raises(ValueError, match="u must"):
        f.predict(u)
    for g in (f, twin):
        g.predict([1.0])
        g.update(3.0)
    np.testing.assert_allclose(f.x, twin.x, rtol=0, atol=1e-12)


def test_an_input_matrix_written_later_counts_from_then_on():
    """Edits of a B that the client holds, a B for one call, another B, none at all."""
    model = kinematic(1, 1, 0.1, q=0.5, r=1.0)
    for change in ("edit", "call", "assign", "none"):
        f = played(filter_of(model, 5), 20, np.random.default_rng(0))
        held = f.B if change == "edit" else None
        played(f, 9, np.random.default_rng(1))
        prior = model.F @ f.x
        u, given = np.array([[2.0]]), None
        if held is not None:
            assert hot(f)
            held[1, 0] = 7.0
        elif change == "call":
            given = np.array([[0.5], [7.0]])
        else:
            f.B = None if change == "none" else np.array([[0.5], [7.0]])
        f.predict(u, given)
        expected = prior if change == "none" else prior + np.array([[1.0], [14.0]])
        np.testing.assert_allclose(f.x, expected, rtol=0, atol=1e-12, err_msg=change)


@given(seed=seeds, horizon=st.integers(4, 30))
def test_the_gain_on_inputs_is_that_of_rational_arithmetic(seed, horizon):
    """D_j = F^(N-1-j) - sum of G_i H F^(i-j) over i >= j, term by term; the oldest input says nothing."""
    rng = np.random.default_rng(seed)
    F = np.array([[rng.uniform(0.8, 1.05), 0.1], [rng.uniform(-0.1, 0.1), 0.95]])
    model = Model(F, [[1.0, 0.0]], Q=np.eye(2), R=1.0)
    both = plan(model, horizon).driven
    assert both is not None
    both = both.reshape(2, horizon, 3)
    powers = [np.linalg.matrix_power(F, k) for k in range(horizon)]
    for j in range(horizon):
        D = powers[horizon - 1 - j] - sum(both[:, i, :1] @ model.H @ powers[i - j] for i in range(j, horizon))
        np.testing.assert_allclose(both[:, j, 1:], D, rtol=0, atol=1e-12)


def test_a_model_that_forgets_no_rounding_stays_on_the_slow_path():
    """An unstable mode over 500 steps multiplies rounding by 4e10: then steps one by one are right."""
    model = MODELS["unstable"]
    assert plan(model, 20).driven is not None
    assert plan(model, 500).driven is None
    rng = np.random.default_rng(0)
    f = played(filter_of(model, 500), 600, rng)
    assert not hot(f)


def test_streams_of_inputs_run_hot():
    stream = Stream(MODELS["plane"], [reference(MODELS["plane"], 6), filter_of(MODELS["plane"], 6)],
                    np.random.default_rng(0), {"input": 0.5})  # fmt: skip
    for f in stream.filters:
        f.B = np.eye(4)
    for _ in range(60):
        stream.step()
    assert hot(stream.filters[1])
    np.testing.assert_allclose(stream.filters[1].x, stream.filters[0].x, rtol=0, atol=1e-10)
