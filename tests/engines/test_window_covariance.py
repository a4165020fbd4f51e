"""The covariance from grams is the covariance of the stacked window."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.strategies import seeds
from ufirext.engines.exact import window_covariance
from ufirext.engines.records import Limits, Records
from ufirext.window import Row


@given(seed=seeds, singular=st.booleans(), late=st.booleans())
def test_grams_and_stacked_rows_give_the_same_covariance(seed, singular, late):
    rng = np.random.default_rng(seed)
    n, steps = int(rng.integers(1, 5)), int(rng.integers(8, 20))
    records = Records(np.eye(n), np.eye(n), 0)
    for now in range(1, steps):
        F = np.eye(n) + 0.2 * rng.normal(size=(n, n))
        if singular:
            F[0] = 0.0
        root = rng.normal(size=(n, n))
        records.advance(F, root @ root.T, None)
        for _ in range(rng.integers(0, 3)):
            m = int(rng.integers(1, 3))
            noise = rng.normal(size=(m, m))
            R = noise @ noise.T + 0.1 * np.eye(m)
            origin = now - int(rng.integers(0, min(3, now))) if late else now
            records.add(Row(origin, now, rng.normal(size=(m, n)), R, rng.normal(size=m)))
    solution = records.solve(Limits(steps, 1, False, True))
    ours = window_covariance(records.rows, records.step, records.now) if records.rows else None
    if solution is None or ours is None:
        return
    theirs = solution.covariance.value
    scale = np.sqrt(np.outer(theirs.diagonal(), theirs.diagonal()))
    assert np.abs(ours - theirs).max() <= 1e-9 * scale.max()


def test_few_windows_are_left_to_the_reference():
    rng = np.random.default_rng(0)
    records = Records(np.eye(2), np.eye(2), 0)
    for now in range(1, 12):
        records.advance(np.array([[1.0, rng.uniform(0.5, 1.5)], [0.0, 1.0]]), 0.1 * np.eye(2), None)
        records.add(Row(now, now, np.array([[1.0, 0.0]]), np.eye(1), rng.normal(size=1)))
    assert window_covariance(records.rows, records.step, records.now) is not None
