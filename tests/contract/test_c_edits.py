"""C 28-30 and the decision EDITS: what is written to a filter from outside counts, however it is written."""

from __future__ import annotations

import numpy as np
import pytest

from .models import constant_velocity, flat, plane, ramp_F, run, trajectory, vector, walk


def assign(f, shift):
    f.x = f.x + shift.reshape(f.x.shape)


def in_place(f, shift):
    f.x += shift.reshape(f.x.shape)


def by_elements(f, shift):
    for i, s in enumerate(shift):
        f.x[i] += s


def through_a_view(f, shift):
    view = f.x[::-1]
    view += shift[::-1].reshape(f.x.shape)


def through_a_held_reference(f, shift):
    held = f.x
    held[...] = held + shift.reshape(f.x.shape)


def by_copyto(f, shift):
    np.copyto(f.x, f.x + shift.reshape(f.x.shape))


def through_x_post_of_a_reference_held_before_reading(f, shift):
    held = f.x
    _ = f.P, f.x, f.likelihood  # reading in between must not make the filter forget who holds x
    held += shift.reshape(held.shape)


WRITES = [
    assign,
    in_place,
    by_elements,
    through_a_view,
    through_a_held_reference,
    by_copyto,
    through_x_post_of_a_reference_held_before_reading,
]


@pytest.mark.contract(28)
@pytest.mark.parametrize("write", WRITES)
@pytest.mark.parametrize("edits", [(1,), (30, 31, 50)], ids=str)
def test_an_edit_of_x_moves_the_state_by_what_was_written(make, column, write, edits):
    """The target jumps and the user says so: without noise the estimate is exact before and after."""
    f = plane(make, column, x0=(1, 2, 3, -1))
    jump = np.array([50.0, -3.0, 7.0, 2.0])
    x = flat(f.x)
    for n in range(70):
        x = f.F @ x
        run(f, [x[::2]])
        np.testing.assert_allclose(flat(f.x), x, rtol=1e-8, atol=1e-8)
        if n in edits:
            write(f, jump)
            x = x + jump
            np.testing.assert_allclose(flat(f.x), x, rtol=1e-8, atol=1e-8)


EDIT = np.array([5.0, -1.0, 2.0, 0.5])


