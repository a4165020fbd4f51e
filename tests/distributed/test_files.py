"""From file to file: the serial numbers in bounded memory, and on again after a kill."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest

from tests.engines.streams import MODELS
from ufirext import ShapeError, UfirextError, filter_series
from ufirext.distributed import BeyondOverlap, filter_file

PLANE = MODELS["plane"]
ROOT = Path(__file__).parents[2]


def measured(steps, series=None, seed=0):
    shape = (steps, 2) if series is None else (series, steps, 2)
    return np.random.default_rng(seed).normal(size=shape).cumsum(axis=-2)


def written(path, values):
    if path.suffix == ".npy":
        np.save(path, values)
    else:
        zarr = pytest.importorskip("zarr")
        zarr.create_array(path, data=values, chunks=tuple(max(1, s // 3) for s in values.shape))
    return path


def read(path):
    return (
        np.load(path)
        if path.suffix == ".npy"
        else pytest.importorskip("zarr").open_array(path, mode="r")[...]
    )


def same(ours, theirs, tolerance=1e-12):
    np.testing.assert_array_equal(np.isnan(ours), np.isnan(theirs))
    assert np.nanmax(np.abs(ours - theirs), initial=0.0) <= tolerance * np.nanmax(np.abs(theirs), initial=1.0)


@pytest.mark.parametrize("series", [None, 3])
@pytest.mark.parametrize(
    ("inward", "outward"), [("z.npy", "x.npy"), ("z.zarr", "x.zarr"), ("z.npy", "x.zarr")]
)
def test_a_file_of_estimates_is_the_serial_run(inward, outward, series, tmp_path):
    zs = measured(1000, series)
    seen = []
    source = written(tmp_path / inward, zs)
    target = filter_file(
        PLANE,
        source,
        tmp_path / outward,
        25,
        chunk=130,
        progress=lambda done, total: seen.append((done, total)),
    )
    assert target == tmp_path / outward
    same(read(target), filter_series(PLANE, zs, 25).x)
    assert seen[-1] == (zs.size // 2, zs.size // 2)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([inward, outward])


def test_vectors_single_precision_and_integers(tmp_path):
    model = MODELS["velocity"]
    for dtype in (np.float32, np.int32):
        zs = np.arange(500).astype(dtype)
        target = filter_file(model, written(tmp_path / "z.npy", zs), tmp_path / "x.npy", 9, chunk=100)
        same(read(target), filter_series(model, zs, 9).x)


@pytest.mark.parametrize("steps", [0, 1, 10])
def test_series_shorter_than_a_window(steps, tmp_path):
    zs = measured(steps)
    target = filter_file(PLANE, written(tmp_path / "z.npy", zs), tmp_path / "x.npy", 25)
    same(read(target), filter_series(PLANE, zs, 25).x)


def test_two_processes_do_the_same(tmp_path):
    zs = measured(2000)
    target = filter_file(PLANE, written(tmp_path / "z.npy", zs), tmp_path / "x.npy", 25, chunk=300, workers=2)
    same(read(target), filter_series(PLANE, zs, 25).x)


def test_gaps_across_an_edge_are_refused_or_covered(tmp_path):
    zs = measured(600)
    zs[195:205] = np.nan
    source = written(tmp_path / "z.npy", zs)
    with pytest.raises(BeyondOverlap, match="overlap="):
        filter_file(PLANE, source, tmp_path / "x.npy", 8, chunk=200)
    (tmp_path / "x.npy.journal").unlink()
    target = filter_file(PLANE, source, tmp_path / "x.npy", 8, chunk=200, overlap=60)
    same(read(target), filter_series(PLANE, zs, 8).x, 1e-11)


FRUGAL_RUN = """
    import resource, sys
    import numpy as np
    from ufirext import kinematic
    from ufirext.distributed import filter_file

    def peak():
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)

    model = kinematic(1, 1, 0.1)
    np.save("small.npy", np.arange(100_000.0))
    filter_file(model, "small.npy", "y.npy", 100, chunk=50_000)
    before = peak()
    filter_file(model, "z.npy", "x.npy", 100, chunk=50_000)
    print(peak() - before)
"""


def test_memory_grows_with_a_part_and_not_with_the_series(tmp_path):
    pytest.importorskip("resource", reason="this system does not tell peaks")
    np.save(tmp_path / "z.npy", np.arange(4_000_000.0))  # 32 MB in, 64 MB out; a part is 1.2 MB
    (tmp_path / "run.py").write_text(textwrap.dedent(FRUGAL_RUN))
    run = subprocess.run(
        [sys.executable, "run.py"], cwd=tmp_path, capture_output=True, text=True, check=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert int(run.stdout) < 10_000_000


SLOW_RUN = """
    import sys, time
    from ufirext import kinematic
    from ufirext.distributed import filter_file

    def slowly(done, total):
        print(done, flush=True)
        time.sleep(0.1)

    if __name__ == "__main__":
        filter_file(kinematic(1, 2, 0.5, q=0.1, r=4.0), "z{ending}", "x{ending}", 25, chunk=100,
                    progress=slowly, workers={workers})
