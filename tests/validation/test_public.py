"""The suite is a user: it has the public names only."""

from __future__ import annotations

import ast
import importlib
from collections.abc import Iterator
from pathlib import Path

import validation

FOLDER = Path(validation.__file__).parent
MODULES = sorted(FOLDER.rglob("*.py"))


def taken(path: Path) -> Iterator[tuple[str, str]]:
    """(module of ufirext, name) of what a file imports from there, also inside functions."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "ufirext":
            yield from ((node.module, alias.name) for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from ((a.name, "") for a in node.names if a.name.split(".")[0] == "ufirext")


def test_only_public_names_are_imported() -> None:
    private = [
        f"{path.relative_to(FOLDER)}: {module}.{name}"
        for path in MODULES
        for module, name in taken(path)
        if any(part.startswith("_") for part in module.split("."))
        or (name and name not in importlib.import_module(module).__all__)
    ]
    assert private == []


def test_no_private_attribute_of_anything_but_self_is_read() -> None:
    private = [
        f"{path.relative_to(FOLDER)}:{node.lineno}: .{node.attr}"
        for path in MODULES
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute)
        and node.attr.startswith("_")
        and not node.attr.startswith("__")
        and not (isinstance(node.value, ast.Name) and node.value.id in ("self", "cls"))
    ]
    # NamedTuple's own method has an underscore and is public all the same.
    assert [line for line in private if not line.endswith("._replace")] == []
