"""A fleet is many UFIRFilters: the same numbers, tick by tick, whatever the network does."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

from tests.engines.streams import MODELS
from tests.fleet.fleets import Peers, Traffic, assert_close, play
from ufirext import (
    Fleet,
    HorizonError,
    Model,
    NonFiniteError,
    ShapeError,
    UfirextError,
    UFIRFilter,
    UnobservableWindow,
    best_horizon,
    kinematic,
)

PLANE = MODELS["plane"]
NETWORKS = {
    "all come": {},
    "some lost": {"lost": 0.2},
    "most lost": {"lost": 0.65},
    "components lost": {"lost": 0.1, "component": 0.25},
    "some late": {"lost": 0.1, "late": 0.3},
}


@pytest.mark.parametrize("missing", ["extend", "skip"])
@pytest.mark.parametrize("network", NETWORKS)
@pytest.mark.parametrize("name", sorted(MODELS))
def test_a_fleet_gives_every_track_the_numbers_of_its_own_filter(name, network, missing):
    model = MODELS[name]
    play(model, 7, Traffic(model, 4, 40, seed=3, **NETWORKS[network]), missing)


@pytest.mark.parametrize("horizon", [2, 3, 20])
def test_short_and_long_windows(horizon):
    play(MODELS["velocity"], horizon, Traffic(MODELS["velocity"], 3, 60, lost=0.3))


@pytest.mark.parametrize("horizon", [10, 40])
def test_normal_equations_lose_no_digits_on_few_rows_far_from_the_origin(horizon):
    """Without the step of correction the error is 4e-12 here."""
    traffic = Traffic(MODELS["acceleration"], 12, 70, seed=horizon, lost=0.7)
    traffic.Z += 1e3
    play(MODELS["acceleration"], horizon, traffic)


def test_correlated_noises_and_lost_components():
    model = PLANE.replace(R=[[4.0, 1.5], [1.5, 1.0]])
    play(model, 6, Traffic(model, 4, 40, lost=0.2, component=0.3, late=0.2))


def test_a_component_that_sees_no_state_changes_nothing():
    model = Model(PLANE.F, np.vstack([PLANE.H, np.zeros(4)]), Q=PLANE.Q, R=np.diag([4.0, 4.0, 1.0]) + 0.1)
    play(model, 6, Traffic(model, 3, 30, lost=0.2, component=0.2))


@pytest.mark.parametrize("missing", ["extend", "skip"])
def test_gaps_of_every_length(missing):
    """Coasting, reaching back, being lost, and starting anew."""
    model = MODELS["velocity"]
    traffic = Traffic(model, 8, 130)
    for track, length in enumerate((0, 1, 3, 5, 8, 20, 60, 75)):
        traffic.Z[20 : 20 + length, track] = np.nan
    traffic.Z[21::2, 1] = np.nan
    play(model, 5, traffic, missing)


def test_a_gap_beyond_reach_makes_a_track_start_anew():
    model = MODELS["velocity"]
    fleet = Fleet(model, 5, 1)
    for n in range(10):
        fleet.step([[float(n)]])
    ticks = 0
    while fleet.ready.all():
        fleet.step([[np.nan]])
        ticks += 1
    assert ticks == fleet.reach - 4, "the oldest of five rows is beyond reach then"
    assert np.isnan(fleet.covariance()).all()
    assert np.isnan(fleet.step([[np.nan]])).all()
    fleet.step([[0.0]])
    assert_close(fleet.step([[1.0]]), [[1.0, 1.0]], 1e-12)


def test_one_track():
    play(MODELS["acceleration"], 9, Traffic(MODELS["acceleration"], 1, 40, lost=0.1))


def test_no_track_at_all():
    fleet = Fleet(PLANE, 5, 0)
    assert fleet.step(np.empty((0, 2))).shape == (0, 4)
    assert fleet.covariance().shape == (0, 4, 4)
    assert fleet.join(2).tolist() == [0, 1]


def test_before_enough_rows_nothing_is_ready_and_nothing_is_invented():
    fleet = Fleet(PLANE, 10, 2)
    assert np.isnan(fleet.x).all()
    X = fleet.step([[1.0, 2.0], [np.nan, np.nan]])
    assert np.isnan(X).all()
    assert not fleet.ready.any()
    assert np.isnan(fleet.covariance()).all()
    X = fleet.step([[1.0, 2.0], [np.nan, np.nan]])
    assert fleet.ready.tolist() == [True, False]
    assert np.isfinite(X[0]).all()


def test_tracks_that_never_send_anything_cost_no_memory_beyond_the_window():
    traffic = Traffic(PLANE, 4, 50)
    traffic.Z[:, 1] = np.nan
    fleet = play(PLANE, 6, traffic)
    assert not fleet._engine.history.older


def test_older_ticks_are_forgotten_once_no_track_needs_them():
    fleet, traffic = Fleet(PLANE, 6, 3), Traffic(PLANE, 3, 60)
    traffic.Z[20:40, 0] = np.nan
    sizes = []
    for Z in traffic.Z:
        fleet.step(Z)
        sizes.append(fleet.nbytes)
    assert max(sizes) > sizes[10]
    assert sizes[-1] == sizes[10]


def test_ragged_tracks_join_and_leave_at_any_time():
    model, horizon, rng = PLANE, 6, np.random.default_rng(5)
    fleet, peers = Fleet(model, horizon, 2), {0: Peers(model, horizon, 1), 1: Peers(model, horizon, 1)}
    for n in range(120):
        if n % 7 == 3:
            for slot in fleet.join(int(rng.integers(1, 3))).tolist():
                assert slot not in peers
                peers[slot] = Peers(model, horizon, 1)
        if n % 11 == 5 and peers:
            gone = rng.permutation(sorted(peers))[:2]
            fleet.leave(gone)
            for slot in gone.tolist():
                del peers[slot]
        Z = np.full((fleet.tracks, 2), np.nan)
        slots = sorted(peers)
        Z[slots] = rng.normal(size=(len(slots), 2)).cumsum(axis=0)
        Z[rng.random(len(Z)) < 0.15] = np.nan
        X = fleet.step(Z)
        for slot, peer in peers.items():
            peer.step(Z[slot : slot + 1])
            assert_close(X[slot : slot + 1], peer.x, 1e-12)
        assert fleet.active.sum() == len(peers)
        assert not fleet.ready[~fleet.active].any()
        assert np.isnan(X[~fleet.active]).all()


@pytest.mark.parametrize("missing", ["extend", "skip"])
@pytest.mark.parametrize("empty", [0, 1, 3, 9])
def test_a_slot_that_stood_empty_is_as_good_as_a_new_one(empty, missing):
    """A neighbour whose windows stay full takes the quick way as soon as nobody needs another."""
    model, rng = MODELS["velocity"], np.random.default_rng(empty)
    fleet, neighbour = Fleet(model, 6, 2, missing=missing), Peers(model, 6, 1, missing=missing)
    peer = Peers(model, 6, 1, missing=missing)
    for n in range(30):
        if n == 9:
            fleet.leave(1)
        if n == 9 + empty:
            assert fleet.join().tolist() == [1]
            peer = Peers(model, 6, 1, missing=missing)
        Z = rng.normal(size=(2, 1))
        if not fleet.active[1]:
            Z[1] = np.nan
        X = fleet.step(Z)
        neighbour.step(Z[:1])
        assert_close(X[:1], neighbour.x, 1e-12)
        if fleet.active[1]:
            peer.step(Z[1:])
            assert_close(X[1:], peer.x, 1e-12)
            assert fleet.ready[1] == peer.ready[0]
            assert_close(fleet.covariance(1), peer.P, 1e-9)
    assert fleet.ready.all()


def test_free_slots_are_taken_before_new_ones():
    fleet = Fleet(PLANE, 5, 4)
    fleet.leave([1, 3])
    assert fleet.join(3).tolist() == [1, 3, 4]
    assert fleet.tracks == 5


def test_rows_later_than_any_window_reaches_are_dropped_and_counted():
    fleet = Fleet(MODELS["velocity"], 4, 2, missing="skip")
    peer = Peers(MODELS["velocity"], 4, 2, missing="skip")
    for n in range(12):
        delay = np.array([4, 0]) if n % 3 == 2 else np.array([0, 3 if n > 3 else 0])
        Z = np.array([[1.0 * n], [2.0 * n]])
        X = fleet.step(Z, delay)
        peer.step(Z, delay)
        assert_close(X, peer.x, 1e-12)
    assert fleet.dropped.tolist() == [f.dropped for f in peer.filters] == [4, 0]


def test_one_delay_for_all_is_the_delay_of_each():
    a, b, rng = Fleet(PLANE, 6, 3), Fleet(PLANE, 6, 3), np.random.default_rng(0)
    for _ in range(12):
        Z = rng.normal(size=(3, 2))
        np.testing.assert_array_equal(a.step(Z, 2), b.step(Z, [2, 2, 2]))


def test_a_constant_delay_shifts_the_estimate_by_the_model():
    rng, k = np.random.default_rng(1), 3
    now, late = Fleet(PLANE, 6, 5), Fleet(PLANE, 6, 5)
    shift = np.linalg.matrix_power(PLANE.F, k).T
    for _ in range(20):
        Z = rng.normal(size=(5, 2))
        assert_close(late.step(Z, k), now.step(Z) @ shift, 1e-11)


@pytest.mark.parametrize("horizon", [5, 30])
def test_single_precision_stays_single_and_follows_double(horizon):
    traffic = Traffic(PLANE, 6, 60, lost=0.2)
    single, double = Fleet(PLANE, horizon, 6), Fleet(PLANE, horizon, 6)
    for Z in traffic.Z:
        X, reference = single.step(Z.astype(np.float32)), double.step(Z)
        assert X.dtype == np.float32
        np.testing.assert_array_equal(np.isnan(X), np.isnan(reference))
        np.testing.assert_allclose(X, reference, rtol=2e-3, atol=2e-3)


def test_arrays_of_any_layout_and_lists_are_the_same_measurements():
    rng = np.random.default_rng(0)
    wide = rng.normal(size=(12, 8, 6))
    fleets = [Fleet(PLANE, 4, 4) for _ in range(4)]
    for frame in wide:
        Z = frame[::2, 1:6:4]
        forms = (Z, np.asfortranarray(Z), Z.tolist(), np.ascontiguousarray(Z)[::-1][::-1])
        first, *others = (f.step(form) for f, form in zip(fleets, forms, strict=True))
        for X in others:
            np.testing.assert_array_equal(X, first)


@pytest.mark.parametrize("dtype", [float, np.float32, int])
def test_masked_entries_are_missing(dtype):
    traffic = Traffic(PLANE, 3, 30, lost=0.2, component=0.2)
    masked, marked = Fleet(PLANE, 5, 3), Fleet(PLANE, 5, 3)
    for n, Z in enumerate(traffic.Z):
        hidden = np.isnan(Z)
        values = np.where(hidden, 7.0, Z).astype(dtype)
        rows = np.ma.array(values, mask=hidden)
        X = masked.step(list(rows) if n % 2 and dtype is not np.float32 else rows)
        np.testing.assert_array_equal(X, marked.step(np.where(hidden, np.nan, values)))
    assert X.dtype == (np.float32 if dtype is np.float32 else float)
    with pytest.raises(NonFiniteError, match="delay must have no masked entries"):
        masked.step(values, np.ma.array([0, 1, 0], mask=[0, 1, 0]))


def test_what_step_returns_is_the_callers_own():
    traffic = Traffic(PLANE, 3, 30, lost=0.3)
    spoiled, clean = Fleet(PLANE, 5, 3), Fleet(PLANE, 5, 3)
    for Z in traffic.Z:
        mine, given = spoiled.step(Z), Z.copy()
        np.testing.assert_array_equal(mine, clean.step(given))
        mine[:] = 1e9
        Z[:] = 1e9
        np.testing.assert_array_equal(spoiled.x, clean.x)


@pytest.mark.parametrize("clone", [copy.deepcopy, lambda f: pickle.loads(pickle.dumps(f))])
@pytest.mark.parametrize("late", [0.0, 0.2])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("at", [0, 3, 25])
def test_a_copy_goes_on_independently_with_the_same_numbers(at, dtype, late, clone):
    traffic = Traffic(PLANE, 5, 45, lost=0.3, late=late)
    fleet, untouched = Fleet(PLANE, 6, 5), Fleet(PLANE, 6, 5)
    for Z, delay in zip(traffic.Z[:at], traffic.delays[:at], strict=True):
        fleet.step(Z.astype(dtype), delay)
        untouched.step(Z.astype(dtype), delay)
    twin = clone(fleet)
    assert repr(twin) == repr(fleet)
    for Z, delay in zip(traffic.Z[at:], traffic.delays[at:], strict=True):
        X = untouched.step(Z.astype(dtype), delay)
        np.testing.assert_array_equal(fleet.step(Z.astype(dtype), delay), X)
    for Z, delay in zip(traffic.Z[at:], traffic.delays[at:], strict=True):
        Y = twin.step(Z.astype(dtype), delay)
    assert Y.dtype == X.dtype == dtype
    np.testing.assert_array_equal(Y, X)
    np.testing.assert_array_equal(twin.covariance(), fleet.covariance())
    twin.join(3)
    assert fleet.tracks == 5


def test_many_blocks_of_tracks_are_as_good_as_one(monkeypatch):
    traffic = Traffic(PLANE, 30, 25, lost=0.3, late=0.1)
    whole, parts = Fleet(PLANE, 5, 30), Fleet(PLANE, 5, 30)
    for Z, delay in zip(traffic.Z, traffic.delays, strict=True):
        X = whole.step(Z, delay)
        monkeypatch.setattr("ufirext.fleet.engine.BLOCK", 7)
        Y = parts.step(Z, delay)
        monkeypatch.undo()
        assert_close(Y, X, 1e-13)


def test_auto_is_the_best_horizon_of_the_model():
    model = kinematic(1, 1, 1.0, q=0.01, r=100.0)
    assert Fleet(model, "auto", 1).horizon == best_horizon(model)


def test_a_long_unstable_window_is_as_good_as_the_filters():
    model = MODELS["unstable"]
    play(model, 300, Traffic(model, 3, 60, lost=0.2, late=0.2))


class TestRefusals:
    def test_arguments(self):
        with pytest.raises(UnobservableWindow, match="at least 2"):
            Fleet(PLANE, 1, 3)
        with pytest.raises(HorizonError, match="horizon must be"):
            Fleet(PLANE, "adaptive", 3)
        for missing in ("predict", np.array(["extend", "skip"])):
            with pytest.raises(UfirextError, match="missing must be one of"):
                Fleet(PLANE, 5, 3, missing=missing)
        with pytest.raises(UfirextError, match=r"model must be a ufirext\.Model"):
            Fleet("plane", 5, 3)
        with pytest.raises(ShapeError, match="tracks must be at least 0"):
            Fleet(PLANE, 5, -1)
        with pytest.raises(ShapeError, match=r"count must be an integer, got 1\.0"):
            Fleet(PLANE, 5, 1).join(1.0)

    def test_measurements(self):
        fleet = Fleet(PLANE, 5, 3)
        with pytest.raises(ShapeError, match=r"Z must have shape \(3, 2\) \(tracks, dim_z\), got \(2, 3\)"):
            fleet.step(np.zeros((2, 3)))
        with pytest.raises(NonFiniteError, match="Z must be finite"):
            fleet.step([[1.0, np.inf], [0.0, 0.0], [0.0, 0.0]])
        with pytest.raises(ShapeError, match="Z must hold float32"):
            fleet.step(np.zeros((3, 2), dtype=complex))
        for wrong in ("1", b"1", np.datetime64("NaT"), np.timedelta64(1, "ns"), 10**400):
            with pytest.raises(UfirextError, match="Z must"):
                fleet.step([[1.0, wrong], [0.0, None], [0.0, 0.0]])
        assert fleet.ticks == 0, "a refused tick did not happen"

    @pytest.mark.parametrize(
        "delay", [1.0, [1, 2], [[0, 0, 0]], -1, [0, -2, 0], np.uint64(2**63), [0, 2**63, 1]]
    )
    def test_delays(self, delay):
        with pytest.raises(HorizonError, match="delay must be"):
            Fleet(PLANE, 5, 3).step(np.zeros((3, 2)), delay)

    def test_slots(self):
        fleet = Fleet(PLANE, 5, 3)
        fleet.leave(1)
        with pytest.raises(UfirextError, match="slot 1 holds no track"):
            fleet.leave(1)
        with pytest.raises(UfirextError, match="slot 1: join"):
            fleet.step(np.zeros((3, 2)))
        with pytest.raises(UfirextError, match=r"0 \.\. 2"):
            fleet.covariance([3])
        with pytest.raises(ShapeError, match="slots must be integers"):
            fleet.leave([0.5])

    def test_dask_arrays_belong_to_distributed(self):
        dask = pytest.importorskip("dask.array")
        with pytest.raises(UfirextError, match=r"ufirext\.distributed"):
            Fleet(PLANE, 5, 3).step(dask.zeros((3, 2)))


def test_a_repr_tells_what_is_there():
    text = repr(Fleet(PLANE, 5, 3))
    assert "horizon=5, tracks=3" in text
    assert "ready=0" in text


def test_the_filter_of_the_docstring_is_the_drop_in():
    """One track of a fleet and UFIRFilter, without the helpers of this module."""
    fleet, f = Fleet(PLANE, 8, 1), UFIRFilter(4, 2, horizon=8)
    f.F, f.H, f.Q, f.R = PLANE.F, PLANE.H, PLANE.Q, PLANE.R
    for z in np.random.default_rng(2).normal(size=(30, 2)).cumsum(axis=0):
        f.predict()
        f.update(z)
        X = fleet.step(z[None])
    assert_close(X, f.x.reshape(1, 4), 1e-12)
    assert_close(fleet.covariance(0), f.P[None], 1e-12)
