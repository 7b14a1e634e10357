"""Many runs at once: processes of this machine, or a Dask cluster."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager

from adaptdrive.errors import AdaptdriveError
from adaptdrive_sim.campaign.drawn import Row
from adaptdrive_sim.campaign.kinds import AnyCampaign, is_compiled, run_seed

_BATCH = 10


class ClusterError(AdaptdriveError):
    """A Dask cluster cannot be used."""

    def __init__(self, address: str, reason: str) -> None:
        self.address = address
        self.reason = reason
        super().__init__(f"scheduler {address}: {reason}")


def run_batch(campaign: AnyCampaign, seeds: range) -> list[Row]:
    """Run some seeds, one after the other; this is what a worker is sent."""
    return [run_seed(campaign, seed) for seed in seeds]


def run_all(campaign: AnyCampaign, executor: Executor) -> Iterator[list[Row]]:
    """Run every seed of a campaign; batches arrive in the order in which they are ready."""
    end = campaign.seed + campaign.runs
    size = _BATCH if is_compiled(campaign) else 1
    firsts = range(campaign.seed, end, size)
    batches = [range(first, min(first + size, end)) for first in firsts]
    futures: list[Future[list[Row]]] = [
        executor.submit(run_batch, campaign, batch) for batch in batches
    ]
    try:
        for future in as_completed(futures):
            yield future.result()
    finally:
        for future in futures:
            future.cancel()


@contextmanager
def workers(count: int | None, scheduler: str | None) -> Iterator[Executor]:
    """Yield an executor of runs.

    Args:
        count: Processes of this machine; as many as it has processors when left out.
        scheduler: Address of a Dask scheduler to use instead.

    Raises:
        ClusterError: There is no such cluster, or no way to talk to one.
    """
    if scheduler is not None:
        with _cluster(scheduler) as executor:
            yield executor
        return
    context = multiprocessing.get_context("spawn")
    number = count or len(os.sched_getaffinity(0))
    with ProcessPoolExecutor(number, mp_context=context) as executor:
        yield executor


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    try:
        from distributed import Client  # noqa: PLC0415  # an optional extra
    except ImportError as problem:
        reason = "needs the optional extra: pip install 'adaptdrive[cluster]'"
        raise ClusterError(address, reason) from problem
    try:
        client = Client(address, timeout=10)
    except (OSError, ValueError) as problem:
        raise ClusterError(address, str(problem)) from problem
    with client:
        yield client.get_executor()
