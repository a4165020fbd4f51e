"""The table on the terminal (by rich)."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table
from rich.text import Text

__all__ = ["show"]


def show(console: Console, title: str, lines: list[tuple[str, str]]) -> None:
    """Print headings and what there is to say; a heading that repeats is printed once."""
    table = Table(title=Text(title), title_justify="left", show_header=False, box=None, pad_edge=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    before = ""
    for heading, text in lines:
        table.add_row(Text("" if heading == before else heading), Text(text))
        before = heading
    console.print(table)
