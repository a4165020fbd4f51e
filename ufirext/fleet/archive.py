"""The state of a fleet in an npz file, without loss; whatever is not such a file is refused."""

from __future__ import annotations

import os
import tempfile
import zipfile
import zlib
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .._array_api import Space
from ..errors import UfirextError
from ..model import Model
from .history import Slot

if TYPE_CHECKING:
    from .fleet import Fleet

FORMAT = "ufirext.Fleet"
VERSION = 1
# What the arrays of one track are called; all have one entry a slot.
TRACKS = ("active", "ready", "odd", "needs", "dropped")
RINGS = ("values", "late", "delays")
MATRICES = ("F", "H", "Q", "R", "B", "dt")


def save(fleet: Fleet, path: str | PathLike[str]) -> None:
    """Write beside the target first, so that a broken write leaves the older file."""
    engine, target = fleet._engine, Path(path)
    content: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "horizon": fleet.horizon,
        "missing": fleet.missing,
        "now": engine.now,
    }
    content |= {name: a for name in MATRICES if (a := getattr(fleet.model, name)) is not None}
    content |= {name: getattr(engine, name) for name in TRACKS}
    if engine.space is not None:
        host, history = engine.space.host, engine.history
        content["x"] = host(engine.estimates())
        content |= {n: host(a) for n in RINGS if (a := getattr(history, n)) is not None}
        for tick, slot in history.older.items():
            content |= {f"{n} {tick}": host(a) for n, a in zip(RINGS, slot, strict=True) if a is not None}
    handle, name = tempfile.mkstemp(dir=target.parent, prefix=target.name, suffix=".part")
    try:
        with os.fdopen(handle, "wb") as stream:
            np.savez(stream, **content)
        os.replace(name, target)
    except BaseException:
        os.unlink(name)
        raise


def load(cls: type[Fleet], path: str | PathLike[str], like: Any) -> Fleet:
    """The fleet of a file."""
    content = _content(path)
    if str(content.get("format")) != FORMAT:
        raise UfirextError(f"{path} must be a file written by Fleet.save, it is another npz file")
    if int(content["version"]) != VERSION:
        raise UfirextError(
            f"{path} must have format version {VERSION}, got {content['version']}: load it with the release "
            "that wrote it"
        )
    try:
        return _restored(cls, content, like)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise UfirextError(f"{path} must hold a whole fleet, it is damaged: {error}") from error


def _content(path: str | PathLike[str]) -> dict[str, np.ndarray[Any, Any]]:
    """All arrays of the file, every one read to its end, where its checksum is compared."""
    try:
        with zipfile.ZipFile(path) as archive:
            broken = archive.testzip()
        if broken is not None:
            raise zipfile.BadZipFile(f"checksum of {broken}")
        with np.load(path, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except (zipfile.BadZipFile, zlib.error, EOFError, ValueError, NotImplementedError, RuntimeError) as error:
        raise UfirextError(f"{path} must be a file written by Fleet.save, it is damaged: {error}") from error


def _restored(cls: type[Fleet], content: dict[str, Any], like: Any) -> Fleet:
    matrices = {name: content[name] for name in MATRICES if name in content}
    if "dt" in matrices:
        matrices["dt"] = float(matrices["dt"])
    tracks = len(content["active"])
    fleet = cls(Model(**matrices), int(content["horizon"]), tracks, missing=str(content["missing"]))
    engine = fleet._engine
    for name in TRACKS:
        own, array = getattr(engine, name), content[name]
        _expect(name, array, own.shape, own.dtype)
        setattr(engine, name, array)
    engine.now = int(content["now"])
    if "values" not in content:
        return fleet
    values, x = content["values"], content["x"]
    space = Space.of(values, "values")
    if like is not None:
        other = Space.of(like, "like")
        space = Space(other.xp, other.dtype_of(values.dtype), other.device)
    engine.begin(space)
    _expect("x", x, (tracks, engine.model.dim_x), values.dtype)
    engine.x = space.constant(x)
    history = engine.history
    history.values, history.late, history.delays = _rows(content, space, history.values.shape, values.dtype)
    for name in content:
        if name.startswith("values "):
            tick = name.removeprefix("values ")
            history.older[int(tick)] = Slot(
                *_rows(content, space, history.values.shape[1:], values.dtype, f" {tick}")
            )
    history.older = dict(sorted(history.older.items()))
    return fleet


def _rows(content: dict[str, Any], space: Space, shape: tuple[int, ...], dtype: Any, tick: str = "") -> Any:
    """values, late and delays of the ring or of a slot put aside, checked."""
    _expect("values" + tick, content["values" + tick], shape, dtype)
    if "late" + tick not in content:
        return space.constant(content["values" + tick]), None, None
    _expect("late" + tick, content["late" + tick], shape, dtype)
    _expect("delays" + tick, content["delays" + tick], (*shape[:-2], shape[-1]), np.dtype(np.int32))
    return (
        space.constant(content["values" + tick]),
        space.constant(content["late" + tick]),
        space.indices(content["delays" + tick]),
    )


def _expect(name: str, array: Any, shape: tuple[int, ...], dtype: Any) -> None:
    if array.shape != shape or array.dtype != dtype:
        raise ValueError(f"{name} has shape {array.shape} and dtype {array.dtype}")
