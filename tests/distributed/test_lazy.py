"""Dask and xarray: lazily, by parts, the numbers of the serial run."""

from __future__ import annotations

import numpy as np
import pytest

from tests.engines.streams import MODELS
from ufirext import ShapeError, UfirextError, filter_series, kinematic, series_plan
from ufirext.distributed import BeyondOverlap
from ufirext.distributed import filter_dataarray as named
from ufirext.distributed import filter_series as lazily
from ufirext.errors import HorizonError, NonFiniteError

da = pytest.importorskip("dask.array")
PLANE = MODELS["plane"]


@pytest.fixture(autouse=True)
def _in_this_thread():
    dask = pytest.importorskip("dask")
    with dask.config.set(scheduler="synchronous"):
        yield


def measured(steps, series=None, model=PLANE, seed=0):
    shape = (steps, model.dim_z) if series is None else (series, steps, model.dim_z)
    return np.random.default_rng(seed).normal(size=shape).cumsum(axis=-2)


def same(ours, theirs, tolerance=1e-12):
    np.testing.assert_array_equal(np.isnan(ours), np.isnan(theirs))
    assert np.nanmax(np.abs(ours - theirs), initial=0.0) <= tolerance * np.nanmax(np.abs(theirs), initial=1.0)


@pytest.mark.parametrize("series", [None, 3])
@pytest.mark.parametrize("chunks", [24, 100, 1000, 5000])
def test_parts_on_dask_are_the_whole(chunks, series):
    zs = measured(1003, series)
    estimate = lazily(PLANE, zs, 25, chunks=chunks)
    reference = filter_series(PLANE, zs, 25)
    assert isinstance(estimate.x, da.Array)
    x, ready = estimate.x.compute(), estimate.ready.compute()
    same(x, reference.x)
    np.testing.assert_array_equal(ready, reference.ready)
    assert (estimate.horizon, estimate.lag, estimate.overlap) == (25, 0, 24)


@pytest.mark.parametrize("series", [None, 3])
@pytest.mark.parametrize("horizon", [12, 300])
def test_aligned_parts_have_the_bits_of_the_serial_run(horizon, series):
    model = kinematic(1, 1, 0.1)
    grid = series_plan(model, horizon).alignment
    zs = measured(3 * grid + 777, series, model)
    aligned = lazily(model, zs, horizon, chunks=grid)
    if series is not None:
        assert not aligned.aligned, "parts hold one series each"
        zs = da.from_array(zs, chunks=(-1, grid, 1))
        aligned = lazily(model, zs, horizon)
        zs = zs.compute()
    assert aligned.aligned
    np.testing.assert_array_equal(aligned.x.compute(), filter_series(model, zs, horizon).x)
    assert not lazily(model, zs, horizon, chunks=grid - 1).aligned


def test_a_dask_array_keeps_its_own_parts():
    zs = da.from_array(measured(1000), chunks=(300, 1))
    estimate = lazily(PLANE, zs, 25)
    assert estimate.x.chunks == ((300, 300, 300, 100), (4,))
    same(estimate.x.compute(), filter_series(PLANE, zs.compute(), 25).x)


def test_parts_shorter_than_the_overlap_are_joined():
    zs = da.from_array(measured(1000), chunks=(10, 2))
    estimate = lazily(PLANE, zs, 25)
    assert min(estimate.x.chunks[0]) >= 24
    same(estimate.x.compute(), filter_series(PLANE, zs.compute(), 25).x)
    tail = lazily(PLANE, measured(1005), 25, chunks=100)
    assert tail.x.chunks[0] == (100,) * 9 + (105,)


def test_many_short_series_share_parts():
    zs = measured(50, 40)
    estimate = lazily(PLANE, zs, 10)
    assert estimate.x.chunks == ((40,), (50,), (4,))
    same(estimate.x.compute(), filter_series(PLANE, zs, 10).x)


def test_nothing_is_computed_before_it_is_asked_for():
    def never(block):
        raise AssertionError("computed")

    zs = da.zeros((1000, 2), chunks=100).map_blocks(never, dtype=float, meta=np.empty((0, 0)))
    estimate = lazily(PLANE, zs, 20)
    assert estimate.x.shape == (1000, 4)
    with pytest.raises(AssertionError, match="computed"):
        estimate.x.compute()


@pytest.mark.parametrize("series", [None, 2])
@pytest.mark.parametrize("lag", [0, 4])
def test_lags_delays_and_inputs(lag, series):
    model = MODELS["velocity"].replace(B=[[0.5], [1.0]])
    rng = np.random.default_rng(1)
    zs = measured(400, series, model)
    us = rng.normal(size=zs.shape)
    delays = np.minimum(rng.integers(0, 4, zs.shape[:-1]), np.arange(400))
    options = {"lag": lag, "us": us, "delays": delays}
    estimate = lazily(model, zs, 12, chunks=130, **options)
    assert estimate.overlap == 11 + lag + 3
    reference = filter_series(model, zs, 12, **options)
    same(estimate.x.compute(), np.where(reference.ready[..., None], reference.x, np.nan), 1e-10)


