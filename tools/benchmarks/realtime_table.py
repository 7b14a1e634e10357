"""The table of docs/proof/realtime.md, in Markdown: with both builds where they differ.

`python -m tools.benchmarks.realtime_table` takes twenty minutes and an idle machine; it needs the
wheel of `make compiled`. `--quick` takes seven, and `--build compiled` leaves the pure build out.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tools.benchmarks.builds import measured, unpacked
from tools.builds.run import BUILDS, COMPILED, PURE

PARTS = ("compute", "turnaround", "daemon", "daemons", "load")
COMPILED_ONLY = {"daemons", "load"}
SHOWN = (
    *("controller alone", "whole tick", "tick with decode", "the same with cold", "slow step"),
    *("turn-around p50", "CPU share", "resident memory", "start of", "daemons at"),
    "turn-around p99.9 under load",
)
"""Beginnings of the names of the rows of the table."""

Found = dict[str, dict[str, Any]]
"""Rows by build."""


def main() -> int:
    """Measure, and print the table as it grows."""
    parser = argparse.ArgumentParser(prog="realtime_table")
    parser.add_argument("--quick", action="store_true", help="seven minutes instead of twenty")
    parser.add_argument("--only", choices=PARTS, action="append", help="a part; may be repeated")
    parser.add_argument("--build", choices=BUILDS, action="append", help="a build; may be repeated")
    options = parser.parse_args()
    builds, load, began_s = options.build or [PURE, COMPILED], os.getloadavg()[0], time.monotonic()
    _write("| | pure Python | compiled | target |", "|---|---|---|---|")
    with TemporaryDirectory() as name:
        path = unpacked(Path(name))
        for part in options.only or PARTS:
            one = {COMPILED} if part in COMPILED_ONLY else {PURE, COMPILED}
            chosen = [build for build in builds if build in one]
            _write(*_lines(_runs(part, chosen, path, Path(name) / "rows.json", options.quick)))
    minutes = (time.monotonic() - began_s) / 60.0
    _write("", f"{os.cpu_count()} CPUs, load {load:.1f} before, {minutes:.0f} minutes")
    return 0


def _write(*lines: str) -> None:
    sys.stdout.write("".join(f"{line}\n" for line in lines))
    sys.stdout.flush()


def _runs(part: str, builds: list[str], path: Path, output: Path, quick: bool) -> list[Found]:
    """Run a part with each build; return its rows, in their order."""
    rows: dict[str, Found] = {}
    for build in builds:
        try:
            found = measured(part, build, path, output, quick=quick)
        except RuntimeError as problem:
            _write(f"| {part}, {build}: not measured | | | |")
            sys.stderr.write(f"{problem}\n")
            continue
        for row in found:
            if row["name"].startswith(SHOWN) and row["against"] != "bare-socket echo in C":
                rows.setdefault(row["name"], {})[build] = row
    return list(rows.values())


def _lines(rows: list[Found]) -> Iterator[str]:
    """Yield a line for each row; the target is judged with the compiled build."""
    for found in rows:
        last = found.get(COMPILED) or found[PURE]
        verdict = {None: "", True: ": met", False: ": not met"}[last["met"]]
        cells = [_cell(found.get(build)) for build in (PURE, COMPILED)]
        yield f"| {last['name']} | {' | '.join(cells)} | {last['target']}{verdict} |"


def _cell(row: dict[str, Any] | None) -> str:
    if row is None:
        return ""
    figure = f"{row['ours']:.3g} {row['unit']}".rstrip()
    ratio = "" if row["ratio"] is None else f", {row['ratio']:.2f} x {row['against']}"
    note = f" ({row['note']})" if row["name"].startswith(("turn-around p99", "daemons")) else ""
    return f"{figure}{ratio}{note}"


if __name__ == "__main__":
    raise SystemExit(main())
