"""One HTML file that needs no other: the pictures, light and dark, and the table."""

from __future__ import annotations

import base64
from html import escape
from pathlib import Path

__all__ = ["write_page"]

_STYLE = """
:root { color-scheme: light dark; --ground: #ffffff; --ink: #1a1a1a; --soft: #5c5c5c; --line: #d8d8d8; }
@media (prefers-color-scheme: dark) {
  :root { --ground: #15181c; --ink: #e6e6e6; --soft: #a8a8a8; --line: #3a3f45; }
}
body { margin: 2rem auto; max-width: 72rem; padding: 0 1rem; background: var(--ground); color: var(--ink);
  font: 16px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.4rem; overflow-wrap: anywhere; }
img { display: block; width: 100%; height: auto; }
table { border-collapse: collapse; margin-top: 1.5rem; }
th, td { padding: .3rem .8rem .3rem 0; border-top: 1px solid var(--line);
  text-align: left; vertical-align: top; }
th { white-space: nowrap; font-weight: 600; }
td { overflow-wrap: anywhere; }
footer { margin-top: 1.5rem; color: var(--soft); font-size: .85rem; }
"""


def write_page(path: Path, title: str, light: bytes, dark: bytes, lines: list[tuple[str, str]]) -> None:
    """Write the page: `light` and `dark` are one picture as SVG, `lines` the rows of the table."""
    rows = "\n".join(f"<tr><th>{escape(heading)}</th><td>{escape(text)}</td></tr>" for heading, text in lines)
    path.write_text(
        f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}</title>
<style>{_STYLE}</style>
</head>
<body>
<h1>{escape(title)}</h1>
<picture>
<source media="(prefers-color-scheme: dark)" srcset="{_embedded(dark)}">
<img src="{_embedded(light)}" alt="The track, a closer look at it, and its residuals over time">
</picture>
<table>
{rows}
</table>
<footer>Drawn by ufirext.</footer>
</body>
</html>
""",
        encoding="utf-8",
    )


def _embedded(svg: bytes) -> str:
    return "data:image/svg+xml;base64," + base64.b64encode(svg).decode("ascii")
