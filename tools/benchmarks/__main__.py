"""The long measurements, of which `make proof` runs all: one table, and a file.

`python -m tools.benchmarks --quick --only lateness` runs a part of them for a short time, with
`--minutes 10` it looks for rare late ticks for longer. `make bench` is `tools.benchmarks.paired`.
"""

from __future__ import annotations

import argparse
import importlib
import os
import platform
import signal
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory

from adaptdrive import build_name
from adaptdrive.app.process import NAMESPACE
from tools.benchmarks.rows import Extent, Row, table, write_json
from tools.builds.run import BUILDS, environments

PARTS = (
    *("lateness", "load", "daemons", "stop", "kills"),
    *("day", "stalled_disk", "page_storm", "topic_storm", "equality"),
)
RESULT = Path("build/measured.json")


def main() -> int:
    """Run them; 1 when a part could not be measured."""
    os.environ.setdefault(NAMESPACE, f"benchmarks-{os.getpid()}")  # other runs have a "motor" too
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that what was started is ended
    parser = argparse.ArgumentParser(prog="python -m tools.benchmarks")
    parser.add_argument("--quick", action="store_true", help="seconds instead of minutes")
    parser.add_argument("--shortest", action="store_true", help="only to see that it can be run")
    parser.add_argument("--only", choices=PARTS, action="append", help="a part; may be repeated")
    parser.add_argument(
        "--minutes", type=float, default=1.0, help="of ticks on the timer, for rare late ones"
    )
    parser.add_argument("--build", choices=BUILDS, help="instead of the one that is installed")
    parser.add_argument("--output", type=Path, default=RESULT)
    options = parser.parse_args()
    if options.build not in {None, build_name()}:
        return _again_with(options.build)
    rows: list[Row] = []
    missed: list[str] = []
    facts: dict[str, object] = {
        "time": datetime.now(UTC).isoformat(),
        "machine": platform.platform(),
        "python": platform.python_version(),
        "cpus": os.cpu_count(),
        "load_before": os.getloadavg()[0],
        "quick": options.quick,
        "build": build_name(),
    }
    extent = Extent(options.quick, options.minutes, options.shortest)
    began_s = time.monotonic()
    for name in options.only or PARTS:
        part = importlib.import_module(f"tools.benchmarks.{name}")
        try:
            found = list(part.rows(extent))
        except (OSError, RuntimeError, AssertionError) as problem:
            sys.stderr.write(f"{name}: not measured: {problem}\n")
            missed.append(name)
            continue
        rows += found
        facts["minutes"] = (time.monotonic() - began_s) / 60.0
        facts["load_after"] = os.getloadavg()[0]
        write_json(rows, facts, options.output)
    sys.stdout.write("\n".join(table(rows)) + "\n")
    sys.stdout.write(
        f"\n{os.cpu_count()} CPUs, load {facts['load_before']:.1f} before; "
        f"{sum(row.met is False for row in rows)} targets not met, {len(missed)} parts not measured"
        f"{''.join(f' {name}' for name in missed)}; {options.output}\n"
    )
    return int(bool(missed))


def _again_with(build: str) -> int:
    with TemporaryDirectory() as name:
        command = [sys.executable, "-m", "tools.benchmarks", *sys.argv[1:]]
        return subprocess.call(command, env=environments(Path(name))[build])


if __name__ == "__main__":
    raise SystemExit(main())
