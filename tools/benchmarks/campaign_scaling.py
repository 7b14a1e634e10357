"""Measure how campaigns scale: one and two processes take turns on the same seeds.

Run it on a machine that does nothing else, with `python -m tools.benchmarks.campaign_scaling`: it
takes some minutes on compiled modules, and four times as long on the sources.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from adaptdrive_sim.campaign import run_seed, workers
from adaptdrive_sim.campaign.settings import Campaign, read_campaign

COUNTS = (1, 2)
RUNS, ROUNDS = 16, 5


@dataclass(frozen=True, slots=True)
class Round:
    """One measurement.

    Attributes:
        experiments_per_s: Experiments by the clock on the wall; a run is two of them.
        cpu_ms: Time of a processor for each.
    """

    experiments_per_s: float
    cpu_ms: float


def measure(
    campaign: Campaign, counts: Sequence[int], *, runs: int, rounds: int
) -> dict[int, list[Round]]:
    """Time a campaign on different numbers of processes that take turns, so that they compare.

    Args:
        campaign: What to run.
        counts: Numbers of processes.
        runs: Runs in each round.
        rounds: How often each number has its turn.
    """
    with ExitStack() as stack:
        pools = {count: stack.enter_context(workers(count, None)) for count in counts}
        for count, pool in pools.items():
            _run(campaign, pool, count)  # starts its processes
        found: dict[int, list[Round]] = {count: [] for count in counts}
        for _ in range(rounds):
            for count, pool in pools.items():
                found[count].append(_run(campaign, pool, runs))
    return found


def _run(campaign: Campaign, executor: Executor, runs: int) -> Round:
    """The same seeds each time."""
    began_s = time.perf_counter()
    cpu_s = sum(executor.map(_cpu_time_of, [campaign] * runs, range(1, runs + 1)))
    seconds = time.perf_counter() - began_s
    return Round(2.0 * runs / seconds, 1e3 * cpu_s / (2.0 * runs))


def _cpu_time_of(campaign: Campaign, seed: int) -> float:
    began_s = time.process_time()
    run_seed(campaign, seed)
    return time.process_time() - began_s


def main() -> None:
    """Measure and print."""
    found = measure(read_campaign(Path("standard.toml")), COUNTS, runs=RUNS, rounds=ROUNDS)
    for count, rounds in found.items():
        speeds = sorted(one.experiments_per_s for one in rounds)
        cpu_ms = median(one.cpu_ms for one in rounds)
        told = f"{median(speeds):.1f} experiments/s ({speeds[0]:.1f} to {speeds[-1]:.1f})"
        print(f"{count} processes: {told}, {cpu_ms:.0f} ms CPU each")  # noqa: T201


if __name__ == "__main__":
    main()
