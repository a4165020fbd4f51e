"""Which parts of a run are done, on disk: one line each, so that a kill costs the part in hand only."""

from __future__ import annotations

import json
import os
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO

from ..errors import UfirextError


class Journal:
    """The first line holds the terms of the run, every further one the number of a part."""

    def __init__(self, path: Path, terms: dict[str, Any]) -> None:
        self.path, self.terms = path, json.loads(json.dumps(terms))
        self._stream: TextIO | None = None

    def begin(self, fresh: bool) -> set[int]:
        """Parts that an earlier run finished; `fresh`: there is nothing to go on from.

        Raises
        ------
        UfirextError
            If that run had other terms.
        """
        if fresh or not self.path.exists():
            self.path.write_text(json.dumps(self.terms) + "\n", encoding="utf-8")
            return set()
        # A kill can tear the last line; what is not whole was not done.
        first, *rest = self.path.read_text(encoding="utf-8").split("\n")[:-1] or [""]
        try:
            earlier = json.loads(first)
        except json.JSONDecodeError:
            earlier = None
        if earlier is None:
            return self.begin(fresh=True)
        changed = [name for name, value in self.terms.items() if earlier.get(name) != value]
        if changed:
            raise UfirextError(
                f"{self.path} tells of a run with another {' and '.join(changed)} that was broken off: "
                "call with the same arguments to go on, or delete it to begin anew"
            )
        whole = "\n".join([first, *rest]) + "\n"
        self.path.write_text(whole, encoding="utf-8")
        return {int(line) for line in rest}

    def __enter__(self) -> Journal:
        self._stream = self.path.open("a", encoding="utf-8")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._stream is not None:
            self._stream.close()

    def note(self, number: int) -> None:
        """A part is done and on the disk."""
        if self._stream is None:
            raise RuntimeError("a journal is written inside its `with` block")
        self._stream.write(f"{number}\n")
        self._stream.flush()
        os.fsync(self._stream.fileno())

    def remove(self) -> None:
        """The run is over."""
        self.path.unlink()
