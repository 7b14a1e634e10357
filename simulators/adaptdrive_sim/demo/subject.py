"""Contents of the live view, apart from the plot that all loads have."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from rich.table import Table

Figures = Callable[[], dict[str, Table]]
"""The tables below the plot, by title."""


@dataclass(frozen=True, slots=True)
class Subject:
    """A load as the live view presents it.

    Attributes:
        drive: Name of the drive.
        title: What the plot shows.
        figures: The tables below it.
        foot: Lines at the bottom of the screen.
    """

    drive: str
    title: str
    figures: Figures
    foot: tuple[str, ...]
