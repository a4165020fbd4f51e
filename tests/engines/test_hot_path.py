"""What the hot path puts off is what the slow path would have worked out at once."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.strategies import seeds
from ufirext import DelayHInfinityFilter, DelayKalmanFilter, FMSFilterSmoother, UFIRFilter, kinematic

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


NO_NUMBERS = {
    "text": "4",
    "bytes": b"4",
    "NumPy's text": np.str_("4"),
    "no time": np.datetime64("NaT"),
    "no time in ns": np.datetime64("NaT", "ns"),
    "a time": np.datetime64("2026-01-01", "ns"),
    "a duration": np.timedelta64(4, "ns"),
    "too large": 10**400,
}


@pytest.mark.parametrize("steps", [0, 1, 12])
@pytest.mark.parametrize("packed", ["alone", "list", "array", "column"])
@pytest.mark.parametrize("kind", NO_NUMBERS)
@pytest.mark.parametrize("make", [UFIRFilter, FMSFilterSmoother, DelayKalmanFilter, DelayHInfinityFilter])
def test_text_and_times_are_no_measurements_on_any_path(make, kind, packed, steps):
    model, wrong = kinematic(1, 1, 0.5), NO_NUMBERS[kind]
    f = make(2, 1, **({"horizon": 6} if make in (UFIRFilter, FMSFilterSmoother) else {}))
    f.F, f.H, f.Q, f.R = model.F, model.H, model.Q, model.R
    for step in range(steps):
        f.predict()
        f.update(float(step))
    f.predict()
    z = {"alone": wrong, "list": [wrong], "array": np.array([wrong]), "column": np.array([[wrong]])}[packed]
    with pytest.raises(ValueError, match="z must"):
        f.update(z)


@pytest.mark.parametrize("kind", [*"?bBhHiIlLqQefdg", int, float, bool])
@pytest.mark.parametrize("packed", [True, False])
def test_every_kind_of_number_is_a_measurement_and_means_the_same(kind, packed):
    hot, plain = configured(6, 1, 1), configured(6, 1, 1)
    for step in range(20):
        for f in (hot, plain):
            f.predict()
        z = np.array([step % 2], dtype=kind) if packed or isinstance(kind, str) else kind(step % 2)
        hot.update(z if packed else z[0] if isinstance(z, np.ndarray) else z)
        plain.update(float(step % 2))
        np.testing.assert_array_equal(hot.x, plain.x)
