"""A campaign of motors, judged by what adaptive control must keep on seeds that nobody has used.

`python -m tests.benchmarks.rivals.wide --seed 45000001 --runs 2000 --output rows.json`. With
`--against FILE`, costs and total variation are compared with rows of the same seeds.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from adaptdrive.control.signals import Mode
from adaptdrive_sim.campaign.bench import Stand, draw
from adaptdrive_sim.campaign.judge import WORSE, judge
from adaptdrive_sim.campaign.settings import read_campaign
from adaptdrive_sim.compiled import bench

Row = dict[str, Any]

MUCH_WORSE = 1.5


def run_seed(name: str, seed: int) -> Row:
    """Run fixed and adaptive control, and judge them."""
    stand = Stand(draw(read_campaign(Path(name)), seed))
    fixed, adaptive = stand.run(Mode.FIXED), stand.run(Mode.ADAPTIVE)
    row = judge(stand, fixed, adaptive)
    for mode, outcome in (("fixed", fixed), ("adaptive", adaptive)):
        moves = np.abs(np.diff(outcome.trace[:, bench.REFERENCE_V]))
        row[f"variation_{mode}"] = float(np.nansum(moves))
    return {key: value for key, value in row.items() if isinstance(value, bool | int | float)}


def summary(rows: list[Row], before: dict[int, Row]) -> Iterator[str]:
    """Lines of the result."""
    judged = [row for row in rows if not row["interlock_fixed"] and not row["interlock_adaptive"]]
    ratios = np.array([row["ratio"] for row in judged])
    worse, much = np.count_nonzero(ratios > WORSE), np.count_nonzero(ratios > MUCH_WORSE)
    yield f"runs judged: {len(judged)} of {len(rows)}"
    yield f"over 5 % worse than fixed: {worse}, {100.0 * worse / len(judged):.2f} %"
    yield f"over 1.5 times: {much}; worst {ratios.max():.2f}"
    for cause in ("unstable", "interlock"):
        alone = [r["seed"] for r in rows if r[f"{cause}_adaptive"] and not r[f"{cause}_fixed"]]
        yield f"{cause} with adaptive control alone: {len(alone)} {alone}"
    sums = [sum(row[f"cost_{mode}"] for row in judged) for mode in ("adaptive", "fixed")]
    yield f"sum of the costs over that of fixed: {sums[0] / sums[1]:.3f}"
    worst = sorted(judged, key=lambda row: -float(row["ratio"]))[:10]
    yield "worst: " + ", ".join(f"{row['seed']} {row['ratio']:.2f}" for row in worst)
    pairs = [(row, before[row["seed"]]) for row in judged if row["seed"] in before]
    for name in ("cost_adaptive", "variation_adaptive"):
        changes = sorted(new[name] / old[name] for new, old in pairs if old[name] > 0.0)
        if changes:
            mean = math.exp(sum(map(math.log, changes)) / len(changes))
            most = changes[round(0.99 * (len(changes) - 1))]
            yield f"{name} over before: geometric mean {mean:.3f}, 99 % below {most:.2f}"


def main() -> None:
    """Run the campaign, keep its rows, and print the result."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.rivals.wide")
    parser.add_argument("--campaign", default="wide.toml")
    parser.add_argument("--seed", type=int, required=True, help="the first")
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--against", type=Path, help="rows of an earlier run")
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.runs)
    one = partial(run_seed, options.campaign)
    with multiprocessing.get_context("spawn").Pool(options.processes) as pool:
        rows = list(pool.imap(one, seeds, chunksize=10))
    options.output.write_text(json.dumps(rows), encoding="utf-8")
    before = json.loads(options.against.read_text("utf-8")) if options.against else []
    for text in summary(rows, {row["seed"]: row for row in before}):
        sys.stdout.write(f"{text}\n")


if __name__ == "__main__":
    main()
