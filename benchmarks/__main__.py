"""Pin the linear algebra to one thread, then hand over to the command line."""

from __future__ import annotations

import os

# The threads of a BLAS are fixed when NumPy is first imported, hence the late import below.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

if __name__ == "__main__":
    from benchmarks.cli import app

    app()
