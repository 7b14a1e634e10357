"""One run again, on the deployed controller itself, recorded and drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console

from adaptdrive.control.signals import Mode
from adaptdrive_sim.campaign.drawn import DrawnRun
from adaptdrive_sim.campaign.judge import judge
from adaptdrive_sim.course import Run

Array = NDArray[np.float64]


def repeat(stand: DrawnRun, output: Path, console: Console) -> None:
    """Run one seed with both controllers, interpreted; write run-SEED.parquet and run-SEED.png."""
    seed = stand.seed
    fixed, adaptive = (stand.run_deployed(mode) for mode in (Mode.FIXED, Mode.ADAPTIVE))
    pq.write_table(_table(stand, fixed, adaptive), output / f"run-{seed}.parquet")
    picture(stand, fixed, adaptive).savefig(output / f"run-{seed}.png", dpi=120)
    for name, value in judge(stand, fixed, adaptive).items():
        console.print(f"{name:26} {value}")
    changes = f"changes at {stand.change_times_s} s, at last to {stand.sizes[-1]:.4g}"
    console.print(f"{stand.size_name} {changes}")
    console.print(f"recorded: {output / f'run-{seed}.parquet'}, {output / f'run-{seed}.png'}")


def _table(stand: DrawnRun, fixed: Run, adaptive: Run) -> pa.Table:
    columns: dict[str, Array | list[str]] = {
        "time_s": stand.times_s,
        "reference": stand.references,
        stand.size_name: stand.sizes,
        "ideal": stand.ideal(),
        "output_fixed": fixed["output"],
        "boost_reference_fixed_V": fixed["boost_reference_V"],
        "output_adaptive": adaptive["output"],
        "boost_reference_adaptive_V": adaptive["boost_reference_V"],
        "innovation": adaptive["innovation"],
        "handover_step_V": adaptive["handover_step_V"],
    }
    decisions = adaptive.decisions
    rest = len(stand.times_s) - len(decisions)
    columns["reason"] = [one.reason for one in decisions] + [""] * rest
    for name in decisions[0].estimates:
        values = [one.estimates[name].value for one in decisions]
        columns[name] = np.pad(values, (0, rest), constant_values=np.nan)
    return pa.table(columns)


def picture(stand: DrawnRun, fixed: Run, adaptive: Run) -> Figure:
    """Output, boost voltage and estimates of one run."""
    figure = Figure(figsize=(11, 8), layout="constrained")
    top, middle, bottom = figure.subplots(3, 1, sharex=True)
    times_s = stand.times_s
    top.plot(times_s, stand.ideal(), "k", lw=0.8, label="as designed")
    for name, outcome, colour in (
        ("fixed", fixed, "tab:orange"),
        ("adaptive", adaptive, "tab:blue"),
    ):
        top.plot(times_s, outcome["output"], color=colour, lw=1.0, label=name)
        voltage_V = outcome["boost_reference_V"]
        middle.plot(times_s, voltage_V, color=colour, lw=1.0, label=name)
    truth = np.array([stand.truth_at(k) for k in range(times_s.size)])
    for i, name in enumerate(stand.own.load.names):
        estimates = adaptive[name] / truth[:, i]
        bottom.plot(times_s, estimates, lw=1.0, label=name)
    bottom.fill_between(
        times_s,
        0.0,
        0.05,
        where=(adaptive["adaptive"] > 0.0).tolist(),
        transform=bottom.get_xaxis_transform(),
        color="tab:green",
        label="adaptive in force",
    )
    top.set(ylabel="output, V", title=f"seed {stand.seed}")
    middle.set(ylabel="V_c, V")
    bottom.set(xlabel="time, s", ylabel="estimate over truth", ylim=(0.0, 2.5))
    for axes in (top, middle, bottom):
        for time_s in stand.change_times_s:
            axes.axvline(time_s, color="k", lw=0.6, ls=":")
        axes.grid(visible=True, alpha=0.3)
        axes.legend(loc="upper right")
    return figure
