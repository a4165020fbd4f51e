"""After the build: links between pages lead somewhere, and reading them fetches nothing from elsewhere."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from sphinx.application import Sphinx
from sphinx.errors import SphinxError


class _Page(HTMLParser):
    """Anchors, links and what the browser loads by itself."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = {"", "top"}
        self.links: set[str] = set()
        self.loaded: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        of = dict(attrs)
        self.anchors |= {value for key in ("id", "name") if (value := of.get(key))}
        if tag == "a" and (href := of.get("href")):
            self.links.add(href)
        elif tag == "link" and of.get("rel") == "stylesheet":
            self.loaded.add(of.get("href") or "")
        elif tag in ("img", "script", "iframe") and (source := of.get("src")):
            self.loaded.add(source)


def check(app: Sphinx, exception: Exception | None) -> None:
    """Raise with all dead links and all foreign resources."""
    if exception is not None or app.builder.name != "html":
        return
    root = Path(app.outdir)
    pages = {path: _Page(path.read_text(encoding="utf-8")) for path in root.rglob("*.html")}
    wrong = []
    for path, page in pages.items():
        for link in page.links | page.loaded:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                if link in page.loaded and parts.scheme != "data":
                    wrong.append(f"{path.relative_to(root)} loads {link}")
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            target = target / "index.html" if target.is_dir() else target
            anchors = pages[target].anchors if target in pages else {unquote(parts.fragment)}
            if not target.exists() or unquote(parts.fragment) not in anchors:
                wrong.append(f"{path.relative_to(root)} links to {link}")
    if wrong:
        raise SphinxError("dead or foreign links:\n" + "\n".join(sorted(wrong)))


def setup(app: Sphinx) -> dict[str, Any]:
    """Check when everything is written."""
    app.connect("build-finished", check, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
