"""Elements of the tables of the live view."""

from __future__ import annotations

import math
from collections.abc import Iterable
from textwrap import wrap

from rich.table import Table
from rich.text import Text

DIM = "bright_black"
"""Style of what is less important: frames, times, hints."""

_LONGEST = 1e6
"""Least number that is written with a power of ten."""

STATE_STYLES = {"running": "bold green", "tripped": "bold white on red"}


def rows(*columns: str) -> Table:
    """Return a table without lines; `l` and `r` align its columns."""
    table = Table.grid(expand=True, padding=(0, 1))
    for column in columns:
        table.add_column(justify="right" if column == "r" else "left", no_wrap=True)
    return table


def figure(value: float, digits: int = 3) -> str:
    """Return a number with so many digits, or with all that it has before the point."""
    if not math.isfinite(value):
        return "–"
    if 10.0**digits <= abs(value) < _LONGEST:
        return f"{value:.0f}"
    return f"{value:#.{digits}g}".rstrip(".")


def cut(line: Text) -> Text:
    """Let a line end in an ellipsis where the terminal is too narrow for it."""
    line.no_wrap, line.overflow = True, "ellipsis"
    return line


def lines(texts: Iterable[Text]) -> Text:
    """Return texts below each other, each of which is cut where the terminal is too narrow."""
    return cut(Text("\n").join(texts))


def flow(items: Iterable[str], width: int) -> list[str]:
    """Return lines of items, each of which begins a new line where it does not fit."""
    found: list[str] = []
    for item in items:
        if found and len(found[-1]) + len(item) + 2 <= width:
            found[-1] += f"  {item}"
        else:
            found += wrap(item, width, initial_indent=" ", subsequent_indent=" ")
    return found


def titled(title: str | Text, content: Table | Text) -> Table:
    """Return content below its title and a line."""
    grid = Table.grid(expand=True)
    head = Text.assemble(("─ ", DIM), title, (" " + "─" * 200, DIM))
    head.no_wrap, head.overflow = True, "crop"
    grid.add_row(head)
    grid.add_row(content)
    return grid
