"""`make bench`: what a daemon costs, as ratios with their spread; one table in five minutes.

`make bench PAGE=docs/proof/realtime.md` writes the table into the page too. A row that the machine
has disturbed says so by itself; `build/bench.json` has every alternation.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import platform
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory

from adaptdrive.app.process import NAMESPACE
from tools.benchmarks.paired.pairs import Effort, OutOfTimeError, Row, time_box
from tools.builds.run import COMPILED, PURE, environments
from tools.pages.marked import with_part

BOXES_S = {"shares": 70.0, "steps": 50.0, "answers": 95.0, "starts": 75.0}
"""Longest time of each part: together less than five minutes."""

MARKS = "<!-- bench: written by `make bench PAGE=…` -->\n", "<!-- end of bench -->\n"


def main() -> int:
    """Run all parts; 1 when one of them failed, 0 also where the machine was too busy."""
    os.environ.setdefault(NAMESPACE, f"benchmarks-{os.getpid()}")  # other runs have a "motor" too
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that what was started is ended
    parser = argparse.ArgumentParser(prog="make bench")
    parser.add_argument("--only", choices=BOXES_S, action="append", help="a part; may be repeated")
    parser.add_argument("--turns", type=int, default=7, help="alternations of each row")
    parser.add_argument("--turn-s", type=float, default=3.0, help="length of some of them")
    parser.add_argument("--output", type=Path, default=Path("build/bench.json"))
    parser.add_argument("--write-page", type=Path, help="page with the marks of the table")
    options = parser.parse_args()
    load, began_s = os.getloadavg()[0], time.monotonic()
    boxes_s = {part: BOXES_S[part] for part in options.only or BOXES_S}
    failures: list[str] = []
    rows = list(measured(boxes_s, Effort(options.turns, options.turn_s), failures))
    facts = f"{datetime.now(UTC):%Y-%m-%d}, load {load:.1f} before; {_machine()}"
    text = "\n".join((f"{facts}. {options.turns} alternations:", "", *table(rows), ""))
    minutes = (time.monotonic() - began_s) / 60.0
    sys.stdout.write(f"{text}\n{minutes:.1f} minutes; {options.output}\n")
    _keep(options.output, facts, rows)
    if options.write_page:
        page = options.write_page.read_text(encoding="utf-8")
        options.write_page.write_text(with_part(page, MARKS, text), encoding="utf-8")
    return int(bool(failures))


def measured(boxes_s: dict[str, float], effort: Effort, failures: list[str]) -> Iterator[Row]:
    """Measure parts, each within its time.

    Args:
        boxes_s: Longest time of each part.
        effort: How long to measure.
        failures: Takes the names of parts that failed.
    """
    with TemporaryDirectory() as name:
        builds = environments(Path(name))
        for part, longest_s in boxes_s.items():
            try:
                module = importlib.import_module(f"tools.benchmarks.paired.{part}")
                with time_box(longest_s):  # which may not end an import half-way
                    yield from module.rows(builds, effort)
            except OutOfTimeError as problem:
                yield from (Row(part, build, "", "", problem=str(problem)) for build in builds)
            except (OSError, RuntimeError, AssertionError, subprocess.SubprocessError) as problem:
                sys.stderr.write(f"{part}: not measured: {problem}\n")
                failures.append(part)


def _machine() -> str:
    kernel = platform.release().partition("-")[0]
    python = platform.python_version()
    return f"{os.cpu_count()} CPUs, {platform.machine()}, Linux {kernel}, Python {python}"


def table(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the rows in Markdown: both builds in one line."""
    yield f"| | over | {PURE} | {COMPILED} |"
    yield "|---|---|---|---|"
    cells = {(row.name, row.against, row.build): row.cell for row in rows}
    for name, against in dict.fromkeys((row.name, row.against) for row in rows):
        found = (cells.get((name, against, build), "") for build in (PURE, COMPILED))
        yield f"| {name} | {against} | {' | '.join(found)} |"


def _keep(path: Path, facts: str, rows: Sequence[Row]) -> None:
    """Write every alternation, with what is in doubt."""
    path.parent.mkdir(parents=True, exist_ok=True)
    content = {"facts": facts, "rows": [asdict(row) | {"doubt": row.doubt} for row in rows]}
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    raise SystemExit(main())
