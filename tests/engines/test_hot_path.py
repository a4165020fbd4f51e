"""What the hot path puts off is what the slow path would have worked out at once."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.strategies import seeds
from ufirext import UFIRFilter, kinematic

PUBLISHED = ("x", "P", "x_prior", "P_prior", "x_post", "P_post", "y", "K", "S", "z", "R", "log_likelihood")


def configured(horizon: int, order: int, axes: int) -> UFIRFilter:
    model = kinematic(order, axes, 0.5, q=0.3, r=2.0)
    f = UFIRFilter(model.dim_x, model.dim_z, horizon=horizon)
    f.F, f.H, f.Q, f.R = model.F, model.H, model.Q, model.R
    return f


@pytest.mark.parametrize(("order", "axes"), [(1, 1), (1, 2), (1, 3)])
@given(seed=seeds, horizon=st.integers(3, 12))
def test_putting_off_changes_nothing(order, axes, seed, horizon):
    """Rows in all forms, weights, losses, steps without a word, H and R passed that are the filter's own."""
    rng = np.random.default_rng(seed)
    hot, slow = configured(horizon, order, axes), configured(horizon, order, axes)
    for step in range(4 * horizon + 10):
        for f in (hot, slow):
            f.predict()
        kind = rng.choice(["plain", "flat", "strided", "own", "weighted", "none", "silent"], p=PROBABILITIES)
        z = step + rng.normal(size=(axes, 1))
        arguments = {
            "plain": (z,),
            "flat": (z[:, 0].copy(),),
            "strided": (np.repeat(z, 2, axis=1)[:, :1],),
            "own": (z, 2.0 * np.eye(axes), kinematic(order, axes, 0.5).H),
            "weighted": (z, rng.uniform(0.5, 9.0) * np.eye(axes)),
            "none": (None,),
        }
        for f in (hot, slow):
            if kind != "silent":
                f.update(*arguments[kind])
        assert slow.P is not None  # looking at P leaves the hot path at every step
        if rng.random() < 0.15:
            for name in PUBLISHED:
                ours, theirs = (np.array(getattr(f, name), dtype=float) for f in (hot, slow))  # None is NaN
                np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9, err_msg=name)


PROBABILITIES = [0.55, 0.05, 0.05, 0.1, 0.05, 0.1, 0.1]


@pytest.mark.parametrize("axes", [1, 2, 3])
def test_a_measurement_that_is_none_is_refused_with_reasons_and_nothing_lost(axes):
    for wrong in (np.full(axes, np.inf), np.zeros(axes + 1), np.zeros((axes, 1, 1)), np.full(axes, 1j), "z"):
        f = configured(6, 1, axes)
        for step in range(12):
            f.predict()
            f.update(np.full(axes, float(step)))
        f.predict()
        with pytest.raises(ValueError, match="z must"):
            f.update(wrong)
        f.update(np.full(axes, 12.0))
        np.testing.assert_allclose(f.x[::2].ravel(), 12.0)
