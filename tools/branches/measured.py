"""Lines and branches of a module, as coverage.py counts them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True, slots=True)
class Measured:
    """What the tests of a module run of it.

    Attributes:
        module: Its name.
        lines: Statements.
        missed_lines: Numbers of the lines that no test runs.
        branches: Ways out of the lines that decide.
        missed_branches: Line that decides and line it never led to, negative for the end of the
            function.
    """

    module: str
    lines: int
    missed_lines: tuple[int, ...]
    branches: int
    missed_branches: tuple[tuple[int, int], ...]

    @property
    def name(self) -> str:
        """Its name in tables."""
        return self.module.removeprefix("adaptdrive.")

    @property
    def line(self) -> str:
        """A line of the table."""
        return (
            f"| `{self.name}` | {self.lines} | {len(self.missed_lines)} | {self.branches} "
            f"| {len(self.missed_branches)} |"
        )

    @property
    def left(self) -> list[str]:
        """What is left out, in words."""
        lines = [f"`{self.name}`: line {number} is not run" for number in self.missed_lines]
        branches = [
            f"`{self.name}`: line {one} never leads to {f'line {to}' if to > 0 else 'the end'}"
            for one, to in self.missed_branches
        ]
        return lines + branches


def read(report: Path, files: Mapping[str, str]) -> list[Measured]:
    """Return what a report of `coverage json` says of some modules.

    Args:
        report: The report.
        files: File of each module.
    """
    found = json.loads(report.read_text(encoding="utf-8"))["files"]
    by_file = {str(Path(name).resolve()): one for name, one in found.items()}
    return [_measured(module, by_file[str(Path(file).resolve())]) for module, file in files.items()]


def _measured(module: str, found: Mapping[str, Any]) -> Measured:
    return Measured(
        module=module,
        lines=found["summary"]["num_statements"],
        missed_lines=tuple(found["missing_lines"]),
        branches=found["summary"]["num_branches"],
        missed_branches=tuple((one, to) for one, to in found["missing_branches"]),
    )
