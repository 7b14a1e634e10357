"""The verdict on each claim: a table on a terminal, plain lines in a pipe."""

from __future__ import annotations

import sys

from rich.console import Console
from rich.table import Table

from adaptdrive_sim.experiments.claims import ExperimentClaim

_VERDICTS = {True: "holds", False: "FAILS", None: "not judged"}
_STYLES = {True: "green", False: "bold red", None: "dim"}


def print_claims(title: str, claims: list[ExperimentClaim]) -> None:
    """Print the verdict on every claim."""
    if sys.stdout.isatty():
        Console().print(_table(title, claims))
        return
    lines = [
        f"{_VERDICTS[one.met]}: {one.claim}: {one.measured} (target: {one.target})"
        for one in claims
    ]
    sys.stdout.write("\n".join((title, *lines)) + "\n")


def _table(title: str, claims: list[ExperimentClaim]) -> Table:
    table = Table(title=title, title_justify="left", show_lines=True)
    for heading in ("claim", "measured", "target", "verdict"):
        table.add_column(heading)
    for one in claims:
        verdict = f"[{_STYLES[one.met]}]{_VERDICTS[one.met]}[/]"
        table.add_row(one.claim, one.measured, one.target, verdict)
    return table
