"""`adaptdrive-sim campaign`: thousands of drawn runs of a load, fixed and adaptive side by side.

A file names a load by its key `type`. Runs go to processes of this machine, or to a Dask cluster.
"""

import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from rich.console import Console

from adaptdrive.control.signals import Mode
from adaptdrive.util.errors import AdaptdriveError
from adaptdrive_sim.campaign import batteries, drawn, report, settings, stands
from adaptdrive_sim.course import processes, progress
from adaptdrive_sim.parameters import SEED_MAX, check_range

AnyCampaign = settings.Campaign | settings.BathCampaign | batteries.BatteryCampaign

_TYPES: dict[str, tuple[type[AnyCampaign], Callable[..., report.Trial]]] = {
    "motor": (settings.Campaign, lambda *given: stands.Stand(stands.draw(*given))),
    "bath": (settings.BathCampaign, lambda *given: stands.BathStand(stands.draw_bath(*given))),
    "battery": (batteries.BatteryCampaign, batteries.draw_battery),
}
"""Contents of a file, and what makes the run of a campaign that a seed stands for."""


def read_any_campaign(path: Path) -> AnyCampaign:
    """Read a file of any type; one without the key `type` is of motors.

    Raises:
        ConfigurationError: It cannot be read, or a value is not allowed.
    """
    return settings.read_campaign_of(path, {name: one[0] for name, one in _TYPES.items()})


def run_seed(campaign: AnyCampaign, seed: int) -> drawn.Row:
    """Run one seed with both controllers and judge them: one row of the results."""
    trial = _TYPES[campaign.type][1](campaign, seed)
    return report.judge(trial, trial.run(Mode.FIXED), trial.run(Mode.ADAPTIVE))


def run_all(campaign: AnyCampaign, executor: Executor) -> Iterator[drawn.Row]:
    """Run every seed of a campaign; rows arrive in the order of their seeds."""
    seeds = range(campaign.seed, campaign.seed + campaign.runs)
    return executor.map(partial(run_seed, campaign), seeds)


@contextmanager
def workers(count: int | None, scheduler: str | None) -> Iterator[Executor]:
    """Yield an executor of runs.

    Args:
        count: Processes of this machine; as many as it has processors when left out.
        scheduler: Address of a Dask scheduler to use instead.

    Raises:
        AdaptdriveError: There is no such cluster, or no way to talk to one.
    """
    if scheduler is None:
        with processes(count or len(os.sched_getaffinity(0))) as executor:
            yield executor
        return
    try:
        from distributed import Client  # noqa: PLC0415  # an optional extra

        client = Client(scheduler, timeout=10)
    except ImportError as problem:
        reason = "needs the optional extra: pip install 'adaptdrive[cluster]'"
        raise AdaptdriveError(f"scheduler {scheduler}: {reason}") from problem
    except (OSError, ValueError) as problem:
        raise AdaptdriveError(f"scheduler {scheduler}: {problem}") from problem
    with client:
        yield client.get_executor()


MOST_PROCESSES = 1024


def run_campaign(
    path: Path, output: Path, *, scheduler: str | None, processes: int | None, runs: int | None
) -> list[drawn.Row]:
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
        check_range("--runs", runs, 1, settings.MOST_RUNS, "")
        campaign = campaign.model_copy(update={"runs": runs})
    output.mkdir(parents=True, exist_ok=True)
    console, rows = Console(), list[drawn.Row]()
    with workers(processes, scheduler) as executor, progress(campaign.runs) as done:
        started_s = time.monotonic()
        for row in run_all(campaign, executor):
            rows.append(row)
            done(1, "")
        seconds = time.monotonic() - started_s
    report.write_results(rows, output)
    report.print_results(rows, seconds, path, console)
    if isinstance(campaign, batteries.BatteryCampaign):
        console.print(batteries.summarise(rows))
    return rows


def repeat_run(path: Path, seed: int, output: Path) -> None:
    """Run one seed again, and record it.

    Raises:
        ParameterError: The seed lies outside its range.
    """
    check_range("--only", seed, 0, SEED_MAX, "")
    output.mkdir(parents=True, exist_ok=True)
    campaign = read_any_campaign(path)
    report.repeat(_TYPES[campaign.type][1](campaign, seed), seed, output, Console())
