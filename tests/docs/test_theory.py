"""The page of theory and the docstrings speak of the same equations; the pages lead where they say."""

from __future__ import annotations

import ast
import builtins
import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("*.md"))
PAPERS = set(
    re.findall(r"^@\w+\{(\w+),$", (DOCS / "references.bib").read_text(encoding="utf-8"), re.MULTILINE)
)


def _docstrings() -> dict[str, str]:
    """Docstrings of all modules, classes and functions of the library, by module and line."""
    found = {}
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    for path in sorted((ROOT / "ufirext").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, kinds) and (text := ast.get_docstring(node)):
                found[f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 1)}"] = text
    return found


def test_every_equation_that_a_docstring_cites_is_on_the_page_and_every_one_there_is_cited():
    theory = (DOCS / "theory.md").read_text(encoding="utf-8")
    labels = re.findall(r"^\$\$ \(([\w-]+)\)$", theory, flags=re.MULTILINE)
    cited = {
        label: place for place, text in _docstrings().items() for label in re.findall(r":eq:`([^`]+)`", text)
    }
    assert len(labels) == len(set(labels))
    assert {label: place for label, place in cited.items() if label not in labels} == {}
    assert set(labels) - set(cited) == set()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_equations_and_papers_that_a_page_cites_exist(page):
    text = page.read_text(encoding="utf-8")
    theory = (DOCS / "theory.md").read_text(encoding="utf-8")
    labels = set(re.findall(r"^\$\$ \(([\w-]+)\)$", theory, flags=re.MULTILINE))
    assert set(re.findall(r"\{eq\}`([^`]+)`", text)) <= labels
    for keys in re.findall(r"\{cite:\w+\}`([^`]+)`", text):
        assert set(keys.split(",")) <= PAPERS


def test_every_paper_of_the_bibliography_is_cited():
    sources = [*PAGES, *(ROOT / "examples").glob("*.py")]
    text = "".join(source.read_text(encoding="utf-8") for source in sources)
    cited = {key for keys in re.findall(r"[{:]cite:\w+[}:]`([^`]+)`", text) for key in keys.split(",")}
    assert cited == PAPERS


def test_the_page_on_architecture_names_every_module():
    page = (DOCS / "architecture.md").read_text(encoding="utf-8")
    table = page[page.index("| modules | concern |") : page.index("## What checks what")]
    named = set(re.findall(r"`(\w+)`", table))
    modules = {path.stem for path in (ROOT / "ufirext").iterdir() if path.suffix == ".py" or path.is_dir()}
    assert {name for name in modules if not name.startswith("_")} - named == set()


@pytest.mark.parametrize(
    "inventory", sorted((DOCS / "inventories").glob("*.txt")), ids=lambda path: path.stem
)
def test_names_of_other_libraries_that_pages_may_link_to_exist(inventory):
    head, *lines = inventory.read_text(encoding="utf-8").splitlines()
    assert head == "# Sphinx inventory version 1"
    for name, _kind, page in (line.split() for line in lines if not line.startswith("#")):
        assert page.endswith(".html")
        module, _, attribute = name.rpartition(".")
        if inventory.stem == "python" and not module:
            assert hasattr(builtins, name) or importlib.import_module(name)
        else:
            assert hasattr(importlib.import_module(module), attribute), name
