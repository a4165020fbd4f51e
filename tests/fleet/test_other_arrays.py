"""Fleets on arrays of other libraries: the same numbers, in the caller's library and dtype."""

from __future__ import annotations

import builtins
import copy
import pickle

import numpy as np
import pytest

from tests.engines.streams import MODELS
from tests.fleet.fleets import Traffic, assert_close
from ufirext import Fleet, NonFiniteError, UfirextError

PLANE = MODELS["plane"]
LIBRARIES = ["array_api_strict", "torch", "jax.numpy"]


@pytest.fixture(params=LIBRARIES)
def library(request):
    pytest.importorskip("array_api_compat")
    module = pytest.importorskip(request.param)
    if request.param == "jax.numpy":
        pytest.importorskip("jax").config.update("jax_enable_x64", True)
    return module


@pytest.mark.parametrize("late", [0.0, 0.2])
@pytest.mark.parametrize("missing", ["extend", "skip"])
def test_the_numbers_are_those_of_numpy(library, missing, late):
    traffic = Traffic(PLANE, 7, 45, lost=0.3, component=0.1, late=late)
    traffic.Z[15:35, 0] = np.nan
    traffic.Z[:, 3] = np.nan
    ours, reference = Fleet(PLANE, 6, 7, missing=missing), Fleet(PLANE, 6, 7, missing=missing)
    for Z, delay in zip(traffic.Z, traffic.delays, strict=True):
        X = ours.step(library.asarray(Z.copy()), delay)
        assert type(X) is type(library.asarray(Z.copy()))
        assert X.dtype == library.float64
        assert_close(np.asarray(X), reference.step(Z, delay), 1e-12)
        np.testing.assert_array_equal(ours.ready, reference.ready)
    assert_close(ours.covariance(), reference.covariance(), 1e-12)


def test_single_precision_stays(library):
    fleet = Fleet(PLANE, 6, 4)
    for Z in Traffic(PLANE, 4, 20, lost=0.2).Z:
        X = fleet.step(library.asarray(Z.copy(), dtype=library.float32))
    assert X.dtype == library.float32


def test_joins_leaves_and_files(library, tmp_path):
    rng = np.random.default_rng(0)
    fleet, reference = Fleet(PLANE, 5, 3), Fleet(PLANE, 5, 3)
    for n in range(30):
        if n == 10:
            for f in (fleet, reference):
                f.leave([1])
        if n == 14:
            assert fleet.join(2).tolist() == reference.join(2).tolist()
        if n == 20:
            fleet.save(tmp_path / "fleet.npz")
            fleet = Fleet.load(tmp_path / "fleet.npz", like=library.zeros(1, dtype=library.float64))
        Z = rng.normal(size=(fleet.tracks, 2))
        Z[~fleet.active] = np.nan
        Z[rng.random(len(Z)) < 0.2] = np.nan
        X = fleet.step(library.asarray(Z.copy()))
        assert_close(np.asarray(X), reference.step(Z), 1e-12)


@pytest.mark.parametrize("clone", [copy.deepcopy, lambda f: pickle.loads(pickle.dumps(f))])
def test_copies_stay_in_the_library_and_go_on_independently(library, clone):
    traffic = Traffic(PLANE, 4, 30, lost=0.2, late=0.2)
    fleet = Fleet(PLANE, 5, 4)
    for Z, delay in zip(traffic.Z[:14], traffic.delays[:14], strict=True):
        fleet.step(library.asarray(Z.copy(), dtype=library.float32), delay)
    twin = clone(fleet)
    for Z, delay in zip(traffic.Z[14:], traffic.delays[14:], strict=True):
        X = fleet.step(library.asarray(Z.copy(), dtype=library.float32), delay)
    for Z, delay in zip(traffic.Z[14:], traffic.delays[14:], strict=True):
        Y = twin.step(library.asarray(Z.copy(), dtype=library.float32), delay)
    assert type(Y) is type(X)
    assert Y.dtype == X.dtype == library.float32
    np.testing.assert_array_equal(np.asarray(Y), np.asarray(X))


def test_another_library_than_before_is_refused(library):
    fleet = Fleet(PLANE, 5, 2)
    fleet.step(library.zeros((2, 2), dtype=library.float64))
    with pytest.raises(UfirextError, match="as before"):
        fleet.step(np.zeros((2, 2)))
    numpys = Fleet(PLANE, 5, 2)
    numpys.step(np.zeros((2, 2)))
    with pytest.raises(UfirextError, match="must be a NumPy array, as before"):
        numpys.step(library.zeros((2, 2), dtype=library.float64))


def test_infinities_are_refused(library):
    with pytest.raises(NonFiniteError, match="Z must be finite"):
        Fleet(PLANE, 5, 1).step(library.asarray([[1.0, float("inf")]]))


def test_without_array_api_compat_the_message_says_the_command(library, monkeypatch):
    real = builtins.__import__

    def absent(name, *args, **kwargs):
        if name.partition(".")[0] == "array_api_compat":
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", absent)
    with pytest.raises(ImportError, match=r"pip install 'ufirext\[arrays\]'"):
        Fleet(PLANE, 5, 1).step(library.asarray([[1.0, 2.0]]))
    assert Fleet(PLANE, 5, 1).step(np.zeros((1, 2))).shape == (1, 4)
