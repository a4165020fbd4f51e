"""What `import ufirext` costs a program, in fresh interpreters."""

from __future__ import annotations

import subprocess
import sys
from functools import partial

from benchmarks.harness import EXCESS, Contest, Row, Run, wall_clock


def _fresh(statement: str, times: int) -> Run:
    def run() -> object:
        for _ in range(times):
            subprocess.run([sys.executable, "-c", statement], check=True)
        return 0.0

    return run


def _contest(statement: str, steps: int) -> Contest:
    times = max(1, steps // 4000)
    return Contest(lambda: _fresh(statement, times), lambda: _fresh("import numpy", times), times)


ROWS = [
    Row(
        f"imports/{name}",
        statement,
        "import numpy",
        20,
        partial(_contest, statement),
        metric=EXCESS,
        timer=wall_clock,
        stretch=stretch,
    )
    for name, statement, stretch in (
        ("ufirext", "import numpy, ufirext", False),
        ("first-filter", "import numpy; from ufirext import UFIRFilter", True),
    )
]
