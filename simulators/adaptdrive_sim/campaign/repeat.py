"""One run again, on the deployed controller itself, recorded and drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from matplotlib.figure import Figure
from rich.console import Console

from adaptdrive.control.signals import Mode
from adaptdrive_sim.campaign.drawn import DrawnRun, Trial
from adaptdrive_sim.campaign.judge import judge
from adaptdrive_sim.course import Run
from adaptdrive_sim.recorded import table_of


def repeat(trial: Trial, seed: int, output: Path, console: Console) -> None:
    """Run one seed with both controllers, interpreted; write run-SEED.parquet, and a picture."""
    runs = {mode.value: trial.run_deployed(mode) for mode in (Mode.FIXED, Mode.ADAPTIVE)}
    path = output / f"run-{seed}.parquet"
    pq.write_table(pa.concat_tables([table_of(run, mode=name) for name, run in runs.items()]), path)
    for name, value in judge(trial, *runs.values()).items():
        console.print(f"{name:26} {value}")
    if isinstance(trial, DrawnRun):
        picture(trial, *runs.values()).savefig(path.with_suffix(".png"), dpi=120)
        console.print(f"changes at {trial.change_times_s} s, at last to {trial.sizes[-1]:.4g}")
    console.print(f"recorded: {path}")


def picture(stand: DrawnRun, fixed: Run, adaptive: Run) -> Figure:
    """Output, boost voltage and estimates of one run."""
    figure = Figure(figsize=(11, 8), layout="constrained")
    top, middle, bottom = figure.subplots(3, 1, sharex=True)
    times_s = stand.times_s
    top.plot(times_s, fixed["ideal"], "k", lw=0.8, label="as designed")
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
