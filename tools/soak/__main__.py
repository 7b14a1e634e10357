"""Soak: `python -m tools.soak virtual [DAYS]` or `python -m tools.soak real [MINUTES]`.

Prints a report as Markdown; the status is 1 where something grows, is lost or does not replay.
"""

from __future__ import annotations

import argparse
import os
import sys
import tracemalloc

from adaptdrive.app.process import NAMESPACE
from tools.soak.real import soak as soak_real
from tools.soak.virtual import soak as soak_virtual


def main() -> int:
    """Run one of the forms."""
    parser = argparse.ArgumentParser(prog="python -m tools.soak")
    parser.add_argument("form", choices=("virtual", "real"))
    parser.add_argument("length", type=float, help="days of virtual, minutes of real time")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--at-most", type=float, default=1e6, help="minutes for virtual days")
    parser.add_argument("--trace", action="store_true", help="trace memory, at half the speed")
    options = parser.parse_args()
    if options.trace:
        tracemalloc.start()
    os.environ[NAMESPACE] = f"soak-{os.getpid()}"  # a daemon of another run is not this one
    if options.form == "real":
        lines, good = soak_real(options.length, options.seed)
    else:
        lines, good = soak_virtual(options.length, options.seed, options.at_most)
    sys.stdout.write("\n".join(lines) + "\n")
    return int(not good)


if __name__ == "__main__":
    raise SystemExit(main())
