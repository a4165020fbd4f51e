"""Nothing is subtracted from a window, and x_u starts anew: long runs end where a fresh batch would."""

from __future__ import annotations

import numpy as np
import pytest

from ufirext import UFIRFilter, kinematic, ufir_gain

from .streams import fresh


@pytest.mark.parametrize("write", ["input", "edit"])
def test_what_is_known_of_a_stabilised_unstable_plant_never_outgrows_the_data(write):
    f = UFIRFilter(1, 1, 1, horizon=12)
    f.F, f.H, f.B = [[1.1]], [[1.0]], [[1.0]]
    x = 1.0
    for step in range(4000):
        pull = -0.3 * x + np.sin(step)
        x = 1.1 * x + pull
        if write == "input":
            f.predict(pull)
        else:
            f.predict()
            f.x = f.x + pull
        f.update(x)
        if step > 20:
            assert abs(f.x.item() - x) < 1e-9, step


@pytest.mark.parametrize("horizon", [9, 70])
def test_a_hundred_thousand_steps_later_the_estimate_is_that_of_a_fresh_window(horizon):
    model, rng = kinematic(1, 2, 1.0, q=0.1, r=4.0), np.random.default_rng(horizon)
    f = fresh(model, horizon)
    zs = np.cumsum(rng.standard_normal((100_000, 2)), axis=0)
    for z in zs:
        f.predict()
        f.update(z)
    np.testing.assert_allclose(f.x.ravel(), ufir_gain(model, horizon).K @ zs[-horizon:].ravel(), rtol=1e-10)


def test_late_and_lost_rows_do_not_drift_either():
    model, rng = kinematic(1, 1, 1.0, q=0.1, r=4.0), np.random.default_rng(3)
    f = fresh(model, 15)
    zs = np.cumsum(rng.standard_normal(20_000))
    lost = rng.random(len(zs)) < 0.2
    lost[-15:] = False
    for z, gone in zip(zs, lost, strict=True):
        f.predict()
        f.update(None if gone else z)
    np.testing.assert_allclose(f.x.ravel(), ufir_gain(model, 15).K @ zs[-15:], rtol=1e-10)
