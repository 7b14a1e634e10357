"""The table of faults: `python -m tools.proof.faults SEEDS [GROUP ...]`, PROCESSES at once.

Each row runs on each of its loads with so many seeds, from 100 on; the tests of CI use seeds below.
Lines come to stderr as they are found, the whole table to stdout. It ends with 1 where something
did not hold.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import statistics
import sys
from collections import Counter
from collections.abc import Iterable, Sequence

from tests.integration.faults.judge import Verdict, judge
from tests.integration.faults.rows import GROUPS, ROWS, Row

FIRST_SEED = 100
HEAD = (
    "| | fault | load and link | must | trips, of runs | reaction, median (worst) "
    "| highest output / limit | flaws |"
)
RULE = "|---|---|---|---|---|---|---|---|"


def promise(row: Row, name: str) -> str:
    """What must follow, in words."""
    bound_s = (row.bound_s or {}).get(name.partition(",")[0])
    if bound_s is not None:
        return f"trip in {bound_s:g} s"
    return "trip or hold" if row.causes else "hold"


def cell(row: Row, name: str, verdicts: Sequence[Verdict | None]) -> str:
    """One line of the table."""
    ran = [verdict for verdict in verdicts if verdict is not None]
    times = [one.reaction_s for one in ran if one.reaction_s < math.inf]
    flaws = Counter(flaw for one in ran for flaw in one.flaws)
    again = sum(one.enables > 1 for one in ran)
    findings = [f"{flaw} ({count})" for flaw, count in flaws.most_common()]
    findings += [f"second `enable` ({again})"] if again else []
    reaction = f"{statistics.median(times):.3g} s ({max(times):.3g})" if times else ""
    highest = max((one.excess for one in ran), default=math.nan)
    words = [row.group, row.fault, name, promise(row, name), f"{len(times)} of {len(ran)}"]
    return "| " + " | ".join([*words, reaction, f"{highest:.2f}", "; ".join(findings)]) + " |"


def lines(seeds: Iterable[int], groups: Sequence[str], processes: int) -> tuple[list[str], bool]:
    """All lines of the table, and whether all that must hold held."""
    span, found, held = list(seeds), [HEAD, RULE], True
    with multiprocessing.Pool(processes) as pool:
        for number, row in enumerate(ROWS):
            for name in row.loads if row.group in groups else ():
                verdicts = pool.map(_run, [(number, name, seed) for seed in span], 1)
                held &= not any(verdict and verdict.flaws for verdict in verdicts)
                found.append(cell(row, name, verdicts))
                sys.stderr.write(f"{found[-1]}\n")
    return found, held


def _run(job: tuple[int, str, int]) -> Verdict | None:
    number, name, seed = job
    return judge(ROWS[number], name, seed)


def main() -> int:
    """Run and print."""
    span = range(FIRST_SEED, FIRST_SEED + int(sys.argv[1]))
    groups = sys.argv[2:] or GROUPS
    table, held = lines(span, groups, int(os.environ.get("PROCESSES", "1")))
    sys.stdout.write("\n".join(table) + "\n")
    return 0 if held else 1


if __name__ == "__main__":
    raise SystemExit(main())
