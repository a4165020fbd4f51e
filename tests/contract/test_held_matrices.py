"""Model matrices that the client holds, reads and edits: verbs go by what is in them at that moment."""

from __future__ import annotations

import numpy as np
import pytest

from ufirext import DelayHInfinityFilter, DelayKalmanFilter, FMSFilterSmoother, UFIRFilter
from ufirext.filters._checks import Square
from ufirext.filters._live import Live

STEPS = 260
MODEL = {
    "F": np.array([[1.0, 1.0], [0.0, 1.0]]),
    "H": np.array([[1.0, 0.0]]),
    "Q": np.array([[0.02, 0.01], [0.01, 0.04]]),
    "R": np.array([[0.5]]),
}
FILTERS = {
    "UFIR": lambda: UFIRFilter(2, 1, horizon=5),
    "UFIR origins": lambda: UFIRFilter(2, 1, horizon=5, window="origins"),
    "UFIR skip": lambda: UFIRFilter(2, 1, horizon=5, missing="skip"),
    "UFIR auto": lambda: UFIRFilter(2, 1),
    "UFIR adaptive": lambda: UFIRFilter(2, 1, horizon="adaptive"),
    "UFIR late": lambda: UFIRFilter(2, 1, horizon=5, max_delay=3),
    "FMS late": lambda: FMSFilterSmoother(2, 1, horizon=5, lag=2, max_delay=3),
    "Kalman late": lambda: DelayKalmanFilter(2, 1, max_delay=3),
    "FMS": lambda: FMSFilterSmoother(2, 1, horizon=5, lag=2),
    "Kalman": lambda: DelayKalmanFilter(2, 1),
    "H-infinity": lambda: DelayHInfinityFilter(2, 1, theta=0.001),
}


def _set_up(f, held):
    for name, value in MODEL.items():
        setattr(f, name, value.copy())
        if name in held:
            held[name] = getattr(f, name)


def _told(twin, now):
    """The twin is told every change by assignment, of an array that nobody can edit."""
    for name, value in now.items():
        if not np.array_equal(getattr(twin._state, name).value, value):
            frozen = value.copy()
            frozen.setflags(write=False)
            setattr(twin, name, frozen)


def _edited(rng, array):
    """Another entry for the same array, as a client would write it."""
    other = array.copy()
    if len(array) == 1 or (array.shape == (2, 2) and array[0, 1] == array[1, 0]):
        other *= rng.uniform(0.6, 1.6)
    else:
        other[0, 1] = rng.uniform(0.6, 1.4)
    return other


def _outside(rng, f, held, often):
    """What a client does between two verbs: look, edit, edit and take back, assign what is there already."""
    for name, array in held.items():
        if rng.random() > often:
            continue
        kind = rng.integers(5)
        if kind == 0:
            array[...] = _edited(rng, array)
        elif kind == 1:
            before = array.copy()
            array += 1.0
            array[...] = before
        elif kind == 2:
            assert np.array_equal(getattr(f, name), array)
        elif kind == 3:
            setattr(f, name, array)
        else:
            fresh = array.copy()
            setattr(f, name, fresh)
            held[name] = fresh


@pytest.mark.parametrize("often", [0.0, 0.004, 0.05])
@pytest.mark.parametrize("names", ["F", "H", "Q", "R", "FH", "FHQR"])
@pytest.mark.parametrize("kind", FILTERS)
def test_every_verb_goes_by_what_is_in_the_matrices(kind, names, often):
    rng = np.random.default_rng([len(kind), len(names), int(1000 * often), ord(names[0])])
    f, twin = FILTERS[kind](), FILTERS[kind]()
    held = dict.fromkeys(names)
    _set_up(f, held)
    _set_up(twin, {})
    now = {name: MODEL[name].copy() for name in MODEL} | held
    for step in range(STEPS):
        _outside(rng, f, held, often)
        now |= held
        _told(twin, now)
        f.predict()
        twin.predict()
        if rng.random() < 0.5:
            np.testing.assert_allclose(f.x, twin.x, rtol=1e-9, atol=1e-9)
        _outside(rng, f, held, often)
        now |= held
        _told(twin, now)
        z = None if rng.random() < 0.03 else rng.normal(size=(1, 1)) + step
        f.update(z)
        twin.update(z)
        if rng.random() < 0.5:
            np.testing.assert_allclose(f.x, twin.x, rtol=1e-9, atol=1e-9)
        if rng.random() < 0.01:
            np.testing.assert_allclose(f.P, twin.P, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(f.x, twin.x, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(f.K, twin.K, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(f.P, twin.P, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("written", ["assigned", "in place"])
@pytest.mark.parametrize("kind", FILTERS)
def test_f_written_between_the_verbs_counts_from_the_next_predict_on(kind, written):
    rng = np.random.default_rng(0)
    f, twin = FILTERS[kind](), FILTERS[kind]()
    held = {"F": None}
    _set_up(f, held)
    _set_up(twin, {})
    other = np.array([[1.0, 0.7], [0.0, 1.0]])
    for step in range(160):
        f.predict()
        twin.predict(F=other if step > 120 else None)
        if step == 120:
            if written == "assigned":
                f.F = other.copy()  # which nobody holds
            else:
                held["F"][...] = other
        z = rng.normal(size=(1, 1)) + step
        f.update(z)
        twin.update(z)
        if kind != "UFIR auto":  # whose horizon follows the attribute
            np.testing.assert_allclose(f.x, twin.x, rtol=1e-9, atol=1e-9)


def _edited_late(kind, hold, edit, edited_at=130):
    """x of a filter whose F is held from step 120 on and edited later, and of one that is told."""
    rng = np.random.default_rng(1)
    f, twin = FILTERS[kind](), FILTERS[kind]()
    _set_up(f, {})
    _set_up(twin, {})
    held = None
    for step in range(160):
        if step == edited_at:
            edit(held)
            twin.F = np.array([[1.0, 0.7], [0.0, 1.0]])
        f.predict()
        twin.predict()
        if (step, hold[0]) == (120, "predicted"):
            held = hold[1](f)
        z = rng.normal(size=(1, 1)) + step
        f.update(z)
        twin.update(z)
        if (step, hold[0]) == (120, "updated"):
            held = hold[1](f)
        yield f.x, twin.x


@pytest.mark.parametrize("edited_at", [121, 130])
@pytest.mark.parametrize("when", ["predicted", "updated"])
@pytest.mark.parametrize("kind", FILTERS)
def test_a_matrix_that_was_read_long_after_the_start_is_live(kind, when, edited_at):
    def edit(F):
        F[0, 1] = 0.7

    for x, expected in _edited_late(kind, (when, lambda f: f.F), edit, edited_at):
        np.testing.assert_allclose(x, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("kind", FILTERS)
def test_a_matrix_that_is_part_of_a_larger_array_is_live(kind):
    def part(f):
        whole = np.eye(4)
        whole[:2, :2] = MODEL["F"]
        f.F = whole[:2, :2]
        return whole

    def edit(whole):
        whole[0, 1] = 0.7

    for x, expected in _edited_late(kind, ("updated", part), edit):
        np.testing.assert_allclose(x, expected, rtol=1e-9, atol=1e-9)


def test_an_array_is_watched_for_as_long_as_somebody_holds_it():
    live = Live(np.eye(2), Square(2, "F"))
    held = np.eye(2)
    live.assign(held)
    assert live.intact()
    assert live.handed is held
    del held
    assert live.intact()
    assert live.handed is None
