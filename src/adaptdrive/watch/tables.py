"""Elements of the tables of the live view."""

from __future__ import annotations

import math

from rich.table import Table


def rows(*columns: str) -> Table:
    """A table without lines; `l` and `r` align its columns."""
    table = Table.grid(expand=True, padding=(0, 1))
    for column in columns:
        table.add_column(justify="right" if column == "r" else "left", no_wrap=True)
    return table


def number(value: float, digits: int) -> str:
    """A number with so many decimals."""
    return f"{value:.{digits}f}" if math.isfinite(value) else "–"


def figure(value: float) -> str:
    """A number with three digits."""
    return f"{value:#.3g}".rstrip(".") if math.isfinite(value) else "–"


def percent(share: float) -> str:
    """A deviation."""
    return f"{100.0 * share:+.1f}%" if math.isfinite(share) else ""


def overshoot(share: float | None) -> str:
    """An overshoot, which may not have been seen yet."""
    return "·" if share is None else f"{100.0 * share:.1f}%"
