"""What only rounding couples is not observed: no engine takes it for an estimate."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from ufirext import (
    Fleet,
    FMSFilterSmoother,
    Model,
    UFIRFilter,
    UnobservableWindow,
    filter_series,
    kinematic,
    ufir_gain,
)
from ufirext.window import model_window


def rotation(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def turning(angle):
    return Model(rotation(angle), [[1.0, 0.0]], Q=0.01, R=1.0)


REFLECTION = Model([[np.cos(1.0), np.sin(1.0)], [np.sin(1.0), -np.cos(1.0)]], [[1.0, 0.0]], Q=0.01, R=1.0)


@pytest.mark.parametrize("horizon", [2, 3, 20, 50, 400])
def test_half_turns_are_never_determined(horizon):
    """MATHEMATICS, section 2: a rotation by pi stays rank 1."""
    with pytest.raises(UnobservableWindow, match="no horizon determines it"):
        ufir_gain(turning(np.pi), horizon)
    assert model_window(turning(np.pi), horizon).rank == 1


@given(st.floats(1e-6, 1e6), st.floats(0.1, 3.0))
def test_units_of_a_state_change_nothing(unit, angle):
    """A turn that is determined stays so, and half a turn does not become so."""
    units = np.diag([1.0, unit])

    def in_units(model):
        back = np.linalg.inv(units)
        return Model(units @ model.F @ back, model.H @ back, Q=units @ model.Q @ units, R=model.R)

    assert model_window(in_units(turning(angle)), 20).determined()
    assert not model_window(in_units(turning(np.pi)), 20).determined()


@pytest.mark.parametrize("rate", [1e-12, 1e-9, 1e-6, 1e-3])
def test_slow_turns_and_weak_couplings_are_no_rounding(rate):
    """Position and speed with a restoring force of 1e-24, and the same in turned units."""
    F = expm(np.array([[0.0, 1.0], [-(rate**2), 0.0]]))
    for units in (np.eye(2), np.diag([1.0, 1e12]), np.diag([1e-9, 1.0])):
        model = Model(units @ F @ np.linalg.inv(units), [[1.0, 0.0]] @ np.linalg.inv(units), Q=0.0, R=1.0)
        assert model_window(model, 30).determined()


def streams(model, keep, steps=60, horizon=8):
    """x, step by step, of everything that filters; NaN where it says that it is not ready."""
    rng = np.random.default_rng(1)
    zs = np.where(np.arange(steps) % keep == 0, rng.normal(size=steps), np.nan)
    for changing in (False, True):
        for kind in (UFIRFilter, FMSFilterSmoother):
            f = kind(2, 1, horizon=horizon)
            f.F, f.H, f.Q, f.R = model.F, model.H, model.Q, model.R
            x = np.full((steps, 2), np.nan)
            for n, z in enumerate(zs):
                f.predict(F=model.F * (1.0 + 1e-14 * n) if changing else None)
                f.update(None if np.isnan(z) else z)
                x[n] = f.x.ravel() if f.ready else np.nan
            yield f"{kind.__name__}, {'changing' if changing else 'constant'}", x
    for engine in ("auto", "scan", "stepwise"):
        yield engine, filter_series(model, zs, horizon, engine=engine).x
    yield "minimum variance", filter_series(model, zs, horizon, noise=(model.Q, model.R)).x
    fleet = Fleet(model, horizon, 1)
    yield "fleet", np.array([fleet.step([[z]])[0] for z in zs])


@pytest.mark.parametrize(
    ("model", "keep"),
    [
        (turning(np.pi / 2), 2),
        (turning(np.pi / 4), 4),
        (turning(2 * np.pi / 3), 3),
        (REFLECTION, 2),
        (
            Model(expm(np.array([[0.0, 1.0], [-((2 * np.pi) ** 2), 0.0]]) / 8), [[1.0, 0.0]], Q=1e-6, R=0.01),
            4,
        ),
    ],
    ids=["quarter", "eighth", "third", "reflection", "1 Hz at 8 Hz"],
)
def test_rows_half_a_period_apart_leave_every_filter_unready(model, keep):
    for name, x in streams(model, keep):
        assert np.isnan(x).all(), name


@pytest.mark.parametrize("keep", [1, 2, 3])
def test_rows_at_other_moments_make_every_filter_ready(keep):
    for name, x in streams(turning(0.7), keep):
        assert np.isfinite(x[-1]).all(), name
        assert np.abs(x[-20:]).max() < 20.0, name


def test_speeds_in_light_years_are_still_determined():
    """kinematic, the speed in units 1e16 times as large: one coupling is tiny, the other zero."""
    units = np.diag([1.0, 1e-16])
    model = kinematic(1, 1, 1.0, q=0.01)
    F, Q = units @ model.F @ np.linalg.inv(units), units @ model.Q @ units
    f = UFIRFilter(2, 1, horizon=6)
    f.F, f.H, f.Q = F, model.H, Q
    for n in range(12):
        f.predict()
        f.update(3.0 * n)
    np.testing.assert_allclose(f.x.ravel(), [33.0, 3e-16], rtol=1e-9)
