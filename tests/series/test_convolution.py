"""Convolutions by blocks and moments are the sums they stand for, whatever the lengths."""

from __future__ import annotations

import numpy as np
import pytest

from tests.series.test_filter_series import assert_same, measured
from ufirext import filter_series, kinematic, ufir_gain
from ufirext.series.summed import Summed
from ufirext.series.toeplitz import convolution, convolve

MODELS = {
    "velocity": kinematic(1, 1, 0.1),
    "two axes": kinematic(1, 2, 0.1),
    "acceleration": kinematic(2, 1, 0.1),
}


def gain_taps(model, horizon):
    """(horizon, dim_z, dim_x), oldest first."""
    K = ufir_gain(model, horizon).K
    return np.ascontiguousarray(K.reshape(model.dim_x, horizon, -1).transpose(1, 2, 0))


def summed_up(taps, z):
    """The definition, in extended precision, and what the sum would be if nothing cancelled."""
    taps, z = taps.astype(np.longdouble), z.astype(np.longdouble)
    windows = np.lib.stride_tricks.sliding_window_view(z, len(taps), axis=0)  # (T', inputs, length)
    return tuple(np.einsum("tmi,imk->tk", w, g) for w, g in ((windows, taps), (abs(windows), abs(taps))))


def assert_convolves(taps, steps):
    op = convolution(taps, steps)
    count = -(-150 // op.block)
    z = np.random.default_rng(len(taps)).normal(size=(op.history + count * op.block, op.inputs))
    expected, size = summed_up(taps, z)
    result = np.empty((count * op.block, op.outputs))
    Summed(op)(z, result)
    for y in (convolve(op, z), result):
        assert (np.abs(y - expected) <= 2e-14 * size.max(axis=0)).all()


@pytest.mark.parametrize("name", MODELS)
def test_gains_of_every_length(name):
    """Lengths that blocks divide and lengths they do not: edges, partial blocks, moments of moments."""
    levels = set()
    for horizon in [*range(3, 130), 500, 997]:
        taps = gain_taps(MODELS[name], horizon)
        levels.add(convolution(taps).levels)
        assert_convolves(taps, 16_384)
    assert {1, 2, 3} <= levels


@pytest.mark.parametrize("steps", [1, 100, 10_000])
@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 3, 1), (40, 1, 1), (90, 2, 5), (300, 1, 2)])
def test_taps_that_are_no_sums_of_exponentials(shape, steps):
    taps = np.random.default_rng(1).normal(size=shape)
    assert convolution(taps, steps).levels == 1
    assert_convolves(taps, steps)


def test_sums_of_more_exponentials_than_outputs_have_longer_blocks():
    """The moments of six would not fit into the blocks that are cheapest for one."""
    times = np.arange(400)[:, None]
    taps = np.cos(times * np.array([0.01, 0.02, 0.05])).sum(axis=1)[:, None, None]
    assert convolution(taps).levels > 1
    assert_convolves(taps, 16_384)


@pytest.mark.parametrize("horizon", [10, 100])
@pytest.mark.parametrize(("steps", "count"), [(200, 77), (5000, 3), (18_000, 2)])
def test_a_series_has_the_same_bits_in_any_company_and_place(horizon, steps, count):
    """Long pieces are added up series by series, short ones side by side; out may be anywhere."""
    for model in (kinematic(1, 2, 0.1), kinematic(2, 3, 0.1)):
        zs = measured(model, steps, count=count)
        together = filter_series(model, zs, horizon).x
        spread = np.empty((count, steps, 2 * model.dim_x))[..., ::2]
        filter_series(model, zs, horizon, out=spread)
        np.testing.assert_array_equal(spread, together)
        for one, z in zip(together, zs, strict=True):
            np.testing.assert_array_equal(one, filter_series(model, z, horizon).x)


def test_long_series_are_the_stream():
    model = kinematic(1, 1, 0.1)
    zs = measured(model, 3000)
    assert_same(filter_series(model, zs, 90), filter_series(model, zs, 90, engine="stepwise"))
