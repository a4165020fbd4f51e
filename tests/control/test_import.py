"""python-control is loaded by those who use it, and by nobody else."""

from __future__ import annotations

import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    ("statement", "loaded"),
    [
        ("from ufirext import UFIRFilter; UFIRFilter(2, 1, horizon=3)", False),
        ("from ufirext import DelayKalmanFilter, DelayHInfinityFilter, FMSFilterSmoother", False),
        ("import ufirext.control", True),
    ],
)
def test_who_loads_python_control(statement, loaded):
    script = f"{statement}\nimport sys; print('control' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == str(loaded)


def test_the_package_does_not_hide_python_control():
    import control

    import ufirext.control

    assert control.StateSpace is ufirext.control.FIREstimator.__mro__[1]
