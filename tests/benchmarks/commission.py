"""Commissioning of random loads: share of success, worst errors, largest movement.

nice .venv/bin/python -m tests.benchmarks.commission [motor|bath|battery] [number] [first seed]
"""

from __future__ import annotations

import statistics
import sys

from tests.commission.draws import KINDS
from tests.commission.trials import Trial, trial

FIRST_SEED = 1000


def main() -> None:
    kinds = [kind for kind in sys.argv[1:2] if kind in KINDS] or list(KINDS)
    number = int(sys.argv[2]) if len(sys.argv) > 2 else 200
    first = int(sys.argv[3]) if len(sys.argv) > 3 else FIRST_SEED
    for kind in kinds:
        trials = [trial(kind, first + seed) for seed in range(number)]
        sys.stdout.write(f"{kind}: {summary(trials)}\n")


def summary(trials: list[Trial]) -> str:
    """Return share of success, errors and movement."""
    complete = [one for one in trials if not one.refusal]
    right = sum(one.right for one in trials)
    rows = [f"{right} of {len(trials)} right, {len(trials) - len(complete)} refused"]
    for name in complete[0].errors:
        errors = sorted(100.0 * abs(one.errors[name]) for one in complete)
        rows.append(f"{name}: median {statistics.median(errors):.2g} %, worst {errors[-1]:.3g} %")
    falls, peaks = [one.fall for one in trials], [one.peak for one in trials]
    rows.append(f"true output from {min(falls):.2f} to {max(peaks):.2f} of the movement asked for")
    loops = [one.loop for one in trials if one.loop is not None]
    stable, close = sum(one.pole < 1.0 for one in loops), sum(one.error <= 0.1 for one in loops)
    worst = max(one.error for one in loops)
    rows.append(f"{stable} of {len(loops)} loops stable, {close} within 10 %, worst {worst:.2g}")
    rows.append(f"median time {statistics.median(one.duration_s for one in complete):.0f} s")
    rows += [f"refused: {one.refusal}" for one in trials if one.refusal]
    rows += [f"wrong: {one.errors} {one.sigmas}" for one in complete if not one.right]
    return "\n  ".join(rows)


if __name__ == "__main__":
    main()
