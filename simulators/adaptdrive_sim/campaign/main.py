"""The command `adaptdrive-sim campaign`."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import Executor
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

from adaptdrive_sim.campaign.drawn import Row
from adaptdrive_sim.campaign.kinds import (
    AnyCampaign,
    is_compiled,
    kind_of,
    read_any_campaign,
    run_seed,
)
from adaptdrive_sim.campaign.pool import run_all, workers
from adaptdrive_sim.campaign.report import print_results, write_results
from adaptdrive_sim.campaign.settings import MOST_RUNS
from adaptdrive_sim.parameters import SEED_MAX, check_range

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
