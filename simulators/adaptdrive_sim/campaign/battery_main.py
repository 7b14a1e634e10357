"""The command `adaptdrive-sim campaign` with a file of batteries."""

from __future__ import annotations

import json
import time
import tomllib
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import ValidationError
from rich.console import Console

from adaptdrive.analysis import style
from adaptdrive.control.signals import Mode
from adaptdrive_sim.campaign.battery_bench import Row, judge_batteries, run_battery
from adaptdrive_sim.campaign.battery_scenario import draw_battery
from adaptdrive_sim.campaign.battery_settings import BatteryCampaign
from adaptdrive_sim.campaign.pool import workers
from adaptdrive_sim.campaign.report import costs, print_results
from adaptdrive_sim.campaign.settings import FOLDER, CampaignError


def found_file(path: Path) -> Path:
    """Return a file, or the one of its name that comes along."""
    shipped = FOLDER / path.name
    return path if path.exists() or not shipped.exists() else shipped


def is_of_batteries(path: Path) -> bool:
    """Return whether a file says `type = "battery"`; False where it cannot be read."""
    try:
        tables = tomllib.loads(found_file(path).read_text(encoding="utf-8"))
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError):
        return False
    return tables.get("type") == "battery"


def read_battery_campaign(path: Path) -> BatteryCampaign:
    """Read a file of batteries.

    Raises:
        CampaignError: A value is not allowed.
    """
    tables = tomllib.loads(found_file(path).read_text(encoding="utf-8"))
    try:
        return BatteryCampaign.model_validate_json(json.dumps(tables))
    except ValidationError as problem:
        told = [
            f"{'.'.join(map(str, one['loc']))} = {one['input']!r}: {one['msg']}"
            for one in problem.errors()
        ]
        raise CampaignError(path, told) from problem


def run_batteries(
    path: Path, output: Path, *, scheduler: str | None, processes: int | None, runs: int | None
) -> list[Row]:
    """Run a campaign of batteries and write what was found; the arguments of `run_campaign`."""
    campaign, console = read_battery_campaign(path), Console()
    seeds = range(campaign.seed, campaign.seed + (runs or campaign.runs))
    output.mkdir(parents=True, exist_ok=True)
    started_s = time.monotonic()
    with workers(processes, scheduler) as executor:
        rows = list(executor.map(partial(judge_batteries, campaign), seeds))
    pq.write_table(pa.Table.from_pylist(rows), output / "results.parquet")
    with style.journal():
        costs(rows).savefig(output / "costs.png", dpi=style.DPI)
    print_results(rows, time.monotonic() - started_s, path, console)
    console.print(_summary(rows))
    return rows


def _summary(rows: list[Row]) -> str:
    """Return how long adaptive was in force, and the largest ripple."""
    shares = np.array([row["adaptive_share"] for row in rows])
    ripples = np.array([row["ripple_found"] for row in rows])
    largest = 100.0 * np.max(ripples, initial=0.0, where=np.isfinite(ripples))
    half = np.count_nonzero(shares >= 0.5)
    return (
        f"adaptive in force for half of the constant current or more in {half} of "
        f"{len(rows)} runs, "
        f"median {100.0 * np.median(shares):.0f} %; largest ripple {largest:.2f} % peak to peak"
    )


def repeat_battery(path: Path, seed: int, output: Path) -> None:
    """Run one seed with both controllers; write run-SEED.parquet and print its row."""
    output.mkdir(parents=True, exist_ok=True)
    campaign, console = read_battery_campaign(path), Console()
    tables = []
    for mode in (Mode.FIXED, Mode.ADAPTIVE):
        run = run_battery(draw_battery(campaign, seed), mode)
        columns = {
            "time_s": run.time_s,
            "reference_A": run.reference,
            "current_A": run.output,
            "terminal_V": run.terminal_V,
            "adaptive": run.adaptive,
            "reason": run.reason,
        }
        named = pa.array([mode.value] * len(run.time_s), pa.string())
        tables.append(pa.table(columns).append_column("mode", named))
    pq.write_table(pa.concat_tables(tables), output / f"run-{seed}.parquet")
    for name, value in judge_batteries(campaign, seed).items():
        console.print(f"{name:26} {value}")
    console.print(f"recorded: {output / f'run-{seed}.parquet'}")
