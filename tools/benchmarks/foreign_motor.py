"""A foreign motor whose inertia doubles and triples under a square wave, on seeds of your own.

    python -m tools.benchmarks.foreign_motor SEED [--runs N]

prints how many runs hold each claim, and a line for each run that does not hold all of them.
"""

from __future__ import annotations

import sys

from tests.closed_loop.foreign_motor import JUDGED_S, WITHIN, Judged, draw, run
from tools.benchmarks.seeds import over_seeds


def main() -> None:
    """Print the counts."""
    found: list[Judged] = []
    for seed, judged in over_seeds(_judged, __doc__, runs=200):
        found.append(judged)
        if not _holds(judged):
            sys.stdout.write(f"{seed}: {judged}\n")
            sys.stdout.flush()
    sys.stdout.write(_summary(found))


def _judged(seed: int) -> Judged:
    return run(draw(seed))[1]


def _holds(judged: Judged) -> bool:
    return all(judged.known) and all(judged.in_force) and not any(judged.fell_back)


def _summary(found: list[Judged]) -> str:
    known = sum(all(one.known) for one in found)
    changes = [worst for one in found for worst in one.worst]
    close = sum(relative <= WITHIN for _, relative, _ in changes)
    in_force = sum(all(one.in_force) for one in found)
    fell_back = sum(any(one.fell_back) for one in found)
    return (
        f"{len(found)} runs, {len(changes)} changes\n"
        f"right or within two shown deviations {JUDGED_S:g} s after both changes: {known} runs\n"
        f"of the changes, every parameter within {100 * WITHIN:g} % then: {close}\n"
        f"adaptive in force one cycle after both changes: {in_force} runs\n"
        f"adaptive not in force at some time after that: {fell_back} runs\n"
    )


if __name__ == "__main__":
    main()
