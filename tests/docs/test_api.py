"""Everything public is documented, typed and shown in use, and nothing private leaks.

Public is what `ufirext.__all__` and the `__all__` of the public subpackages name, and, of their classes, each
attribute without a leading underscore. That the examples run is tested beside this file.
"""

from __future__ import annotations

import ast
import builtins
import dataclasses
import importlib
import inspect
import re
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import pytest

import ufirext

ROOT = Path(__file__).parents[2]

# Public beside the names of the package itself: `ufirext.control.ufir` is not `ufirext.ufir`.
SUBPACKAGES = [name for name in ("control", "distributed") if (ROOT / "ufirext" / name).is_dir()]
NAMES = {f"ufirext.{name}": getattr(ufirext, name) for name in ufirext.__all__}
for _subpackage in SUBPACKAGES:
    _module = importlib.import_module(f"ufirext.{_subpackage}")
    NAMES |= {f"ufirext.{_subpackage}.{name}": getattr(_module, name) for name in _module.__all__}

FUNCTIONS = {name: value for name, value in NAMES.items() if inspect.isfunction(value)}
FAILURES = {
    name for name, value in NAMES.items() if inspect.isclass(value) and issubclass(value, BaseException)
}
CLASSES = {name: value for name, value in NAMES.items() if inspect.isclass(value) and name not in FAILURES}


def sections(value: Any) -> dict[str, str]:
    """The sections of a numpydoc docstring by their titles; what is above the first is "summary"."""
    parts = re.split(r"^(\w[\w ]*)\n-{3,}$", inspect.getdoc(value) or "", flags=re.MULTILINE)
    return {"summary": parts[0], **dict(zip(parts[1::2], parts[2::2], strict=True))}


def described(section: str) -> dict[str, str]:
    """Names in a section of parameters or attributes, and the type that is given for them."""
    heads = re.findall(r"^(\*{0,2}\w[\w*, \n]*?)(?: : (.*))?$", section, flags=re.MULTILINE)
    return {
        name.strip().lstrip("*"): kind for names, kind in heads for name in re.split(r",\s*", names) if name
    }


# Made by functions, so that their attributes are described and not their parameters.
RESULTS = {
    name
    for name, value in CLASSES.items()
    if "Attributes" in sections(value) and "Parameters" not in sections(value)
}


def parameters(value: Any) -> list[inspect.Parameter]:
    found = inspect.signature(value).parameters.values()
    return [p for p in found if p.name not in ("self", "cls") and not p.name.startswith("_")]


def own_members(owner: type) -> Iterator[tuple[str, Any]]:
    """Public methods and properties that the library defines, those of its base classes included."""
    for name in dir(owner):
        home = next(base for base in owner.__mro__ if name in base.__dict__)
        value = home.__dict__[name]
        if not name.startswith("_") and home.__module__.startswith("ufirext"):
            yield name, getattr(value, "__func__", value)


def function_of(member: Any) -> Any:
    """The function to ask for its annotations, None for what is not computed."""
    if isinstance(member, property):
        return member.fget
    if isinstance(member, cached_property):
        return member.func
    return member if inspect.isfunction(member) else None


@pytest.mark.parametrize("name", NAMES)
def test_a_public_name_says_what_it_is_and_shows_it_in_use(name):
    found = sections(NAMES[name])
    assert found["summary"].strip()
    assert ">>> " in found.get("Examples", ""), "no example that can be run"


@pytest.mark.parametrize("name", sorted({*FUNCTIONS, *CLASSES} - RESULTS))
def test_it_says_what_it_takes_and_what_can_go_wrong(name):
    found = sections(NAMES[name])
    taken = [] if inspect.isabstract(NAMES[name]) else parameters(NAMES[name])
    assert {p.name for p in taken} <= set(described(found.get("Parameters", "")))
    assert not taken or found.get("Raises", "").strip(), "nothing about errors"


@pytest.mark.parametrize("name", sorted(RESULTS))
def test_a_result_says_what_it_holds(name):
    value = CLASSES[name]
    fields = (
        [field.name for field in dataclasses.fields(value)]
        if dataclasses.is_dataclass(value)
        else list(getattr(value, "_fields", ()))
    )
    said = {key for base in value.__mro__[:-1] for key in described(sections(base).get("Attributes", ""))}
    assert {field for field in fields if not field.startswith("_")} <= said


@pytest.mark.parametrize("name", sorted({*FUNCTIONS, *CLASSES}))
def test_arrays_are_described_with_their_shapes(name):
    found = sections(NAMES[name])
    kinds = [
        (key, kind)
        for section in ("Parameters", "Returns", "Attributes")
        for key, kind in described(found.get(section, "")).items()
    ]
    arrays = [(key, kind) for key, kind in kinds if re.search("array_like|ndarray", kind)]
    assert [key for key, kind in arrays if "(" not in kind] == []


@pytest.mark.parametrize("name", CLASSES)
def test_every_member_is_documented(name):
    members = dict(own_members(CLASSES[name]))
    assert [
        key for key, member in members.items() if function_of(member) and not inspect.getdoc(member)
    ] == []


@pytest.mark.parametrize("name", sorted({*FUNCTIONS, *CLASSES}))
def test_everything_is_typed(name):
    value = NAMES[name]
    functions = {name: value} if inspect.isfunction(value) else dict(own_members(value))
    if inspect.isclass(value) and inspect.isfunction(value.__dict__.get("__init__")):
        functions["__init__"] = value.__init__
    for key, member in functions.items():
        if function := function_of(member):
            untyped = [p.name for p in parameters(function) if p.name not in function.__annotations__]
            assert (key, untyped) == (key, [])
            assert "return" in function.__annotations__, key


def test_nothing_private_leaks():
    for name, value in NAMES.items():
        assert not name.rpartition(".")[2].startswith("_")
        assert value.__module__.startswith("ufirext"), f"{name} belongs to {value.__module__}"
        assert value.__name__ == name.rpartition(".")[2]


def test_the_list_of_public_names_is_sorted_complete_and_shown_by_dir():
    assert list(ufirext.__all__) == sorted(set(ufirext.__all__))
    assert set(ufirext.__all__) <= set(dir(ufirext))
    assert set(ufirext.__all__) == set(ufirext._HOME)


def test_whoever_catches_an_error_of_the_library_can_name_it():
    """Every class that is raised is public, the interpreter's, or derived from a public one."""
    modules = {
        path: "ufirext." + ".".join(path.relative_to(ROOT / "ufirext").with_suffix("").parts)
        for path in (ROOT / "ufirext").rglob("*.py")
        if path.stem != "__init__"
    }
    public = tuple(NAMES[name] for name in FAILURES)
    for path, name in modules.items():
        module = importlib.import_module(name)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            call = node.exc if isinstance(node, ast.Raise) else None
            if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id[0].isupper():
                raised = getattr(module, call.func.id, None) or getattr(builtins, call.func.id)
                assert raised.__module__ == "builtins" or issubclass(raised, public), (name, raised)
