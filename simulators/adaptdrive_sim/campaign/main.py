"""The command `adaptdrive-sim campaign`: the loads of which it can draw runs, and their runs.

A file names a load by its key `type`. Runs go to processes of this machine, or to a Dask cluster.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

from adaptdrive.errors import AdaptdriveError
from adaptdrive_sim.campaign.bath_bench import BathStand, draw_bath
from adaptdrive_sim.campaign.bath_settings import BathCampaign
from adaptdrive_sim.campaign.battery_bench import (
    judge_batteries,
    repeat_battery,
    summarise_batteries,
)
from adaptdrive_sim.campaign.battery_scenario import BatteryCampaign
from adaptdrive_sim.campaign.bench import Stand, draw
from adaptdrive_sim.campaign.drawn import DrawnRun, Row
from adaptdrive_sim.campaign.judge import run_and_judge
from adaptdrive_sim.campaign.repeat import repeat
from adaptdrive_sim.campaign.report import print_results, write_results
from adaptdrive_sim.campaign.settings import MOST_RUNS, Campaign, read_campaign_of
from adaptdrive_sim.parameters import SEED_MAX, check_range

AnyCampaign = Campaign | BathCampaign | BatteryCampaign

TYPES: dict[str, type[AnyCampaign]] = {
    "motor": Campaign,
    "bath": BathCampaign,
    "battery": BatteryCampaign,
}


@dataclass(frozen=True, slots=True)
class CampaignKind:
    """Functions that a campaign needs for the runs of one load.

    Attributes:
        judge: Runs a seed with both controllers; returns its row of the results.
        repeat: Runs a seed again on the deployed controller, and records it.
        summarise: Returns what is printed below the tables that every load has.
        compiled: Whether its runs are compiled code.
    """

    judge: Callable[[Any, int], Row]
    repeat: Callable[[Any, int, Path, Console], None]
    summarise: Callable[[list[Row]], str]
    compiled: bool


def _drawn(stand: Callable[[Any, int], DrawnRun]) -> CampaignKind:
    """Return the kind of a load whose runs are compiled."""

    def judge_seed(campaign: AnyCampaign, seed: int) -> Row:
        return run_and_judge(stand(campaign, seed))

    def repeat_seed(campaign: AnyCampaign, seed: int, output: Path, console: Console) -> None:
        repeat(stand(campaign, seed), output, console)

    return CampaignKind(judge_seed, repeat_seed, lambda _: "", compiled=True)


_KINDS = {
    "motor": _drawn(lambda campaign, seed: Stand(draw(campaign, seed))),
    "bath": _drawn(lambda campaign, seed: BathStand(draw_bath(campaign, seed))),
    "battery": CampaignKind(judge_batteries, repeat_battery, summarise_batteries, compiled=False),
}


def read_any_campaign(path: Path) -> AnyCampaign:
    """Read a file of any type; one without the key `type` is of motors.

    Raises:
        CampaignError: It cannot be read, or a value is not allowed.
    """
    return read_campaign_of(path, TYPES)


def kind_of(campaign: AnyCampaign) -> CampaignKind:
    """Return what a campaign does with the runs of its load."""
    return _KINDS[campaign.type]


def is_compiled(campaign: AnyCampaign) -> bool:
    """Return whether the runs of a campaign are compiled code."""
    return kind_of(campaign).compiled


def run_seed(campaign: AnyCampaign, seed: int) -> Row:
    """Run one seed with both controllers and judge them: one row of the results."""
    return kind_of(campaign).judge(campaign, seed)


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


MOST_PROCESSES = 1024
_WARM_UPS = 64


def run_campaign(
    path: Path, output: Path, *, scheduler: str | None, processes: int | None, runs: int | None
) -> list[Row]:
    """Run a campaign and write what was found.

    Args:
        path: The campaign's file.
        output: Folder for the results; made when it is not there.
        scheduler: Address of a Dask scheduler; this machine when left out.
        processes: Processes of this machine; one for each processor when left out.
        runs: How many runs instead of the file's number.

    Raises:
        ParameterError: A number lies outside its range.
    """
    campaign = read_any_campaign(path)
    if processes is not None:
        check_range("--processes", processes, 1, MOST_PROCESSES, "")
    if runs is not None:
        check_range("--runs", runs, 1, MOST_RUNS, "")
        campaign = campaign.model_copy(update={"runs": runs})
    output.mkdir(parents=True, exist_ok=True)
    console = Console()
    if is_compiled(campaign):
        run_seed(campaign, campaign.seed)  # compiles once, on disk, for every worker
    with workers(processes, scheduler) as executor:
        _warm_up(campaign, executor)
        started_s = time.monotonic()
        rows = _with_progress(campaign, run_all(campaign, executor), console)
        seconds = time.monotonic() - started_s
    rows.sort(key=lambda row: row["seed"])
    write_results(rows, output)
    print_results(rows, seconds, path, console)
    if summary := kind_of(campaign).summarise(rows):
        console.print(summary)
    return rows


def repeat_run(path: Path, seed: int, output: Path) -> None:
    """Run one seed again on the deployed controller, and record it.

    Raises:
        ParameterError: The seed lies outside its range.
    """
    check_range("--only", seed, 0, SEED_MAX, "")
    output.mkdir(parents=True, exist_ok=True)
    campaign = read_any_campaign(path)
    kind_of(campaign).repeat(campaign, seed, output, Console())


def _warm_up(campaign: AnyCampaign, executor: Executor) -> None:
    """Load what was compiled in each process: starting up is no part of a campaign's speed."""
    if is_compiled(campaign):
        list(executor.map(run_seed, [campaign] * _WARM_UPS, [campaign.seed] * _WARM_UPS))


def _with_progress(
    campaign: AnyCampaign, batches: Iterator[list[Row]], console: Console
) -> list[Row]:
    """Collect batches; the bar is shown on a terminal only."""
    columns = (BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    rows: list[Row] = []
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        task = progress.add_task("", total=campaign.runs)
        for batch in batches:
            rows += batch
            progress.advance(task, len(batch))
    return rows
