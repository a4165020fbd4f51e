"""What leaves an estimate as it is, whichever filter made it: how a loss is told, and units."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tests.strategies import positive, random_model, seeds
from tests.theory.delays import F1, H1, Q1, R1
from ufirext import DelayHInfinityFilter, DelayKalmanFilter, FMSFilterSmoother, Model, UFIRFilter
from ufirext.channels import BernoulliDelay

few = settings(max_examples=15)
MAKERS = {
    "ufir": lambda n, m, S, **late: UFIRFilter(n, m, horizon=7, **late),
    "fms": lambda n, m, S, **late: FMSFilterSmoother(n, m, horizon=7, lag=2, **late),
    "exact": lambda n, m, S, **late: DelayKalmanFilter(n, m, **late),
    "augmented": lambda n, m, S, **late: DelayKalmanFilter(n, m, method="augmented", **late),
    "posterior": lambda n, m, S, **late: DelayHInfinityFilter(n, m, S=S, **late),
    "prior": lambda n, m, S, **late: DelayHInfinityFilter(n, m, form="prior", S=S, **late),
}
LATE = ({"max_delay": 2}, {"channel": BernoulliDelay(0.7)})


def configured(name: str, model: Model, P0: Any, S: Any, **late: Any) -> Any:
    f = MAKERS[name](model.dim_x, model.dim_z, S, **late)
    f.F, f.H, f.Q, f.R, f.P = model.F, model.H, model.Q, model.R, P0
    return f


@pytest.mark.parametrize("late", LATE, ids=["stamped", "unstamped"])
@pytest.mark.parametrize("name", MAKERS)
def test_missing_is_nan_is_absent_bit_for_bit(name, late):
    rng = np.random.default_rng(0)
    model = Model(F1, H1, Q1, R1)
    told = [configured(name, model, np.eye(2), np.eye(2), **late) for _ in range(3)]
    for step in range(40):
        z = None if rng.random() < 0.3 else rng.normal(size=1)
        delay = min(step, int(rng.integers(0, 3))) if "max_delay" in late else 0
        for way, f in enumerate(told):
            f.predict()
            if z is not None:
                f.update(z, delay=delay)
            elif way == 0:
                f.update(None)
            elif way == 1:
                f.update(np.array([np.nan]), delay=delay)
        for f in told[1:]:
            assert np.array_equal(f.x, told[0].x)
            assert np.array_equal(f.P, told[0].P)


@few
@given(seeds, st.sampled_from(sorted(MAKERS)), st.sampled_from(LATE))
def test_other_units_of_states_and_measurements_give_the_same_estimate(seed, name, late):
    """Kilometres, hours or grams: x, P and what is measured scale, and nothing else happens."""
    rng = np.random.default_rng(seed)
    model = random_model(seed, 3, 2, "oscillating")
    P0, S = positive(rng, 3), positive(rng, 3)
    state, seen = 10.0 ** rng.uniform(-3, 3, 3), 10.0 ** rng.uniform(-3, 3)
    scaled = Model(
        state[:, None] * model.F / state,
        seen * model.H / state,
        np.outer(state, state) * model.Q,
        seen**2 * model.R,
    )
    f = configured(name, model, P0, S, **late)
    g = configured(name, scaled, np.outer(state, state) * P0, S / np.outer(state, state), **late)
    for step in range(15):
        z = rng.normal(size=2)
        if step % 5 == 3:
            z[step % 2] = np.nan
        for filter_, unit in ((f, 1.0), (g, seen)):
            filter_.predict()
            filter_.update(unit * z, delay=min(step, step % 3) if "max_delay" in late else 0)
    size = np.sqrt(np.diag(f.P))
    assert_allclose(g.x.ravel() / state, f.x.ravel(), atol=1e-8 * max(1.0, size.max()))
    assert_allclose(g.P / np.outer(state, state), f.P, atol=1e-8 * max(1.0, np.abs(f.P).max()))
