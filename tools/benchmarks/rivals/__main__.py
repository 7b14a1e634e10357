"""Compare controllers: `python -m tools.benchmarks.rivals --cases A,B --seeds 20`.

Each figure is the median of the seeds, with the worst in brackets.
"""

from __future__ import annotations

import argparse
import sys
from statistics import median

from tools.benchmarks.rivals.cases import CASES
from tools.benchmarks.rivals.runs import CONTROLLERS, Figures, figures, takes_part

FIRST_SEED = 44_000_000
COLUMNS = {
    "rms %": "rms",
    "peak %": "peak",
    "overshoot %": "overshoot",
    "IAE s": "iae_s",
    "TV V": "variation",
    "in force": "in_force",
    "wrong": "wrong",
}


def line(name: str, found: list[Figures]) -> str:
    """Return the figures of one controller."""
    cells = []
    for field in COLUMNS.values():
        values = [float(getattr(one, field)) for one in found]
        worst = min(values) if field == "in_force" else max(values)
        cells.append(f"{median(values):.2f} ({worst:.2f})")
    return f"  {name:30}" + "".join(f"{cell:>18}" for cell in cells)


def main() -> None:
    """Run the cases and print their figures."""
    parser = argparse.ArgumentParser(prog="python -m tools.benchmarks.rivals", description=__doc__)
    parser.add_argument("--cases", default=",".join(CASES), help="names, with commas between them")
    parser.add_argument("--only", default=";".join(CONTROLLERS), help="with ; between them")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=FIRST_SEED, help="the first of the seeds")
    parser.add_argument("--quick", action="store_true", help="fixed and adaptive with two seeds")
    options = parser.parse_args()
    names = ["fixed", "adaptive"] if options.quick else options.only.split(";")
    seeds = range(options.first, options.first + (2 if options.quick else options.seeds))
    for case in (CASES[name] for name in options.cases.split(",")):
        heads = "".join(f"{head:>18}" for head in COLUMNS)
        sys.stdout.write(f"{case.name}: {case.title}\n  {'':30}{heads}\n")
        for name in (name for name in names if takes_part(name, case.name)):
            sys.stdout.write(line(name, [figures(case, seed, name) for seed in seeds]) + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
