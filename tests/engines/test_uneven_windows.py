"""Late, weighted and lost rows that wait in the hot path are what the slow path makes of them at once."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.strategies import seeds
from ufirext import Model, UFIRFilter, kinematic, ufir_gain
from ufirext.engines import basis as basis_module
from ufirext.engines.basis import Basis, Memory
from ufirext.engines.plan import Plan
from ufirext.engines.ring import Ring
from ufirext.filters._state import SLOW

from .streams import fresh, reference

PUBLISHED = ("x", "P", "x_prior", "P_prior", "x_post", "P_post", "y", "K", "S", "z", "R", "log_likelihood")
COUNTED = ("rows", "dropped", "ready")

# Probabilities per packet (weight, late, twice) or per step (lost, none, edit, copy, pickle).
NETWORKS = {
    "late": {"late": 0.3},
    "lost": {"lost": 0.2, "none": 0.2},
    "weighted": {"weight": 0.7},
    "late and weighted": {"late": 0.3, "weight": 0.5, "none": 0.1},
    "bursts": {"lost": 0.7, "late": 0.1},
    "twice": {"late": 0.3, "twice": 0.1, "old": 0.03},
    "read and edited": {"late": 0.2, "lost": 0.1, "edit": 0.04},
    "copied": {"late": 0.2, "weight": 0.2, "none": 0.1, "copy": 0.1, "pickle": 0.05},
    "all": {
        "late": 0.3, "lost": 0.1, "none": 0.1, "weight": 0.2, "twice": 0.05, "old": 0.02,
        "edit": 0.01, "copy": 0.03, "pickle": 0.02,
    },
}  # fmt: skip


def slow(f: UFIRFilter) -> UFIRFilter:
    """The same filter, which never goes over to the hot path."""
    f._state.warm = lambda: None
    return f


def packets(rng: np.random.Generator, steps: int, chances: dict[str, float], axes: int, R: np.ndarray):
    """What arrives at each step: (z, R or None, delay), in any order."""
    arrivals: list[list[tuple[np.ndarray | None, np.ndarray | None, int]]] = [[] for _ in range(steps)]
    for origin in range(steps):
        if rng.random() < chances.get("lost", 0.0):
            continue
        z = origin + rng.normal(size=(axes, 1))
        if rng.random() < 0.2:
            z = z[:, 0]
        own = rng.uniform(0.3, 3.0) * R if rng.random() < chances.get("weight", 0.0) else None
        late = rng.random() < chances.get("late", 0.0)
        delay = int(rng.integers(1, 4)) if late else 0
        if rng.random() < chances.get("old", 0.0):
            delay = int(rng.integers(1, 200))
        for _ in range(2 if rng.random() < chances.get("twice", 0.0) else 1):
            if origin + delay < steps:
                arrivals[origin + delay].append((z, own, delay))
    for packet in arrivals:
        rng.shuffle(packet)
        if rng.random() < chances.get("none", 0.0):
            packet.insert(int(rng.integers(0, len(packet) + 1)), (None, None, 0))
    return arrivals


def assert_same(hot: UFIRFilter, other: UFIRFilter, names, tolerance: float, step: int) -> None:
    for name in names:
        ours, theirs = (np.array(getattr(f, name), dtype=float) for f in (hot, other))  # None is NaN
        np.testing.assert_allclose(ours, theirs, rtol=tolerance, atol=tolerance, err_msg=f"{name}, {step}")


@pytest.mark.parametrize("window", ["arrivals", "origins"])
@pytest.mark.parametrize("network", NETWORKS)
@pytest.mark.parametrize(("order", "axes"), [(1, 1), (1, 2), (2, 1), (0, 3)])
@given(seed=seeds, horizon=st.integers(3, 14))
@settings(max_examples=12)
def test_putting_off_what_networks_do_changes_nothing(order, axes, network, window, seed, horizon):
    rng, chances = np.random.default_rng(seed), NETWORKS[network]
    model = kinematic(order, axes, 0.5, q=0.3, r=2.0)
    horizon = max(horizon, order + 2)
    hot, other = fresh(model, horizon, window=window), slow(fresh(model, horizon, window=window))
    steps = 5 * horizon + 40
    for step, arrived in enumerate(packets(rng, steps, chances, axes, model.R)):
        for f in (hot, other):
            f.predict()
        if rng.random() < 0.1:
            assert_same(hot, other, ["x"], 1e-9, step)  # before the rows of the step
        for z, R, delay in arrived:
            for f in (hot, other):
                f.update(z, R, delay=delay)
            if rng.random() < 0.1:
                assert_same(hot, other, ["x"], 1e-9, step)  # between two rows
        if rng.random() < 0.5:
            assert_same(hot, other, ["x"], 1e-9, step)
        if rng.random() < chances.get("edit", 0.0):
            for f in (hot, other):
                f.x[0] += 1.0
        if rng.random() < chances.get("copy", 0.0):
            hot = copy.deepcopy(hot)
        if rng.random() < chances.get("pickle", 0.0):
            hot = pickle.loads(pickle.dumps(hot))
        if rng.random() < 0.1:
            assert_same(hot, other, COUNTED if rng.random() < 0.5 else (), 0.0, step)
            assert_same(hot, other, rng.permutation(PUBLISHED), 1e-8, step)


@pytest.mark.parametrize("network", ["late", "lost", "weighted", "late and weighted"])
def test_networks_do_not_leave_the_hot_path(network):
    model, rng = kinematic(1, 2, 0.5, q=0.3, r=2.0), np.random.default_rng(5)
    f = fresh(model, 12)
    modes = []
    for arrived in packets(rng, 400, NETWORKS[network], 2, model.R):
        f.predict()
        for z, R, delay in arrived:
            f.update(z, R, delay=delay)
        assert np.isfinite(f.x).all()
        modes.append(f._state.mode)
    assert modes[50:].count(SLOW) < 10


def test_a_client_that_edits_an_array_it_was_given_long_ago_changes_nothing():
    model, rng = kinematic(1, 2, 0.5, q=0.3, r=2.0), np.random.default_rng(8)
    hot, other = fresh(model, 9), slow(fresh(model, 9))
    chances = {"late": 0.3, "weight": 0.5}
    for step, arrived in enumerate(packets(rng, 200, chances, 2, model.R)):
        old = [f.x for f in (hot, other)]
        for f in (hot, other):
            f.predict()
        for z, R, delay in arrived:
            old += [f.x for f in (hot, other)]
            for f in (hot, other):
                f.update(z, R, delay=delay)
        for x in old if step > 20 else ():  # by then every row publishes another x
            x[:] = np.nan
        if step % 7 == 0:
            assert_same(hot, other, PUBLISHED, 1e-8, step)


@pytest.mark.parametrize("network", ["late", "late and weighted"])
def test_once_the_network_is_quiet_a_late_past_is_forgotten(network):
    model, rng = kinematic(1, 1, 1.0, q=0.1, r=4.0), np.random.default_rng(3)
    f, records = fresh(model, 8), reference(model, 8)
    rough = packets(rng, 60, NETWORKS[network], 1, model.R)
    calm = packets(rng, 1500, {}, 1, model.R)
    zs = []
    for step, arrived in enumerate(rough + calm):
        for g in (f, records):
            g.predict()
            for z, R, delay in arrived:
                g.update(z, R, delay=delay)
        zs.extend(np.ravel(z) for z, _, _ in arrived)
        if step % 97 == 0:
            assert_same(f, records, PUBLISHED, 1e-6, step)
    assert f._state.ring.raw is None
    assert f._state.read is not None
    np.testing.assert_allclose(f.x.ravel(), ufir_gain(model, 8).K @ np.concatenate(zs[-8:]), rtol=1e-10)
    for g in (f, records):  # and the next loss finds what it needs
        g.predict()
        g.update(None)
        g.predict()
        g.update(7.0, delay=1)
    assert_same(f, records, PUBLISHED, 1e-6, -1)


def test_K_is_that_of_the_row_which_came_last_however_late():
    """Also where the window reaches back, and other engines get the rows of a step all at once."""
    model = kinematic(1, 1, 0.5, q=0.3, r=2.0)
    for seed in range(12):
        rng, f, records = np.random.default_rng(seed), fresh(model, 4), reference(model, 4)
        for step, arrived in enumerate(packets(rng, 50, {"late": 0.4}, 1, model.R)):
            for g in (f, records):
                g.predict()
                for z, R, delay in arrived:
                    g.update(z, R, delay=delay)
            np.testing.assert_allclose(f.K, records.K, rtol=1e-7, atol=1e-9, err_msg=f"{seed}, {step}")


def test_a_row_that_is_late_just_when_a_late_past_is_forgotten():
    model, rng = kinematic(1, 1, 1.0, q=0.1, r=4.0), np.random.default_rng(3)
    f, records = fresh(model, 5), reference(model, 5)
    late = moved = None
    for step in range(300):
        z = None if late else float(step + rng.normal())
        for g in (f, records):
            g.predict()
            if late:
                g.update(late, delay=1)
            elif z is not None and step not in (20, moved):
                g.update(z)
        late = z if step in (20, moved) else None
        ring = f._state.engine
        if isinstance(ring, Ring) and moved is None and ring.end == ring.capacity - 2:
            assert ring.spread == 1
            moved = step + 1  # this one comes a step later, when the buffer is full
        if step == 20 or (moved is not None and 0 <= step - moved < 12):
            assert_same(f, records, ["x", "rows"], 1e-7, step)  # P would leave the hot path
    assert moved is not None


@pytest.mark.parametrize("horizon", [9, 40])
def test_losses_that_recur_give_what_they_gave_the_first_time(horizon):
    """Gains remembered for a pattern of losses, against the records, long after the first one."""
    model, rng = kinematic(1, 2, 0.5, q=0.3, r=2.0), np.random.default_rng(horizon)
    f, records = fresh(model, horizon), reference(model, horizon)
    for step in range(12 * horizon):
        z = None if step % 3 == 1 or step % 7 == 2 else step + rng.normal(size=2)
        for g in (f, records):
            g.predict()
            g.update(z)
        np.testing.assert_allclose(f.x, records.x, rtol=1e-8)
    assert bool(f._state.ring.memory(horizon).known) == (horizon < 10)


ODD = Model(
    [[1.0, 0.3, 0.0], [0.0, 0.9, 0.1], [0.1, 0.0, 0.7]],
    [[1.0, 0.0, 0.0], [0.0, 1.0, 1.0]],
    Q=0.1,
    R=[[2.0, 0.5], [0.5, 1.0]],
)


@given(seed=seeds, length=st.integers(12, 60), long=st.booleans())
def test_solver_and_remembered_gain_are_the_least_squares_of_the_pattern(seed, length, long):
    """Also where the grams are factorised, and with a correlated R and a model without structure."""
    rng = np.random.default_rng(seed)
    model = kinematic(2, 3, 0.1, q=0.3, r=2.0) if long else ODD
    length += 200 * long
    basis, plan = Basis(model, length), Plan(model, length)
    assert (len(basis.grams) == 2) == long
    weights = (rng.random(length) < 0.7) * rng.uniform(0.3, 3.0, length)
    free = weights[:, None] * rng.normal(size=(length, model.dim_z))
    want = plan.pattern(weights.tobytes()).weighted_gain @ free.ravel()
    scale = np.abs(want).max()
    for columns in (False, True):
        x = basis.solver(columns)(weights, free.reshape(-1, 1) if columns else free.ravel())
        assert x is not None
        assert x.shape == ((model.dim_x, 1) if columns else (model.dim_x,))
        np.testing.assert_allclose(x.ravel(), want, rtol=0, atol=1e-9 * scale)
    np.testing.assert_allclose(basis.gain(weights) @ free.ravel(), want, rtol=0, atol=1e-9 * scale)


def test_normal_equations_refuse_windows_with_too_few_rows():
    basis = Basis(kinematic(2, 1, 0.1), 60)
    weights = np.zeros(60)
    weights[-3:] = 1.0  # three neighbours determine an acceleration, but hardly
    assert basis.solver()(weights, weights) is None
    assert basis.solver()(np.zeros(60), weights) is None


@pytest.mark.parametrize(("length", "spread"), [(6, 0), (40, 2)])
def test_a_memory_stays_within_its_room_and_gives_equal_bits_again(monkeypatch, length, spread):
    monkeypatch.setattr(basis_module, "MEMORY", 64 * (8 * 3 * length + 400))
    basis, rng = Basis(kinematic(1, 1, 1.0), length), np.random.default_rng(0)
    memory = Memory(basis, 2, spread)
    monkeypatch.setattr(memory, "room", 5)
    assert memory.recalls
    z, first = rng.normal(size=length), {}
    for _ in range(300):
        weights = np.ones(length)
        where = np.r_[0:spread, length - spread : length] if spread else np.arange(length)
        weights[where] = rng.random(len(where)) < 0.8
        product = memory.recall(weights.tobytes())
        assert len(memory.known) <= 5
        if product is not None:
            x = product(weights * z)
            np.testing.assert_allclose(x, basis.solver()(weights, weights * z), rtol=1e-9)
            np.testing.assert_array_equal(x, first.setdefault(weights.tobytes(), x))
    assert len(first) > 5


def test_a_memory_keeps_only_what_recurs():
    basis = Basis(kinematic(1, 1, 1.0), 40)
    weights = np.ones(40)
    weights[[1, -2]] = 0.0
    assert not Memory(basis, 2, 0).recalls  # random losses in a long window never do
    memory = Memory(basis, 2, 2)
    assert memory.recall(weights.tobytes()) is not None
    weights[20] = 0.0
    assert memory.recall(weights.tobytes()) is None
