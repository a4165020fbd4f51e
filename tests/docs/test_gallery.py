"""Scripts of the gallery: titled, ordered, and quoted truly by the pages. The build runs them all."""

from __future__ import annotations

import ast
import importlib.util
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTS = [path for path in sorted((ROOT / "examples").glob("*.py")) if path.stem != "sort_boxes"]
PAGE = (ROOT / "docs" / "horizon.md").read_text(encoding="utf-8")


def _module(path: Path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module  # where dataclasses look up their annotations
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def which_filter():
    return _module(ROOT / "examples" / "which_filter.py")


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_a_script_begins_with_a_title_and_a_word_on_what_it_shows(path):
    title, line, empty, text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))).split("\n", 3)
    assert set(line) == {"="}
    assert len(line) >= len(title)
    assert not empty
    assert text.strip()


def test_the_order_of_the_gallery_names_scripts_that_exist():
    order = _module(ROOT / "docs" / "_extensions" / "gallery_order.py")
    assert set(order.FIRST) <= {path.stem for path in SCRIPTS}


@pytest.mark.parametrize("name", ["as the model says", "late by 0 to 4 steps"])
def test_the_table_of_the_page_is_what_the_script_prints(which_filter, name):
    (scenario,) = [scenario for scenario in which_filter.SCENARIOS if scenario.name == name]
    printed = which_filter.markdown(which_filter.measured([scenario])).splitlines()
    heads, row = printed[0], next(line for line in PAGE.splitlines() if line.startswith(f"| {name} "))
    assert heads in PAGE.splitlines()
    # Sums in another order may change the last digit.
    numbers, ours = ([float(x) for x in re.findall(r"\d+\.\d\d", line)] for line in (row, printed[2]))
    assert numbers == pytest.approx(ours, abs=0.0101)


def test_every_scenario_of_the_script_is_on_the_page(which_filter):
    for scenario in which_filter.SCENARIOS:
        assert f"\n| {scenario.name} | " in PAGE