@pytest.mark.contract(28)
@pytest.mark.parametrize("when", ["after update", "after predict"])
@pytest.mark.parametrize("write", [assign, in_place])
def test_an_edit_acts_after_the_row_before_it(make, column, rng, write, when):
    """The filter is linear: shift the later measurements by what the edit does, and x shifts alike."""
    f, twin = plane(make, column), plane(make, column)
    shift = np.zeros(4)
    for n, z in enumerate(walk(rng, 80, 2)):
        f.predict()
        twin.predict()
        shift = f.F @ shift
        if n in (1, 2, 30, 33) and when == "after predict":
            write(f, EDIT)
            shift += EDIT
        f.update(z + f.H @ shift)
        twin.update(z)
        if n in (1, 2, 30, 33) and when == "after update":
            write(f, EDIT)
            shift += EDIT
        np.testing.assert_allclose(flat(f.x), flat(twin.x) + shift, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(f.P, twin.P, rtol=1e-8, atol=1e-8)


@pytest.mark.contract(28)
def test_an_edit_while_data_are_missing(make, column):
    f = constant_velocity(make, column, x0=(0, 1))
    x = np.array([0.0, 1.0])
    for n in range(60):
        x = f.F @ x
        run(f, [None if 20 <= n < 30 else x[0]])
        if n == 25:
            f.x[0] += 40.0
            x[0] += 40.0
        np.testing.assert_allclose(flat(f.x), x, rtol=1e-8, atol=1e-8)


@pytest.mark.contract(28)
def test_writing_what_is_there_already_changes_nothing(make, column, rng):
    f, twin = plane(make, column), plane(make, column)
    for z in walk(rng, 60, 2):
        run(f, [z])
        run(twin, [z])
        f.x = f.x.copy()
        f.x[...] = f.x
        np.testing.assert_allclose(f.x, twin.x, rtol=1e-9, atol=1e-9)


@pytest.mark.contract(28)
def test_an_x_of_an_earlier_step_is_only_a_record(make, column, rng):
    """Trackers keep ``history.append(kf.x)``: what they do to it later is their affair."""
    f, twin = plane(make, column), plane(make, column)
    history = []
    for z in walk(rng, 60, 2):
        run(f, [z])
        run(twin, [z])
        history.append((f.x, twin.x.copy()))
        f.predict()
        twin.predict()
        if len(history) % 5 == 0:
            history.pop()[0][...] = 1e6
        np.testing.assert_array_equal(f.x, twin.x)
    for kept, value in history:
        np.testing.assert_array_equal(kept, value)


def matrix_assigned(f, F):
    f.F = F


def matrix_in_place(f, F):
    f.F[...] = F


def matrix_by_elements(f, F):
    for i, j in np.ndindex(F.shape):
        f.F[i, j] = F[i, j]


def matrix_through_a_view(f, F):
    rows = f.F[:2]
    rows[...] = F[:2]
    f.F[2:][...] = F[2:]


def matrix_by_copyto(f, F):
    np.copyto(f.F, F)


@pytest.mark.contract("29-30")
@pytest.mark.parametrize(
    "write", [matrix_assigned, matrix_in_place, matrix_by_elements, matrix_through_a_view, matrix_by_copyto]
)
def test_F_may_be_written_in_any_way_at_any_time(make, column, write):
    f = plane(make, column, x0=(1, 2, 3, -1))
    x = flat(f.x)
    for n in range(60):
        F = np.kron(np.eye(2), ramp_F((1.0, 1.0, 1.0, 0.25, 2.0)[n % 5]))
        write(f, F)
        x = F @ x
        run(f, [x[::2]])
        np.testing.assert_allclose(flat(f.x), x, rtol=1e-8, atol=1e-8)


@pytest.mark.contract("29-30")
@pytest.mark.parametrize(
    "hold", [lambda F: F, lambda F: F[:], lambda F: F.base], ids=["array", "view", "base"]
)
def test_F_may_be_written_through_whoever_else_holds_it(make, column, hold):
    """The caller keeps the array that was assigned; np.kron's result is itself a view of such an array."""
    f = plane(make, column, x0=(1, 2, 3, -1))
    F = np.kron(np.eye(2), ramp_F())
    assert F.base is not None
    f.F = F
    held, x = hold(F), flat(f.x)
    for n in range(60):
        held[...] = np.kron(np.eye(2), ramp_F(1.0 if n < 30 else 0.5)).reshape(held.shape)
        x = F @ x
        run(f, [x[::2]])
        np.testing.assert_allclose(flat(f.x), x, rtol=1e-8, atol=1e-8)


@pytest.mark.contract("29-30")
@pytest.mark.parametrize("name", ["F", "H", "Q", "R"])
@pytest.mark.parametrize("at", [1, 30])
def test_editing_a_matrix_in_place_is_assigning_it(make, rng, name, at):
    f, twin = plane(make), plane(make)
    held = getattr(f, name)
    for n, z in enumerate(walk(rng, 50, 2)):
        if n == at:
            held[0, 0] *= 1.5
            setattr(twin, name, held.copy())
        run(f, [z])
        run(twin, [z])
        np.testing.assert_allclose(f.x, twin.x, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(f.P, twin.P, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(f.S, twin.S, rtol=1e-9, atol=1e-9)


@pytest.mark.contract("EDITS")
@pytest.mark.parametrize("steps", [0, 1, 3, 60])
@pytest.mark.parametrize("how", ["assigned", "in place"])
def test_P_from_outside_holds_for_the_coming_prediction_and_update(make, column, rng, steps, how):
    f = plane(make, column)
    zs = walk(rng, steps + 1, 2)
    run(f, zs[:-1])
    P = 50.0 * np.eye(4) + 1.0
    if how == "assigned":
        f.P = P.copy()
    else:
        f.P[...] = P
    f.predict()
    prior = f.F @ P @ f.F.T + f.Q
    np.testing.assert_allclose(f.P_prior, prior, rtol=1e-9)
    f.update(zs[-1])
    np.testing.assert_allclose(f.S, f.H @ prior @ f.H.T + f.R, rtol=1e-9)


@pytest.mark.contract("EDITS")
def test_after_that_update_the_windows_own_covariance_returns(ufir, column, rng):
    f, twin = plane(ufir, column), plane(ufir, column)
    for n, z in enumerate(walk(rng, 60, 2)):
        if n in (5, 30):
            f.P = 1e4 * np.eye(4)
        run(f, [z])
        run(twin, [z])
        np.testing.assert_allclose(f.x, twin.x, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(f.P, twin.P, rtol=1e-9, atol=1e-9)


@pytest.mark.contract("EDITS")
def test_an_edit_is_a_known_input_and_stays_exact_for_ever(ufir, column):
    """A correction in every step, as in a closed loop, does not drift over ten windows and more."""
    f = constant_velocity(ufir, column)
    x = np.zeros(2)
    for n in range(500):
        x = f.F @ x
        run(f, [x[0]])
        correction = np.array([np.sin(n), np.cos(n)])
        f.x += correction.reshape(f.x.shape)
        x = x + correction
        np.testing.assert_allclose(flat(f.x), x, rtol=1e-7, atol=1e-7)
    states = trajectory(f.F, x, 50)
    run(f, states[:, 0])
    np.testing.assert_allclose(f.x, vector(states[-1], column), rtol=1e-7, atol=1e-7)


@pytest.mark.contract(6)
def test_a_covariance_may_be_edited_entry_by_entry_between_verbs(make):
    f = make(2, 1)
    f.Q[0, 1] = 0.5  # for a moment Q is not symmetric, and other attributes are read and written
    f.P *= 2.0
    f.x = np.zeros(2)
    f.Q[1, 0] = 0.5
    f.predict()
    assert f.P[0, 1] == f.P[1, 0] == 0.5


@pytest.mark.contract("EDITS", better=True)
@pytest.mark.parametrize("name", ["x", "P", "F", "H", "Q", "R"])
@pytest.mark.parametrize("steps", [0, 60])
def test_an_edit_that_is_refused_is_refused_until_it_is_mended(make, column, name, steps):
    """Nothing goes on beside numbers that the filter shows and does not use."""
    f, twin = (run(plane(make, column), [[n, -n] for n in range(steps)]) for _ in range(2))
    held = getattr(f, name)
    good = held.copy()
    held.flat[0] = np.nan
    for _ in range(3):
        with pytest.raises(ValueError, match=f"{name} must be finite"):
            f.predict()
        with pytest.raises(ValueError, match=f"{name} must be finite"):
            f.update([1.0, 2.0])
    held[...] = good
    for k in range(5):
        run(f, [[k, k]])
        run(twin, [[k, k]])
    np.testing.assert_allclose(f.x, twin.x, rtol=1e-9)
    np.testing.assert_allclose(f.P, twin.P, rtol=1e-9)


@pytest.mark.contract("EDITS", better=True)
@pytest.mark.parametrize("steps", [0, 60])
def test_an_x_that_is_refused_leaves_the_one_before_in_its_form(make, column, steps):
    f = run(plane(make, column), [[n, -n] for n in range(steps)])
    before = f.x.copy()
    for wrong in ([1.0, np.nan, 0.0, 0.0], [[1.0], [np.inf], [0.0], [0.0]], [1.0, 2.0], "text"):
        with pytest.raises(ValueError, match="x must"):
            f.x = wrong
        np.testing.assert_array_equal(f.x, before)
        assert f.x.shape == f.x_prior.shape == before.shape
