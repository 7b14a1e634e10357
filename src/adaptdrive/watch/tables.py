"""Elements of the tables of the live view."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from rich.box import ROUNDED
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

DIM = "bright_black"
"""Style of what is beside the point: frames, times, hints."""

STATE_STYLES = {"running": "bold green", "tripped": "bold white on red"}
_SEVERITY_STYLES = {"info": "", "warning": "yellow", "alarm": "bold red"}


def rows(*columns: str) -> Table:
    """Return a table without lines; `l` and `r` align its columns."""
    table = Table.grid(expand=True, padding=(0, 1))
    for column in columns:
        table.add_column(justify="right" if column == "r" else "left", no_wrap=True)
    return table


def number(value: float, digits: int) -> str:
    """Return a number with so many decimals."""
    return f"{value:.{digits}f}" if math.isfinite(value) else "–"


def figure(value: float) -> str:
    """Return a number with three digits."""
    return f"{value:#.3g}".rstrip(".") if math.isfinite(value) else "–"


def percent(share: float) -> str:
    """Return a deviation."""
    return f"{100.0 * share:+.1f}%" if math.isfinite(share) else ""


def overshoot(share: float | None) -> str:
    """Return an overshoot, which may not have been seen yet."""
    return "·" if share is None else f"{100.0 * share:.1f}%"


def cut(line: Text) -> Text:
    """Let a line end in an ellipsis where the terminal is too narrow for it."""
    line.no_wrap, line.overflow = True, "ellipsis"
    return line


def lines(texts: Iterable[Text]) -> Text:
    """Return texts below each other, each of which is cut where the terminal is too narrow."""
    return cut(Text("\n").join(texts))


def boxed(title: str | Text, content: Table | Text, rows: int | None = None, pad: int = 1) -> Panel:
    """Return a frame with a title, as high as its content or as so many rows."""
    return Panel(
        content,
        title=title,
        box=ROUNDED,
        border_style=DIM,
        title_align="left",
        height=rows,
        padding=(0, pad),
    )


def event_line(time: str, kind: str, detail: str, severity: str) -> Text:
    """Return an event in one line."""
    style = _SEVERITY_STYLES.get(severity, "")
    return Text.assemble((f" {time} ", DIM), (f"{kind:<11} ", "bold"), (detail, style))


def event_lines(events: Sequence[Text]) -> Text:
    """Return the lines of events, or that there were none."""
    return lines(events) if events else Text(" no events yet", DIM)
