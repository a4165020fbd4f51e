"""Arrays in files, read and written in parts: npy by memory map, zarr by its chunks."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from .._arrays import Array
from ..errors import UfirextError


class Storage(Protocol):
    """A file that holds an array (T, ..) or (S, T, ..). Picklable: a place, no data."""

    @property
    def path(self) -> Path:
        """Where it is."""

    @property
    def shape(self) -> tuple[int, ...]:
        """As in the file."""

    @property
    def dtype(self) -> Any:
        """As in the file."""

    def exists(self) -> bool:
        """Whether there is such a file."""

    def modified(self) -> int:
        """When it was written last, ns."""

    def create(self, shape: tuple[int, ...], length: int) -> None:
        """A new file of float64, in place of any older one."""

    def read(self, first: int, last: int, start: int, stop: int) -> Array:
        """Rows of some series, (series, rows, ..), in memory."""

    def write(self, first: int, last: int, start: int, stop: int, rows: Array) -> None:
        """Rows of some series, to the disk."""


def storage_of(path: str | PathLike[str], suffix: str = "") -> Storage:
    """The storage that a name's ending asks for."""
    place = Path(path)
    named = place.with_name(place.name + suffix)
    if place.suffix == ".npy":
        return Npy(named)
    if place.suffix == ".zarr":
        return Zarr(named)
    raise UfirextError(f"the name of a file must end in .npy or .zarr, got {place.name!r}")


@dataclass(frozen=True)
class Npy:
    """NumPy's own file. It is mapped anew for each part, so that only parts occupy memory."""

    path: Path

    def _map(self, mode: Any) -> Any:
        return np.load(self.path, mmap_mode=mode, allow_pickle=False)

    @property
    def shape(self) -> tuple[int, ...]:
        """As in the file."""
        return tuple(self._map("r").shape)

    @property
    def dtype(self) -> Any:
        """As in the file."""
        return self._map("r").dtype

    def exists(self) -> bool:
        """Whether there is such a file."""
        return self.path.exists()

    def modified(self) -> int:
        """When it was written last, ns."""
        return self.path.stat().st_mtime_ns

    def create(self, shape: tuple[int, ...], length: int) -> None:
        """A new file of float64, in place of any older one."""
        np.lib.format.open_memmap(self.path, mode="w+", dtype=np.float64, shape=shape)

    def read(self, first: int, last: int, start: int, stop: int) -> Array:
        """Rows of some series, (series, rows, ..), in memory."""
        return np.array(_as_series(self._map("r"))[first:last, start:stop])

    def write(self, first: int, last: int, start: int, stop: int, rows: Array) -> None:
        """Rows of some series, to the disk."""
        mapped = self._map("r+")
        _as_series(mapped)[first:last, start:stop] = rows
        mapped.flush()


@dataclass(frozen=True)
class Zarr:
    """A zarr array; its chunks are the parts, so that no two writers meet in one."""

    path: Path

    def _open(self, mode: Any) -> Any:
        return _zarr().open_array(self.path, mode=mode)

    @property
    def shape(self) -> tuple[int, ...]:
        """As in the file."""
        return tuple(self._open("r").shape)

    @property
    def dtype(self) -> Any:
        """As in the file."""
        return self._open("r").dtype

    def exists(self) -> bool:
        """Whether there is such a file."""
        return self.path.exists()

    def modified(self) -> int:
        """When it was written last, ns."""
        return max(entry.stat().st_mtime_ns for entry in self.path.rglob("*"))

    def create(self, shape: tuple[int, ...], length: int) -> None:
        """A new file of float64, in place of any older one."""
        if self.path.exists():
            shutil.rmtree(self.path)
        together = [length // max(shape[-2], 1)] if len(shape) == 3 else []
        wanted = (*together, length, shape[-1])
        chunks = tuple(max(1, min(w, s)) for w, s in zip(wanted, shape, strict=True))
        _zarr().create_array(self.path, shape=shape, chunks=chunks, dtype="float64", fill_value=np.nan)

    def read(self, first: int, last: int, start: int, stop: int) -> Array:
        """Rows of some series, (series, rows, ..), in memory."""
        stored = self._open("r")
        if len(stored.shape) < 3:
            return np.asarray(stored[start:stop])[None]
        return np.asarray(stored[first:last, start:stop])

    def write(self, first: int, last: int, start: int, stop: int, rows: Array) -> None:
        """Rows of some series, to the disk."""
        stored = self._open("r+")
        if len(stored.shape) < 3:
            stored[start:stop] = rows[0]
        else:
            stored[first:last, start:stop] = rows


def _zarr() -> Any:
    try:
        import zarr
    except ImportError as error:
        raise ImportError(f"zarr files need {error.name}: pip install 'ufirext[distributed]'") from error
    return zarr


def _as_series(array: Any) -> Any:
    return array if array.ndim == 3 else array[None]
