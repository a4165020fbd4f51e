"""The table that `make bench` wrote last, for the page on performance."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

NOTHING = "# Measured ratios\n\nNone are kept in this checkout; `make bench` measures and writes them.\n"


def copy(app: Sphinx) -> None:
    """Put the kept results, or the word that there are none, where the page includes them from."""
    kept = Path(app.srcdir).parent / "benchmarks" / "RESULTS.md"
    text = kept.read_text(encoding="utf-8") if kept.exists() else NOTHING
    page = Path(app.srcdir) / "generated" / "results.md"
    page.parent.mkdir(exist_ok=True)
    if not page.exists() or page.read_text(encoding="utf-8") != text:
        page.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, Any]:
    """Copy before anything is read."""
    app.connect("builder-inited", copy)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
