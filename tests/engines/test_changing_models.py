"""A model that changes from step to step: the hot path, the slow path and exact arithmetic say the same."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Iterable
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.strategies import seeds
from ufirext import CovarianceError, NonFiniteError, ShapeError, UFIRFilter, kinematic
from ufirext.engines.frames import Frames
from ufirext.engines.suffixes import Suffixes
from ufirext.filters._state import TURNED

from .test_hot_path import PUBLISHED, configured

EVENTS = {
    "all by argument": 0.3, "all by attribute": 0.2, "in place": 0.1, "F alone": 0.05,
    "F alone, attribute": 0.05, "input": 0.08, "lost": 0.07, "silent": 0.05, "two sensors": 0.05,
    "component": 0.02, "late": 0.03,
}  # fmt: skip


def transition(dt: float, axes: int) -> tuple[np.ndarray, np.ndarray]:
    model = kinematic(1, axes, dt, q=0.3)
    return model.F.copy(), model.Q.copy()


def step(f: UFIRFilter, event: str, axes: int, rng: np.random.Generator) -> None:
    """One step; two filters with generators of the same state meet the same."""
    dt, angle, z = rng.uniform(0.1, 2.0), rng.uniform(0, 1), rng.normal(size=(axes, 1))
    F, Q = transition(dt, axes)
    H, half = kinematic(1, axes, 1.0).H.copy(), rng.uniform(0.2, 3.0, (axes, axes))
    if axes == 2:
        H = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) @ H
    R = half @ half.T + 0.5 * np.eye(axes)
    R = 0.5 * (R + R.T)
    if event == "all by attribute":
        f.F, f.Q, f.H, f.R = F, Q, H, R
        f.predict()
        f.update(z)
    elif event == "in place":
        f.F[0, 1] = dt
        f.predict()
        f.R[0, 0] *= 1.0 + angle
        f.update(z)
    elif event == "F alone":
        f.predict(F=F)
        f.update(z)
    elif event == "F alone, attribute":
        F.flags.writeable = angle < 0.5
        f.F = F
        f.predict()
        f.update(z)
    elif event == "input":
        f.predict(rng.normal(size=2 * axes), np.eye(2 * axes), F, Q)
        f.update(z, R)
    elif event == "lost":
        f.predict(F=F, Q=Q)
        f.update(None)
    elif event == "silent":
        f.predict(F=F, Q=Q)
    elif event == "two sensors":
        f.predict(F=F, Q=Q)
        f.update(z, R, H)
        f.update(z[:1] + 0.1, R[:1, :1], H[:1])
    elif event == "component":
        z[-1] = np.nan
        f.predict(F=F, Q=Q)
        f.update(z, R, H)
    elif event == "late":
        f.predict(F=F, Q=Q)
        f.update(z, R, H, delay=1)
    else:
        f.predict(F=F, Q=Q)
        f.update(z, R, H)


@pytest.mark.parametrize("axes", [1, 2])
@given(seed=seeds, horizon=st.integers(3, 12))
def test_putting_off_changes_nothing(axes, seed, horizon):
    draw = np.random.default_rng(seed)
    hot, slow = configured(horizon, 1, axes), configured(horizon, 1, axes)
    turned = 0
    for _ in range(5 * horizon + 20):
        event = str(draw.choice(list(EVENTS), p=list(EVENTS.values())))
        now = int(draw.integers(2**32))
        step(hot, event, axes, np.random.default_rng(now))
        step(slow, event, axes, np.random.default_rng(now))
        assert slow.P is not None  # looking at P leaves the hot path at every step
        turned += hot._state.mode == TURNED
        if draw.random() < 0.3:
            np.testing.assert_allclose(hot.x, slow.x, rtol=1e-9, atol=1e-9)
        if draw.random() < 0.1:
            hot = copy.deepcopy(hot) if draw.random() < 0.5 else pickle.loads(pickle.dumps(hot))
        if draw.random() < 0.15:
            assert (hot.ready, hot.rows, hot.dropped) == (slow.ready, slow.rows, slow.dropped)
            for name in PUBLISHED:
                ours, theirs = (np.array(getattr(f, name), dtype=float) for f in (hot, slow))  # None is NaN
                np.testing.assert_allclose(ours, theirs, rtol=1e-8, atol=1e-8, err_msg=name)
    assert turned > 3  # else this compared the slow path with itself


@pytest.mark.parametrize("name", ["F", "Q", "H", "R"])
@pytest.mark.parametrize("watched", [False, True])
def test_a_matrix_assigned_at_every_step_counts_from_its_step_on(name, watched):
    """Long after a constant past as well, when an engine of constant models could be thought of again."""
    rng = np.random.default_rng(5)
    assigned, given = configured(6, 1, 1), configured(6, 1, 1)
    for k in range(500):
        scale = 1.0 if k < 200 else rng.uniform(0.5, 2.0)
        other = np.array([[1.0, scale], [0.0, 1.0]]) if name == "F" else scale * getattr(given, name)
        z = rng.normal(size=(1, 1)) + 0.1 * k
        setattr(assigned, name, other)
        assigned.predict()
        assigned.update(z)
        given.predict(**{name: other} if name in "FQ" else {})
        given.update(z, **{name: other} if name in "HR" else {})
        if watched:
            np.testing.assert_allclose(assigned.P, given.P, rtol=1e-9)
        np.testing.assert_allclose(assigned.x, given.x, rtol=1e-9, atol=1e-12)


def on_the_hot_path(make_F=lambda dt: np.array([[1.0, dt], [0.0, 1.0]])) -> UFIRFilter:
    f = configured(6, 1, 1)
    for k in range(60):
        f.F = make_F(1.0 + 0.01 * (k % 7))
        f.predict()
        f.update(np.array([[0.1 * k]]))
    assert f._state.mode == TURNED
    return f


def frozen(dt: float) -> np.ndarray:
    F = np.array([[1.0, dt], [0.0, 1.0]])
    F.flags.writeable = False
    return F


def test_after_frozen_matrices_the_attribute_can_be_edited_all_the_same():
    f, twin = on_the_hot_path(frozen), on_the_hot_path()
    np.testing.assert_array_equal(f.x, twin.x)
    f.F[0, 1] = 1.5
    twin.F = np.array([[1.0, 1.5], [0.0, 1.0]])
    for g in (f, twin):
        g.predict()
        g.update(6.0)
    np.testing.assert_array_equal(f.x, twin.x)
    np.testing.assert_array_equal(f.F, twin.F)


@pytest.mark.parametrize("name", ["F", "H", "R"])
def test_an_array_assigned_at_every_step_counts_as_it_is_at_the_verb(name):
    f, twin = on_the_hot_path(), on_the_hot_path()
    first = getattr(twin, name).copy()
    for k in range(20):
        value = first * (1.0 + 0.001 * k)
        mine = value.copy()
        setattr(f, name, mine)
        mine[0, 0] *= 1.01  # after the assignment, before the verb
        value[0, 0] *= 1.01
        setattr(twin, name, value)
        for g in (f, twin):
            g.predict()
            g.update(0.1 * k)
        np.testing.assert_array_equal(f.x, twin.x)
    assert f._state.mode == TURNED


@pytest.mark.parametrize("name", ["F", "H", "Q", "R"])
def test_a_bad_matrix_is_refused_where_it_is_assigned_and_the_one_before_stays(name):
    f, twin = on_the_hot_path(), on_the_hot_path()
    bad = getattr(twin, name).copy()
    bad[0, 0] = np.nan
    with pytest.raises(NonFiniteError, match=name):
        setattr(f, name, bad)
    with pytest.raises(ValueError, match=name):
        setattr(f, name, np.zeros((3, 3)))
    for g in (f, twin):
        g.predict()
        g.update(6.0)
    np.testing.assert_array_equal(f.x, twin.x)
    np.testing.assert_array_equal(f.P, twin.P)


def test_an_H_of_more_rows_than_the_attribute_R_is_refused():
    f, twin = on_the_hot_path(), on_the_hot_path()
    for g in (f, twin):
        g.predict()
    with pytest.raises(ShapeError, match="R"):
        f.update(np.array([1.0, 2.0]), H=np.eye(2))
    for g in (f, twin):
        g.update(6.0)
    np.testing.assert_array_equal(f.x, twin.x)


def test_a_noise_refused_halfway_leaves_nothing_of_itself():
    f, twin = configured(6, 1, 2), configured(6, 1, 2)
    rng = np.random.default_rng(3)
    for k in range(80):
        F, _ = transition(1.0 + 0.01 * (k % 7), 2)
        z = rng.normal(size=2)
        for g in (f, twin):
            g.predict(F=F)
        if k % 10 == 9:
            with pytest.raises(NonFiniteError, match="R"):
                f.update(z, R=np.diag([9.0, np.nan]))
        for g in (f, twin):
            g.update(z)
        np.testing.assert_allclose(f.x, twin.x, rtol=1e-9, atol=1e-9)


def exact(history: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]], horizon: int) -> list[float]:
    """Least squares over the last rows in rational arithmetic: F, z, R (diagonal), H of each step."""
    window = history[-horizon:]
    n = len(window[0][0])
    product = [[Fraction(int(i == j)) for j in range(n)] for i in range(n)]
    Lam, eta = [[Fraction(0)] * n for _ in range(n)], [Fraction(0)] * n
    for place, (F, z, R, H) in enumerate(window):
        if place:
            F_now = [[Fraction(v) for v in row] for row in F.tolist()]
            columns = list(zip(*product, strict=True))
            product = [[_dot(row, column) for column in columns] for row in F_now]
        for numbers, value, variance in zip(
            H.tolist(), z.ravel().tolist(), R.diagonal().tolist(), strict=True
        ):
            seen = [_dot(map(Fraction, numbers), column) for column in zip(*product, strict=True)]
            weight = 1 / Fraction(variance)
            for i in range(n):
                eta[i] += weight * seen[i] * Fraction(value)
                for j in range(n):
                    Lam[i][j] += weight * seen[i] * seen[j]
    x = _solved(Lam, eta)
    return [float(_dot(row, x)) for row in product]


def _dot(a: Iterable[Fraction], b: Iterable[Fraction]) -> Fraction:
    return sum((left * right for left, right in zip(a, b, strict=True)), Fraction(0))


def _solved(A: list[list[Fraction]], b: list[Fraction]) -> list[Fraction]:
    rows = [[*row, right] for row, right in zip(A, b, strict=True)]
    n = len(rows)
    for i in range(n):
        pivot = next(k for k in range(i, n) if rows[k][i])
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [value / rows[i][i] for value in rows[i]]
        for k in range(n):
            if k != i:
                rows[k] = [a - rows[k][i] * c for a, c in zip(rows[k], rows[i], strict=True)]
    return [row[-1] for row in rows]


@pytest.mark.parametrize(
    ("F", "sums"),
    [
        ([[1.0, 0.5], [0.0, 1.0]], Frames),
        ([[1.0, 0.5, 0.125], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]], Frames),
        ([[0.9, 0.4], [-0.4, 0.9]], Frames),
        ([[1.1, 0.1], [0.0, 1.1]], Frames),  # grows by 45 a window
        ([[0.7, 0.2], [0.0, 0.5]], Suffixes),  # forgets within a window
        ([[1.2, 0.1], [0.1, 1.0]], Suffixes),  # two modes, one of which drowns the other
    ],
    ids=["velocity", "acceleration", "oscillating", "unstable", "damped", "drowned"],
)
def test_digits_survive_whatever_the_model_does_within_a_window(F, sums):
    """Twelve digits of x, in the frame before the window or, where that is not enough, at its oldest row."""
    rng, base, horizon = np.random.default_rng(5), np.array(F), 40
    n = len(base)
    f = UFIRFilter(n, 1, horizon=horizon)
    f.H = H = np.eye(1, n) + 0.5 * np.eye(1, n, 1)
    history, used = [], set()
    for k in range(4 * horizon):
        F_now = base + 1e-3 * rng.normal(size=base.shape) * (base != 0.0)
        z, R = 5.0 + rng.normal(size=1), rng.uniform(0.5, 2.0, (1, 1))
        f.predict(F=F_now)
        f.update(z, R)
        history.append((F_now, z, R, H))
        if k > 2 * horizon and k % 13 == 0:
            x = np.array(exact(history, horizon))
            np.testing.assert_allclose(f.x.ravel(), x, rtol=0, atol=1e-12 * np.abs(x).max())
            used.add(type(f._state.engine.sums))
    assert sums in used


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ({"F": np.full((2, 2), np.nan)}, NonFiniteError, "F must be finite"),
        ({"F": np.full((2, 2), np.inf)}, NonFiniteError, "F must be finite"),
        ({"F": np.eye(3)}, ValueError, "F must have shape"),
        ({"Q": -np.eye(2)}, CovarianceError, "Q must be positive semidefinite"),
        ({"Q": [[1.0, 0.5], [0.0, 1.0]]}, CovarianceError, "Q must be symmetric"),
        ({"Q": np.diag([1.0, np.inf])}, NonFiniteError, "Q must be finite"),
        ({"R": [[-1.0]]}, CovarianceError, "R must be positive semidefinite"),
        ({"R": np.array([[np.inf]])}, NonFiniteError, "R must be finite"),
        ({"H": np.array([[np.nan, 0.0]])}, NonFiniteError, "H must be finite"),
        ({"H": np.ones((1, 3))}, ValueError, "H must have shape"),
        ({"z": np.array([np.inf])}, NonFiniteError, "z must be finite"),
    ],
)
def test_what_is_wrong_is_refused_with_reasons_and_nothing_lost(arguments, error, words):
    def run(spoilt: bool) -> np.ndarray:
        f = configured(6, 1, 1)
        for k in range(30):
            F, Q = transition(0.5 + 0.01 * k, 1)
            if spoilt and k == 20:
                assert f._state.mode == TURNED
                with pytest.raises(error, match=words):
                    wrong(f, arguments)
            f.predict(F=F, Q=Q)
            if spoilt and k == 25 and not {"F", "Q"} & set(arguments):
                with pytest.raises(error, match=words):
                    wrong(f, arguments)
            f.update(float(k), R=np.array([[1.0 + 0.1 * k]]))
        return f.x

    np.testing.assert_allclose(run(True), run(False), rtol=1e-12)


def wrong(f: UFIRFilter, arguments: dict[str, object]) -> None:
    if {"F", "Q"} & set(arguments):
        f.predict(**arguments)
    else:
        f.update(**({"z": 1.0} | arguments))


def test_noise_of_fewer_sources_than_states_is_a_covariance_at_every_step():
    """Q = G G' has no Cholesky factor, rounding decides: it is neither refused nor asked about at length."""
    f, rng = configured(6, 1, 1), np.random.default_rng(2)
    for k in range(200):
        dt = rng.uniform(0.1, 2.0)
        G = np.array([[dt**2 / 2], [dt]])
        f.predict(F=np.array([[1.0, dt], [0.0, 1.0]]), Q=3.0 * G @ G.T)
        f.update(float(k))
    assert f.ready
    with pytest.raises(CovarianceError, match="Q must be positive semidefinite"):
        f.predict(Q=G @ G.T - 1e-3 * np.eye(2))


@given(seeds)
def test_an_automatic_horizon_changes_at_the_same_step_whoever_looks(seed):
    """Reading P takes a filter off its hot path, and must not change x."""
    rng = np.random.default_rng(seed)
    seen, unseen = UFIRFilter(2, 1), UFIRFilter(2, 1)
    for f in (seen, unseen):
        f.F, f.H, f.Q = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]]), 0.1 * np.eye(2)
    horizons = set()
    for _ in range(100):
        F = np.array([[1.0, rng.uniform(0.5, 1.5)], [0.0, 1.0]])
        R, z = 10.0 ** rng.uniform(-2, 3), rng.normal() if rng.random() < 0.9 else None
        for f in (seen, unseen):
            f.R = R
            f.predict(F=F)
            f.update(z)
        horizons.add(seen.horizon)
        _ = seen.P
        np.testing.assert_allclose(unseen.x, seen.x, rtol=1e-7, atol=1e-7)
    assert len(horizons) > 1
