"""Every example that a reader can copy runs: README, pages under docs/, docstrings."""

from __future__ import annotations

import importlib
import os
import re
import shlex
import subprocess
import sys
from doctest import ELLIPSIS, NORMALIZE_WHITESPACE
from pathlib import Path

import pytest
from sybil import Example, Sybil
from sybil.document import PythonDocStringDocument
from sybil.parsers.myst import CodeBlockParser, DocTestDirectiveParser, PythonCodeBlockParser, SkipParser
from sybil.parsers.rest import DocTestParser

import ufirext

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("README.md"), *(ROOT / "docs").glob("*.md")])
MODULES = sorted((ROOT / "ufirext").rglob("*.py"))
FLAGS = ELLIPSIS | NORMALIZE_WHITESPACE

# Fences that show something without claiming that it runs.
SHOWN = {"console", "text", "csv"} | {
    f"{{{directive}}}" for directive in ("bibliography", "eval-rst", "include", "math", "raw", "toctree")
}
EXECUTED = {"python", "bash", "toml"}


def _run_commands(example: Example) -> None:
    """Run the `ufirext` lines of a shell block, the demo apart; installing is not for a test."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    for line in example.parsed.splitlines():
        if line.startswith(("ufirext track", "ufirext certify")):
            command = [sys.executable, "-c", "import ufirext.cli; ufirext.cli.main()", *shlex.split(line)[1:]]
            run = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
            assert run.returncode == 0, f"{line}\n{run.stderr}"


def _write_file(example: Example) -> None:
    """Write a TOML block to the file that its first line names: `# model.toml`."""
    Path(example.parsed.splitlines()[0].removeprefix("# ")).write_text(example.parsed, encoding="utf-8")


pages = Sybil(
    [
        PythonCodeBlockParser(doctest_optionflags=FLAGS),
        CodeBlockParser("bash", _run_commands),
        CodeBlockParser("toml", _write_file),
        DocTestDirectiveParser(FLAGS),
        SkipParser(),
    ]
)
modules = Sybil([DocTestParser(FLAGS)], document_types={".py": PythonDocStringDocument})


def _name(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("path", PAGES, ids=_name)
def test_the_code_of_a_page_runs_from_top_to_bottom(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for example in pages.parse(path).examples():
        example.evaluate()


@pytest.mark.parametrize("path", MODULES, ids=_name)
def test_the_examples_of_a_module_run(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for example in modules.parse(path).examples():
        example.evaluate()


@pytest.mark.parametrize("path", PAGES, ids=_name)
def test_no_code_of_a_page_escapes_execution(path):
    fences = re.findall(r"^ {0,3}```+ *(\S*)", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert set(fences[::2]) <= SHOWN | EXECUTED


def test_the_reference_lists_every_public_name():
    listed, module = [], "ufirext"
    for line in (ROOT / "docs" / "api.md").read_text(encoding="utf-8").splitlines():
        module = line.removeprefix(".. currentmodule:: ") if line.startswith(".. currentmodule") else module
        listed += [f"{module}.{name}" for name in re.findall(r"^   ([A-Za-z_]\w*)$", line)]
    public = [f"ufirext.{name}" for name in ufirext.__all__]
    for package in ("control", "distributed"):
        if (ROOT / "ufirext" / package).is_dir():
            names = importlib.import_module(f"ufirext.{package}").__all__
            public += [f"ufirext.{package}.{name}" for name in names]
    assert sorted(listed) == sorted(public)
