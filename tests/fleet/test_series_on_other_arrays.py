"""Whole series on arrays of other libraries: the numbers of NumPy, in the caller's library and dtype."""

from __future__ import annotations

import numpy as np
import pytest

from tests.engines.streams import MODELS
from tests.fleet.fleets import assert_close
from tests.fleet.test_other_arrays import library  # noqa: F401
from ufirext import NonFiniteError, ShapeError, UfirextError, filter_series, series_plan


def measured(model, shape, seed=0):
    return np.random.default_rng(seed).normal(size=(*shape, model.dim_z)).cumsum(axis=-2)


@pytest.mark.parametrize("shape", [(500,), (3, 500), (40,), (1,), (0,)])
@pytest.mark.parametrize("horizon", [5, 60, 200])
@pytest.mark.parametrize("name", ["plane", "unstable", "delayed"])
def test_the_numbers_are_those_of_numpy(library, name, horizon, shape):  # noqa: F811
    model = MODELS[name]
    zs = measured(model, shape)
    estimate = filter_series(model, library.asarray(zs.copy()), horizon)
    x, ready = estimate.x, estimate.ready
    reference = filter_series(model, zs, horizon)
    assert type(x) is type(library.asarray(zs.copy()))
    assert_close(np.asarray(x)[None], reference.x[None], 1e-11)
    np.testing.assert_array_equal(np.asarray(ready), reference.ready)


def test_pieces_are_as_good_as_the_whole(library, monkeypatch):  # noqa: F811
    model = MODELS["plane"]
    zs = measured(model, (2, 700))
    monkeypatch.setattr("ufirext.series.elsewhere.PIECE", 150)
    x = filter_series(model, library.asarray(zs.copy()), 30).x
    assert_close(np.asarray(x), filter_series(model, zs, 30).x, 1e-12)


def test_single_precision_stays(library):  # noqa: F811
    model = MODELS["plane"]
    zs = measured(model, (300,))
    x = filter_series(model, library.asarray(zs.copy(), dtype=library.float32), 20).x
    assert x.dtype == library.float32
    reference = filter_series(model, zs, 20).x
    np.testing.assert_allclose(np.asarray(x), reference, atol=2e-3 * np.nanmax(np.abs(reference)))


def test_lags_and_minimum_variance(library):  # noqa: F811
    model = MODELS["plane"]
    zs = measured(model, (300,))
    for options in ({"lag": 3}, {"noise": (model.Q, model.R)}):
        x = filter_series(model, library.asarray(zs.copy()), 20, **options).x
        assert_close(np.asarray(x)[None], filter_series(model, zs, 20, **options).x[None], 1e-11)


def test_covariances_are_those_of_numpy(library):  # noqa: F811
    model = MODELS["plane"]
    zs = measured(model, (2, 40))
    ours, reference = filter_series(model, library.asarray(zs.copy()), 9), filter_series(model, zs, 9)
    np.testing.assert_array_equal(ours.P, reference.P)
    assert repr(ours) == repr(reference)


def test_refusals(library):  # noqa: F811
    model = MODELS["plane"]
    zs = library.zeros((30, 2), dtype=library.float64)
    with pytest.raises(ShapeError, match=r"zs must have shape \(T, 2\)"):
        filter_series(model, library.zeros((30, 3), dtype=library.float64), 20)
    with pytest.raises(UfirextError, match="zs must have no holes"):
        filter_series(model, library.full((30, 2), float("nan"), dtype=library.float64), 20)
    with pytest.raises(NonFiniteError, match="zs must be finite"):
        filter_series(model, library.full((30, 2), float("inf"), dtype=library.float64), 20)
    with pytest.raises(UfirextError, match="delays must come with a NumPy array zs"):
        filter_series(model, zs, 20, delays=[0] * 30)
    with pytest.raises(UfirextError, match="Fs and engine='stepwise' must come with"):
        filter_series(model, zs, 20, Fs=[model.F] * 30, engine="stepwise")
    noise = (model.Q, model.R)
    assert series_plan(model, 20, 3, noise).head is None
    with pytest.raises(UfirextError, match="step by step"):
        filter_series(model, zs, 20, lag=3, noise=noise)
