"""`python -m validation`."""

import os

# Small matrices gain nothing from threads, and the runs share the cores already; read when NumPy is loaded.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from validation.cli import main

if __name__ == "__main__":
    main()
