"""A fleet survives a file to the bit; what is no such file is refused."""

from __future__ import annotations

import numpy as np
import pytest

from tests.engines.streams import MODELS
from tests.fleet.fleets import Traffic
from ufirext import Fleet, UfirextError

PLANE = MODELS["plane"]


@pytest.mark.parametrize("missing", ["extend", "skip"])
@pytest.mark.parametrize("late", [0.0, 0.3])
@pytest.mark.parametrize("at", [0, 3, 25])
def test_a_fleet_goes_on_from_its_file_to_the_bit(at, late, missing, tmp_path):
    traffic = Traffic(PLANE, 6, 50, lost=0.3, component=0.1, late=late)
    fleet = Fleet(PLANE, 7, 6, missing=missing)
    fleet.leave(4)
    traffic.Z[:, 4] = np.nan
    for Z, delay in zip(traffic.Z[:at], traffic.delays[:at], strict=True):
        fleet.step(Z, delay)
    fleet.save(tmp_path / "fleet.npz")
    again = Fleet.load(tmp_path / "fleet.npz")
    assert repr(again) == repr(fleet)
    for Z, delay in zip(traffic.Z[at:], traffic.delays[at:], strict=True):
        np.testing.assert_array_equal(fleet.step(Z, delay), again.step(Z, delay))
        np.testing.assert_array_equal(fleet.ready, again.ready)
    np.testing.assert_array_equal(fleet.covariance(), again.covariance())
    np.testing.assert_array_equal(fleet.dropped, again.dropped)
    assert fleet.join().tolist() == again.join().tolist() == [4]


def test_single_precision_survives(tmp_path):
    fleet = Fleet(PLANE, 5, 3)
    for Z in Traffic(PLANE, 3, 8).Z:
        fleet.step(Z.astype(np.float32))
    fleet.save(tmp_path / "f")
    again = Fleet.load(tmp_path / "f")
    assert again.x.dtype == np.float32
    np.testing.assert_array_equal(again.x, fleet.x)


def saved(path):
    fleet = Fleet(PLANE, 5, 3)
    for Z in Traffic(PLANE, 3, 20, lost=0.3).Z:
        fleet.step(Z)
    fleet.save(path)
    return path


def test_a_file_with_any_damaged_number_is_refused(tmp_path):
    whole = saved(tmp_path / "fleet.npz").read_bytes()
    x = Fleet.load(tmp_path / "fleet.npz").x
    rng = np.random.default_rng(0)
    refused = 0
    for place in rng.integers(0, len(whole), 150).tolist():
        damaged = bytearray(whole)
        damaged[place] ^= 1 << int(rng.integers(8))
        (tmp_path / "damaged.npz").write_bytes(damaged)
        try:
            again = Fleet.load(tmp_path / "damaged.npz")
        except UfirextError:
            refused += 1
        else:
            # Only what carries no content of the fleet (dates of the archive) may differ unseen.
            np.testing.assert_array_equal(again.x, x)
    assert refused > 75


@pytest.mark.parametrize("fraction", [0.0, 0.2, 0.6, 0.999])
def test_a_truncated_file_is_refused(fraction, tmp_path):
    whole = saved(tmp_path / "fleet.npz").read_bytes()
    (tmp_path / "half.npz").write_bytes(whole[: int(fraction * len(whole))])
    with pytest.raises(UfirextError, match=r"half\.npz must be a file written by Fleet\.save"):
        Fleet.load(tmp_path / "half.npz")


def test_foreign_files_are_refused(tmp_path):
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(UfirextError, match="another npz file"):
        Fleet.load(tmp_path / "other.npz")
    (tmp_path / "text.npz").write_text("no zip")
    with pytest.raises(UfirextError, match="damaged"):
        Fleet.load(tmp_path / "text.npz")
    with pytest.raises(FileNotFoundError):
        Fleet.load(tmp_path / "none.npz")


def rewritten(path, **changes):
    with np.load(path) as stored:
        content = dict(stored)
    content |= changes
    np.savez(path, **{name: a for name, a in content.items() if a is not None})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("version", 99),
        ("horizon", 6),
        ("x", np.zeros((3, 3))),
        ("x", None),
        ("needs", np.zeros(3, np.int32)),
        ("ready", np.ones(2, bool)),
        ("values", np.zeros((4, 2, 3))),
        ("F", np.eye(3)),
        ("missing", "predict"),
    ],
)
def test_a_file_that_does_not_fit_together_is_refused(name, value, tmp_path):
    path = saved(tmp_path / "fleet.npz")
    rewritten(path, **{name: value})
    with pytest.raises(UfirextError, match=r"fleet\.npz must"):
        Fleet.load(path)


def test_a_write_that_fails_leaves_the_older_file(tmp_path, monkeypatch):
    path = saved(tmp_path / "fleet.npz")
    before = path.read_bytes()

    def broken(stream, **content):
        stream.write(b"half of it")
        raise OSError("no space left on device")

    monkeypatch.setattr("numpy.savez", broken)
    with pytest.raises(OSError, match="no space"):
        Fleet(PLANE, 5, 2).save(path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["fleet.npz"]