def test_gaps_within_the_overlap_are_exact_and_longer_ones_are_refused():
    zs = measured(600)
    zs[195:205] = np.nan
    with pytest.raises(BeyondOverlap, match="overlap="):
        lazily(PLANE, zs, 8, chunks=200).x.compute()
    reference = filter_series(PLANE, zs, 8)
    same(lazily(PLANE, zs, 8, chunks=200, overlap=60).x.compute(), reference.x, 1e-11)
    same(lazily(PLANE, zs, 8, chunks=200, missing="skip").x.compute(),
         filter_series(PLANE, zs, 8, missing="skip").x, 1e-11)  # fmt: skip


def test_short_and_empty_series():
    for steps in (1, 3, 24):
        zs = measured(steps)
        same(lazily(PLANE, zs, 25).x.compute(), filter_series(PLANE, zs, 25).x)
    assert lazily(PLANE, np.empty((0, 2)), 25).x.compute().shape == (0, 4)


def test_lists_vectors_and_strides():
    model = MODELS["velocity"]
    zs = np.arange(300.0)
    reference = filter_series(model, zs[::2], 9).x
    same(lazily(model, zs[::2], 9, chunks=40).x.compute(), reference)
    same(lazily(model, zs[::2].tolist(), 9, chunks=40).x.compute(), reference)
    single = lazily(model, zs[::2].astype(np.float32), 9, chunks=40).x.compute()
    same(single, reference, 1e-6)


def test_a_memory_mapped_series(tmp_path):
    zs = measured(2000)
    np.save(tmp_path / "z.npy", zs)
    mapped = np.load(tmp_path / "z.npy", mmap_mode="r")
    same(lazily(PLANE, mapped, 25, chunks=300).x.compute(), filter_series(PLANE, zs, 25).x)


@pytest.mark.parametrize("chunked", [False, True])
def test_masked_entries_are_missing(chunked):
    zs = np.ma.array(measured(300), mask=np.random.default_rng(1).random((300, 2)) < 0.1)
    expected = filter_series(PLANE, zs.filled(np.nan), 9).x
    same(lazily(PLANE, da.from_array(zs, chunks=150) if chunked else zs, 9, chunks=150).x.compute(), expected)
    delays = np.ma.array(np.zeros(300, int), mask=np.arange(300) == 200)
    with pytest.raises(NonFiniteError, match="delays must have no masked entries"):
        lazily(PLANE, zs, 9, delays=da.from_array(delays) if chunked else delays, longest_delay=2).x.compute()


def test_refusals():
    with pytest.raises(ShapeError, match=r"zs must have shape \(T, 2\)"):
        lazily(PLANE, np.zeros((10, 3)), 5)
    with pytest.raises(HorizonError, match="chunks must be at least 24, got 10"):
        lazily(PLANE, measured(100), 25, chunks=10)
    with pytest.raises(UfirextError, match="longest_delay must be given"):
        lazily(PLANE, measured(100), 5, delays=da.zeros(100, dtype=int))
    for zs in (np.zeros((100, 2), "M8[s]"), [["1", "2"]] * 100, da.zeros((100, 2), dtype="m8[s]")):
        with pytest.raises(ShapeError, match="zs must be an array of real numbers"):
            lazily(PLANE, zs, 5)
    with pytest.raises(ShapeError, match="must begin with the axes"):
        lazily(PLANE, measured(100), 5, delays=np.zeros(99, int))


class TestNamedDimensions:
    @pytest.fixture(autouse=True)
    def _xarray(self):
        self.xr = pytest.importorskip("xarray")

    def array(self, values, *dims, **coords):
        return self.xr.DataArray(values, dims=dims, coords=coords, attrs={"unit": "m"}, name="range")

    def test_names_coordinates_and_attributes_stay(self):
        values = measured(400, 3)
        zs = self.array(values.transpose(1, 2, 0), "time", "axis", "ship", ship=["a", "b", "c"],
                        time=np.arange(400) * 0.5)  # fmt: skip
        x = named(PLANE, zs, 20, component="axis")
        assert x.dims == ("ship", "time", "state")
        assert x.ship.values.tolist() == ["a", "b", "c"]
        np.testing.assert_array_equal(x.time, zs.time)
        assert x.attrs == {"unit": "m"}
        same(x.sel(ship="b").values, filter_series(PLANE, values[1], 20).x)

    def test_lazy_stays_lazy(self):
        values = measured(900, 2)
        zs = self.array(values, "ship", "time", "axis").chunk({"time": 300})
        x = named(PLANE, zs, 20, component="axis", missing="extend")
        assert x.chunks is not None
        assert x.chunks[1] == (300, 300, 300)
        same(x.compute().values, filter_series(PLANE, values, 20).x)

    def test_one_component_and_two_further_dimensions(self):
        model = MODELS["velocity"]
        values = np.random.default_rng(0).normal(size=(2, 200, 3)).cumsum(axis=1)
        zs = self.array(values, "ship", "time", "sensor").chunk({"time": 50})
        x = named(model, zs, 10, time="time", state="kinematics")
        assert x.dims == ("ship", "sensor", "time", "kinematics")
        same(x.sel(ship=1, sensor=2).values, filter_series(model, values[1, :, 2], 10).x)

    def test_refusals(self):
        zs = self.array(measured(50), "time", "axis")
        with pytest.raises(UfirextError, match="component must name"):
            named(PLANE, zs, 10)
        with pytest.raises(UfirextError, match="dimension 'when', it has 'time', 'axis'"):
            named(PLANE, zs, 10, time="when", component="axis")
        with pytest.raises(UfirextError, match=r"xarray\.DataArray"):
            named(PLANE, zs.values, 10, component="axis")
