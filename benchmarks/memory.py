"""`python -m benchmarks.memory`: the peak memory of long series and large fleets, each in a fresh process."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

__all__ = ["JOBS", "peak_of"]

# What is run, with its size in {size} and in a folder of its own. Every job prints what its data take.
JOBS = {
    "series": """
from ufirext.distributed import filter_file
with open("z.npy", "wb") as stream:
    np.lib.format.write_array_header_1_0(
        stream, dict(descr="<f8", fortran_order=False, shape=({size}, 1))
    )
    for start in range(0, {size}, 100_000):
        np.arange(start, min(start + 100_000, {size}), dtype=float).tofile(stream)
filter_file(kinematic(1, 1, 0.1), "z.npy", "x.npy", 300)
data = 3 * 8 * {size}
""",
    "fleet": """
fleet, rng = Fleet(kinematic(1, 2, 0.1), 10, {size}), np.random.default_rng(0)
for tick in range(25):
    fleet.step(rng.normal(size=({size}, 2)))
data = fleet.nbytes
""",
    "fleet, 10 % lost": """
fleet, rng = Fleet(kinematic(1, 2, 0.1), 10, {size}), np.random.default_rng(0)
for tick in range(40):
    z = rng.normal(size=({size}, 2))
    z[rng.random({size}) < 0.1] = np.nan
    fleet.step(z)
data = fleet.nbytes
""",
}

FRAME = """
import json, resource, sys
import numpy as np
from ufirext import Fleet, kinematic, ufir_gain
ufir_gain(kinematic(1, 1, 0.1), 300)  # what every program loads

def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)

before = peak()
{job}
print(json.dumps([data, peak() - before, peak()]))
"""


def peak_of(job: str, size: int) -> tuple[int, int, int]:
    """Bytes of a job's data, of memory it takes beyond what importing takes, and of its whole process."""
    script = FRAME.format(job=JOBS[job].format(size=size))
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "job.py").write_text(script, encoding="utf-8")
        run = subprocess.run(
            [sys.executable, "job.py"], cwd=folder, capture_output=True, text=True, check=True
        )
    data, grown, whole = json.loads(run.stdout)
    return data, grown, whole


def main(
    samples: Annotated[int, typer.Option(min=1, help="Rows of the long series.")] = 10_000_000,
    tracks: Annotated[int, typer.Option(min=1, help="Tracks of the fleet.")] = 100_000,
) -> None:
    """Print the peak memory of a long series from file to file, and of a fleet."""
    table = Table("work", "data, MB", "peak beyond imports, MB", "whole process, MB")
    sizes = {job: samples if job == "series" else tracks for job in JOBS}
    for job, size in sizes.items():
        cells = (f"{number / 1e6:.0f}" for number in peak_of(job, size))
        table.add_row(f"{job}, {size:.0e}".replace("e+0", "e"), *cells)
    Console().print(table)


if __name__ == "__main__":
    typer.run(main)
