"""Claims about what was simulated, and the verdicts on them."""

from __future__ import annotations

import sys
from dataclasses import dataclass

from rich.console import Console
from rich.table import Table

_VERDICTS = {True: "holds", False: "FAILS", None: "not judged"}
_STYLES = {True: "green", False: "bold red", None: "dim"}


@dataclass(frozen=True, slots=True)
class Claim:
    """One claim.

    Attributes:
        claim: What is claimed.
        measured: What was measured.
        target: What is expected.
        met: Whether it holds; None where this run's noise is not the one to judge it by.
    """

    claim: str
    measured: str
    target: str
    met: bool | None


def print_claims(title: str, claims: list[Claim]) -> None:
    """Print the verdict on every claim."""
    if sys.stdout.isatty():
        Console().print(_table(title, claims))
        return
    lines = [
        f"{_VERDICTS[one.met]}: {one.claim}: {one.measured} (target: {one.target})"
        for one in claims
    ]
    sys.stdout.write("\n".join((title, *lines)) + "\n")


def _table(title: str, claims: list[Claim]) -> Table:
    table = Table(title=title, title_justify="left", show_lines=True)
    for heading in ("claim", "measured", "target", "verdict"):
        table.add_column(heading)
    for one in claims:
        verdict = f"[{_STYLES[one.met]}]{_VERDICTS[one.met]}[/]"
        table.add_row(one.claim, one.measured, one.target, verdict)
    return table
