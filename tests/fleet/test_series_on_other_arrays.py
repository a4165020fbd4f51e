"""Whole series on arrays of other libraries: the numbers of NumPy, in the caller's library and dtype."""

from __future__ import annotations

import numpy as np
import pytest

from tests.engines.streams import MODELS
from tests.fleet.fleets import assert_close
from tests.fleet.test_other_arrays import library  # noqa: F401
from ufirext import NonFiniteError, ShapeError, UfirextError, filter_series, series_plan
from ufirext._array_series import filtered


def measured(model, shape, seed=0):
    return np.random.default_rng(seed).normal(size=(*shape, model.dim_z)).cumsum(axis=-2)


@pytest.mark.parametrize("shape", [(500,), (3, 500), (40,), (1,), (0,)])
@pytest.mark.parametrize("horizon", [5, 60, 200])
@pytest.mark.parametrize("name", ["plane", "unstable", "delayed"])
def test_the_numbers_are_those_of_numpy(library, name, horizon, shape):  # noqa: F811
    model = MODELS[name]
    zs = measured(model, shape)
    x, ready = filtered(series_plan(model, horizon), library.asarray(zs.copy()))
    reference = filter_series(model, zs, horizon)
    assert type(x) is type(library.asarray(zs.copy()))
    assert_close(np.asarray(x)[None], reference.x[None], 1e-11)
    np.testing.assert_array_equal(np.asarray(ready), reference.ready)


def test_pieces_are_as_good_as_the_whole(library, monkeypatch):  # noqa: F811
    model = MODELS["plane"]
    zs = measured(model, (2, 700))
    monkeypatch.setattr("ufirext._array_series.PIECE", 150)
    x, _ = filtered(series_plan(model, 30), library.asarray(zs.copy()))
    assert_close(np.asarray(x), filter_series(model, zs, 30).x, 1e-12)


def test_single_precision_stays(library):  # noqa: F811
    model = MODELS["plane"]
    zs = measured(model, (300,))
    x, _ = filtered(series_plan(model, 20), library.asarray(zs.copy(), dtype=library.float32))
    assert x.dtype == library.float32
    reference = filter_series(model, zs, 20).x
    np.testing.assert_allclose(np.asarray(x), reference, atol=2e-3 * np.nanmax(np.abs(reference)))


def test_lags_and_minimum_variance(library):  # noqa: F811
    model = MODELS["plane"]
    zs = measured(model, (300,))
    for options in ({"lag": 3}, {"noise": (model.Q, model.R)}):
        x, _ = filtered(series_plan(model, 20, **options), library.asarray(zs.copy()))
        assert_close(np.asarray(x)[None], filter_series(model, zs, 20, **options).x[None], 1e-11)


def test_refusals(library):  # noqa: F811
    plan = series_plan(MODELS["plane"], 20)
    with pytest.raises(ShapeError, match=r"zs must have shape \(T, 2\)"):
        filtered(plan, library.zeros((30, 3), dtype=library.float64))
    with pytest.raises(UfirextError, match="zs must have no holes"):
        filtered(plan, library.full((30, 2), float("nan"), dtype=library.float64))
    with pytest.raises(NonFiniteError, match="zs must be finite"):
        filtered(plan, library.full((30, 2), float("inf"), dtype=library.float64))
    lagged = series_plan(MODELS["plane"], 20, 3, (MODELS["plane"].Q, MODELS["plane"].R))
    if lagged.head is None:
        with pytest.raises(UfirextError, match="step by step"):
            filtered(lagged, library.zeros((30, 2), dtype=library.float64))
