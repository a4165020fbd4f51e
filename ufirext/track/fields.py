"""Delimited text as fields: encoding, delimiter, quotes, comments. What the fields mean is for others."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import numpy as np

from .series import UnusableTrack
from .stamps import numbers

__all__ = ["encoding_of", "header_of", "place_in", "rows_of"]


def encoding_of(path: Path) -> str:
    """UTF-8 or UTF-16; an empty or a binary file is refused."""
    with path.open("rb") as file:
        head = file.read(8192)
    if not head.strip():
        raise UnusableTrack(f"{path}: the file is empty")
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    if sum(byte < 9 or 13 < byte < 32 for byte in head) > len(head) // 20:  # a logger may die amid zeros
        raise UnusableTrack(f"{path}: a binary file, not a table of text or GPX")
    return "utf-8-sig"


def header_of(file: TextIO, path: Path) -> tuple[list[str], str, int]:
    """Names of the columns, the delimiter, and the number of the header's line."""
    for number, line in enumerate(iter(file.readline, ""), start=1):
        if line.strip() and not line.startswith("#"):
            break
        if number > 1000:
            raise UnusableTrack(f"{path}: no header in the first 1000 lines")
    else:
        raise UnusableTrack(f"{path}: no header, only empty lines and comments")
    if line.lstrip().startswith("<"):
        raise UnusableTrack(f"{path}: XML, but not GPX")
    delimiter = max(",;\t|", key=line.count)
    try:
        header = next(csv.reader([line], delimiter=delimiter))
    except (csv.Error, StopIteration) as error:
        raise UnusableTrack(f"{path}: line {number} is no header: {error}") from error
    if np.isfinite(numbers(header, decimal_comma=delimiter != ",")).any():
        raise UnusableTrack(f"{path}: line {number} must name the columns, got {line.strip()[:60]!r}")
    return header, delimiter, number


def rows_of(file: TextIO, delimiter: str, before: int) -> Iterator[tuple[int, list[str]]]:
    """Line number and fields of every line that is neither empty nor a comment.

    Line by line, so that a stray quote spoils its own line and not the rest of the file.
    """
    for number, line in enumerate(file, start=before + 1):
        if line.isspace() or line.startswith("#"):
            continue
        if '"' not in line:
            yield number, line.rstrip("\n").split(delimiter)
            continue
        try:
            yield number, next(csv.reader([line.rstrip("\n")], delimiter=delimiter))
        except csv.Error:  # a field longer than the module allows
            yield number, []


def place_in(file: TextIO) -> int:
    """Bytes read so far: of the file below the text, which itself cannot tell while it is iterated."""
    buffer = file.buffer
    return buffer.tell() if isinstance(buffer, io.BufferedReader) else 0
