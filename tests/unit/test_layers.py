"""Imports go downward only: no cycles, nobody imports the edges, third parties stay where they belong."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "ufirext"

# What talks to files, terminals and pictures. Nothing else may depend on it.
EDGES = {"__main__", "certify_cli", "cli", "demo", "distributed", "track"}
# What may be imported beyond NumPy and SciPy, and where (a package: in all its modules).
FOREIGN = {
    "_array_api": {"array_api_compat"},
    "control": {"control"},
    "programs": {"cvxpy"},
    "series": {"numba", "rich"},
}


def _name(path: Path) -> str:
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {_name(path): path for path in sorted(PACKAGE.rglob("*.py")) if _name(path)}
CORE = [name for name in MODULES if name.partition(".")[0] not in EDGES]


def _statements(tree: ast.AST) -> Iterator[ast.Import | ast.ImportFrom]:
    """Import statements, also those inside functions, without what only a type checker sees."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield node
        yield from _statements(node)


def _targets(name: str) -> Iterator[str]:
    """Full dotted names of what a module imports."""
    path = MODULES[name]
    here = ["ufirext", *name.split(".")]
    folder = here if path.stem == "__init__" else here[:-1]
    for node in _statements(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
            continue
        above = folder[: len(folder) - node.level + 1] if node.level else []
        yield from (".".join([*above, *filter(None, [node.module]), alias.name]) for alias in node.names)


def _own(name: str) -> set[str]:
    """Modules of this package that a module imports."""
    found = set()
    for target in _targets(name):
        head, _, rest = target.partition(".")
        if head == "ufirext":
            found.add(rest if rest in MODULES else rest.rpartition(".")[0])
    return found - {"", name}


def test_no_module_imports_itself_through_others():
    order = list(TopologicalSorter({name: _own(name) for name in MODULES}).static_order())
    assert order.index("errors") < order.index("model") < order.index("filters.ufir") < order.index("cli")


@pytest.mark.parametrize("name", CORE)
def test_the_core_imports_no_edge(name):
    assert not {other for other in _own(name) if other.partition(".")[0] in EDGES}


@pytest.mark.parametrize("name", CORE)
def test_the_core_needs_no_extra(name):
    foreign = {target.partition(".")[0] for target in _targets(name)} - sys.stdlib_module_names - {"ufirext"}
    assert foreign <= {"numpy", "scipy"} | FOREIGN.get(name.partition(".")[0], set())
