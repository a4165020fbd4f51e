"""`import ufirext` is as light as NumPy, and its lazy names are real."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

import ufirext


def _modules_after(statement: str) -> set[str]:
    """Names in sys.modules after one statement in a fresh interpreter."""
    script = f"{statement}\nimport json, sys\nprint(json.dumps(sorted(sys.modules)))"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return set(json.loads(run.stdout))


def _third_party(modules: set[str]) -> set[str]:
    return {name.partition(".")[0] for name in modules} - sys.stdlib_module_names


def test_importing_ufirext_loads_numpy_and_no_other_third_party():
    added = _modules_after("import ufirext") - _modules_after("import numpy")
    assert _third_party(added) == {"ufirext"}


@pytest.mark.parametrize("heavy", ["scipy", "filterpy", "control", "cvxpy", "matplotlib", "pandas", "numba"])
def test_importing_ufirext_leaves_heavy_packages_alone(heavy):
    loaded = _modules_after("import ufirext")
    assert not {name for name in loaded if name.partition(".")[0] == heavy}


@pytest.mark.parametrize("name", ufirext.__all__)
def test_every_public_name_resolves_and_says_where_it_lives(name):
    value = getattr(ufirext, name)
    assert name in dir(ufirext)
    assert value.__module__.partition(".")[0] == "ufirext"


def test_an_unknown_name_is_an_attribute_error_that_names_it():
    with pytest.raises(AttributeError, match="no attribute 'KalmanFilterr'"):
        ufirext.KalmanFilterr  # noqa: B018


def test_a_star_import_brings_the_public_names_and_no_others():
    space: dict[str, object] = {}
    exec("from ufirext import *", space)
    assert set(space) - {"__builtins__"} == set(ufirext.__all__)
