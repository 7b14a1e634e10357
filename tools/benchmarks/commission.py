"""Commissioning of random loads: share of success, worst errors, largest movement.

    nice .venv/bin/python -m tools.benchmarks.commission KIND NUMBER FIRST_SEED [FILE]

KIND is motor, bath or battery. Each draw becomes a line of FILE, if one is given; a draw that is
there already is not repeated, so that the same command goes on where it was ended.
"""

from __future__ import annotations

import statistics
import sys
from pathlib import Path

import msgspec

from tests.unit.commissioning.trials import Trial, trial


class DrawLine(msgspec.Struct):
    """One draw in the file.

    Attributes:
        kind: Kind of load.
        seed: Seed of the draw.
        trial: Its result.
    """

    kind: str
    seed: int
    trial: Trial


def main() -> None:
    kind, number, first = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    file = Path(sys.argv[4]) if len(sys.argv) > 4 else None
    known = read(file) if file is not None and file.exists() else {}
    trials = []
    for seed in range(first, first + number):
        if (kind, seed) not in known:
            known[kind, seed] = trial(kind, seed)
            if file is not None:
                append(file, DrawLine(kind, seed, known[kind, seed]))
        trials.append(known[kind, seed])
    sys.stdout.write(f"{kind}: {summary(trials, first)}\n")


def read(file: Path) -> dict[tuple[str, int], Trial]:
    """Return the draws of a file."""
    with file.open("rb") as lines:
        found = [msgspec.json.decode(line, type=DrawLine) for line in lines]
    return {(one.kind, one.seed): one.trial for one in found}


def append(file: Path, line: DrawLine) -> None:
    """Add a draw to a file."""
    with file.open("ab") as lines:
        lines.write(msgspec.json.encode(line) + b"\n")


def summary(trials: list[Trial], first: int) -> str:
    """Return share of success, errors and movement."""
    complete = [one for one in trials if not one.refusal]
    right = sum(one.right for one in trials)
    rows = [f"{right} of {len(trials)} right, {len(trials) - len(complete)} refused"]
    for name in complete[0].errors if complete else ():
        errors = sorted(100.0 * abs(one.errors[name]) for one in complete)
        rows.append(f"{name}: median {statistics.median(errors):.2g} %, worst {errors[-1]:.3g} %")
    falls, peaks = [one.fall for one in trials], [one.peak for one in trials]
    rows.append(f"true output from {min(falls):.2f} to {max(peaks):.2f} of the movement asked for")
    loops = [one.loop for one in trials if one.loop is not None]
    stable, close = sum(one.pole < 1.0 for one in loops), sum(one.error <= 0.1 for one in loops)
    worst = max((one.error for one in loops), default=0.0)
    rows.append(f"{stable} of {len(loops)} loops stable, {close} within 10 %, worst {worst:.2g}")
    durations = [one.duration_s for one in complete]
    rows.append(f"median time {statistics.median(durations):.0f} s" if complete else "none right")
    for seed, one in enumerate(trials, first):
        if one.refusal:
            rows.append(f"{seed} refused: {one.refusal}")
        elif not one.right:
            rows.append(f"{seed} wrong: {one.errors} {one.sigmas}")
    return "\n  ".join(rows)


if __name__ == "__main__":
    main()
