"""Summary and repeated runs of a campaign of batteries."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from rich.console import Console

from adaptdrive.control.signals import Mode
from adaptdrive_sim.campaign.battery_bench import judge_batteries, run_battery
from adaptdrive_sim.campaign.battery_scenario import draw_battery
from adaptdrive_sim.campaign.battery_settings import BatteryCampaign
from adaptdrive_sim.campaign.drawn import Row


def summarise_batteries(rows: list[Row]) -> str:
    """Return the time that adaptive was in force, and the largest ripple."""
    shares = np.array([row["adaptive_share"] for row in rows])
    ripples = np.array([row["ripple_found"] for row in rows])
    largest = 100.0 * np.max(ripples, initial=0.0, where=np.isfinite(ripples))
    half = np.count_nonzero(shares >= 0.5)
    return (
        f"adaptive in force for half of the constant current or more in {half} of "
        f"{len(rows)} runs, "
        f"median {100.0 * np.median(shares):.0f} %; largest ripple {largest:.2f} % peak to peak"
    )


def repeat_battery(campaign: BatteryCampaign, seed: int, output: Path, console: Console) -> None:
    """Run one seed with both controllers; write run-SEED.parquet and print its row."""
    tables = [_recorded(campaign, seed, mode) for mode in (Mode.FIXED, Mode.ADAPTIVE)]
    path = output / f"run-{seed}.parquet"
    pq.write_table(pa.concat_tables(tables), path)
    for name, value in judge_batteries(campaign, seed).items():
        console.print(f"{name:26} {value}")
    console.print(f"recorded: {path}")


def _recorded(campaign: BatteryCampaign, seed: int, mode: Mode) -> pa.Table:
    """Return the course of a run, a row for each slow period."""
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
    return pa.table(columns).append_column("mode", named)