"""


def kill_after(folder, ending, parts, workers):
    """Start a run in a process of its own and kill it, without warning, after so many parts."""
    script = textwrap.dedent(SLOW_RUN.format(ending=ending, workers=workers))
    (folder / "run.py").write_text(script)
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        [sys.executable, "run.py"], cwd=folder, stdout=subprocess.PIPE, text=True, env=environment
    ) as run:
        for line in run.stdout:
            if int(line) >= 100 * parts:
                run.send_signal(signal.SIGKILL)
                break
        run.wait()
    assert run.returncode == -signal.SIGKILL
    time.sleep(0.5 if workers > 1 else 0.0)  # its workers notice that it has gone


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system has no SIGKILL")
@pytest.mark.parametrize(("ending", "workers"), [(".npy", 1), (".zarr", 1), (".npy", 2)])
def test_a_killed_run_goes_on_after_its_last_whole_part(ending, workers, tmp_path, monkeypatch):
    if ending == ".zarr":
        pytest.importorskip("zarr")
    monkeypatch.chdir(tmp_path)
    zs = measured(1500)
    written(tmp_path / f"z{ending}", zs)
    kill_after(tmp_path, ending, 5, workers)
    assert not (tmp_path / f"x{ending}").exists(), "half a result does not pass for a whole one"
    assert (tmp_path / f"x{ending}.part").exists()
    journal = tmp_path / f"x{ending}.journal"
    finished = len(journal.read_text().split()[-5:])
    assert finished >= 5
    with journal.open("a") as stream:
        stream.write("1")  # a line the kill has torn
    seen = []
    filter_file(
        PLANE, f"z{ending}", f"x{ending}", 25, chunk=100, progress=lambda done, total: seen.append(done)
    )
    assert seen[0] >= 500, "what was done is not done again"
    assert seen[-1] == 1500
    same(read(tmp_path / f"x{ending}"), filter_series(PLANE, zs, 25).x)
    assert not journal.exists()


def broken_off(tmp_path, **options):
    """A run that fails after its second part, for a reason of its own."""

    class Enough(Exception):
        pass

    def stop(done, total):
        if done >= 200:
            raise Enough

    with pytest.raises(Enough):
        filter_file(PLANE, tmp_path / "z.npy", tmp_path / "x.npy", 25, chunk=100, progress=stop, **options)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"horizon": 24}, "task"),
        ({"chunk": 50}, "chunk"),
        ({"lag": 1}, "task"),
        ({"model": "other"}, "model"),
    ],
)
def test_going_on_with_other_arguments_is_refused(changes, named, tmp_path):
    written(tmp_path / "z.npy", measured(1000))
    broken_off(tmp_path)
    arguments = {"model": PLANE, "horizon": 25, "chunk": 100} | changes
    if changes.get("model"):
        arguments["model"] = PLANE.replace(R=9.0)
    with pytest.raises(UfirextError, match=f"another {named}.* delete it to begin anew"):
        filter_file(source=tmp_path / "z.npy", target=tmp_path / "x.npy", **arguments)


def test_going_on_with_another_source_is_refused(tmp_path):
    written(tmp_path / "z.npy", measured(1000))
    broken_off(tmp_path)
    zs = measured(1000, seed=1)
    written(tmp_path / "z.npy", zs)
    os.utime(tmp_path / "z.npy", ns=(1, 1))
    with pytest.raises(UfirextError, match="another source"):
        filter_file(PLANE, tmp_path / "z.npy", tmp_path / "x.npy", 25, chunk=100)
    (tmp_path / "x.npy.journal").unlink()
    filter_file(PLANE, tmp_path / "z.npy", tmp_path / "x.npy", 25, chunk=100)
    same(read(tmp_path / "x.npy"), filter_series(PLANE, zs, 25).x)


def test_an_older_result_is_replaced_only_by_a_whole_one(tmp_path):
    written(tmp_path / "z.npy", measured(1000))
    np.save(tmp_path / "x.npy", np.zeros(3))
    broken_off(tmp_path)
    np.testing.assert_array_equal(read(tmp_path / "x.npy"), np.zeros(3))
    filter_file(PLANE, tmp_path / "z.npy", tmp_path / "x.npy", 25, chunk=100)
    assert read(tmp_path / "x.npy").shape == (1000, 4)


def test_refusals(tmp_path):
    written(tmp_path / "z.npy", np.zeros((50, 3)))
    with pytest.raises(ShapeError, match=r"z\.npy must have shape \(T, 2\)"):
        filter_file(PLANE, tmp_path / "z.npy", tmp_path / "x.npy", 5)
    with pytest.raises(UfirextError, match=r"end in \.npy or \.zarr, got 'z\.csv'"):
        filter_file(PLANE, tmp_path / "z.csv", tmp_path / "x.npy", 5)
    with pytest.raises(FileNotFoundError):
        filter_file(PLANE, tmp_path / "none.npy", tmp_path / "x.npy", 5)
