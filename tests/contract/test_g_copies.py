"""G: a copy of a filter is a filter, its window included."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
from filterpy.common import copy_states

from .models import assert_same, constant_velocity, plane, run, walk

COPIES = pytest.mark.parametrize(
    "clone", [copy.deepcopy, lambda f: pickle.loads(pickle.dumps(f))], ids=["deepcopy", "pickle"]
)
SAME = 1e-11  # a copy may compute the same in another order
STEPS = pytest.mark.parametrize("steps", [0, 1, 7, 50])


def messy(rng, steps):
    """Measurements with gaps, one nan-free list per step."""
    return [None if n % 6 == 4 else z for n, z in enumerate(walk(rng, steps, 2))]


@pytest.mark.contract("49-50")
@COPIES
@STEPS
def test_a_copy_goes_on_as_the_original(make, column, rng, clone, steps):
    f = plane(make, column)
    zs = messy(rng, steps + 45)
    run(f, zs[:steps])
    twin = clone(f)
    assert type(twin) is type(f)
    assert_same(f, twin, SAME)
    for z in zs[steps:]:
        run(f, [z])
        run(twin, [z])
        np.testing.assert_allclose(f.x, twin.x, rtol=SAME, atol=SAME)
    assert_same(f, twin, SAME)


@pytest.mark.contract("49-50")
@COPIES
def test_a_copy_between_predict_and_update(make, column, rng, clone):
    f = plane(make, column)
    zs = messy(rng, 60)
    run(f, zs[:20])
    f.predict()
    f.x[0] += 3.0
    twin = clone(f)
    f.update(zs[20])
    twin.update(zs[20])
    run(f, zs[21:])
    run(twin, zs[21:])
    assert_same(f, twin, SAME)


@pytest.mark.contract(51)
@COPIES
@STEPS
def test_copies_share_nothing(make, column, rng, clone, steps):
    f, untouched = plane(make, column), plane(make, column)
    zs = messy(rng, steps + 30)
    run(f, zs[:steps])
    run(untouched, zs[:steps])
    other = clone(f)
    for name in ("x", "P", "F", "H", "Q", "R"):
        getattr(other, name)[...] *= 2.0
    run(other, [[1e3, -1e3], None, [5.0, 5.0]])
    assert_same(f, untouched, SAME)
    run(f, zs[steps:])
    run(untouched, zs[steps:])
    assert_same(f, untouched, SAME)


@pytest.mark.contract(52)
@STEPS
@pytest.mark.parametrize("used", [0, 25], ids=["fresh", "used"])
def test_copy_states_makes_the_destination_go_on_as_the_source(make, column, rng, steps, used):
    source, destination = plane(make, column), make(4, 2)
    zs = messy(rng, steps + 45)
    run(source, zs[:steps])
    if used:
        destination = plane(make, not column, q=9.0)
        run(destination, walk(rng, used, 2))
    copy_states(destination, source)
    assert_same(source, destination, SAME)
    for z in zs[steps:]:
        run(source, [z])
        run(destination, [z])
        np.testing.assert_allclose(source.x, destination.x, rtol=SAME, atol=SAME)
    assert_same(source, destination, SAME)


@pytest.mark.contract(52)
def test_copy_states_shares_nothing(make, rng):
    source, destination, untouched = (plane(make) for _ in range(3))
    zs = messy(rng, 60)
    run(source, zs[:30])
    run(untouched, zs[:30])
    copy_states(destination, source)
    destination.F[0, 1] = 7.0
    run(destination, [[1e3, 1e3], None])
    run(source, zs[30:])
    run(untouched, zs[30:])
    assert_same(source, untouched, SAME)


@pytest.mark.contract(58)
def test_a_copy_carries_the_live_window_only(make, column):
    """Its size depends on the horizon and not on the age of the filter."""
    f = constant_velocity(make, column)
    run(f, [n if n % 5 else None for n in range(200)])
    young = len(pickle.dumps(f))
    run(f, [n if n % 5 else None for n in range(200, 3000)])
    assert len(pickle.dumps(f)) < 1.2 * young + 100


@pytest.mark.contract(51)
def test_filters_of_one_class_share_nothing(make, rng):
    f, g, alone = plane(make), plane(make), plane(make)
    for z in messy(rng, 60):
        run(f, [z])
        run(g, [[1e3, 7.0]])
        run(alone, [z])
        np.testing.assert_array_equal(f.x, alone.x)
