"""Speed of campaigns, and its growth with the number of processes."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import dataclass

from adaptdrive_sim.campaign.main import run_seed, workers
from adaptdrive_sim.campaign.settings import Campaign

_BATCH = 4
_WARM_UPS = 8


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
    run_seed(campaign, campaign.seed)  # compiles once, on disk, for every process
    with ExitStack() as stack:
        pools = {count: stack.enter_context(workers(count, None)) for count in counts}
        for count, pool in pools.items():
            _run(campaign, pool, _WARM_UPS * _BATCH * count)
        found: dict[int, list[Round]] = {count: [] for count in counts}
        for _ in range(rounds):
            for count, pool in pools.items():
                found[count].append(_run(campaign, pool, runs))
    return found


def _run(campaign: Campaign, executor: Executor, runs: int) -> Round:
    """The same seeds each time."""
    batches = [range(first, first + _BATCH) for first in range(1, runs + 1, _BATCH)]
    began_s = time.perf_counter()
    cpu_s = sum(executor.map(_cpu_time_of, [campaign] * len(batches), batches))
    seconds = time.perf_counter() - began_s
    experiments = 2.0 * _BATCH * len(batches)
    return Round(experiments / seconds, 1e3 * cpu_s / experiments)


def _cpu_time_of(campaign: Campaign, seeds: range) -> float:
    began_s = time.process_time()
    for seed in seeds:
        run_seed(campaign, seed)
    return time.process_time() - began_s
