"""One run again, on the deployed controller itself, recorded and drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from matplotlib.figure import Figure
from rich.console import Console

from adaptdrive.analysis import style
from adaptdrive.control.signals import Mode
from adaptdrive_sim.campaign.drawn import DrawnRun, Trial
from adaptdrive_sim.campaign.judge import judge
from adaptdrive_sim.course import Run
from adaptdrive_sim.experiments.figure import CONTROLLERS, SYMBOLS, mark_in_force, minutes_of
from adaptdrive_sim.recorded import table_of


def repeat(trial: Trial, seed: int, output: Path, console: Console) -> None:
    """Run one seed with both controllers, interpreted; write run-SEED.parquet, and a picture."""
    modes = Mode.FIXED, Mode.ADAPTIVE
    runs = {mode.value: trial.described(trial.run_deployed(mode)) for mode in modes}
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
    minutes = minutes_of(fixed)
    top.plot(minutes, fixed["ideal"], label="as designed", **style.TRUTH)
    for name, run in (("fixed", fixed), ("adaptive", adaptive)):
        label, look = CONTROLLERS[name]
        top.plot(minutes, run["output"], label=label, **look)
        middle.plot(minutes, run["boost_reference_V"], label=label, **look)
    truth = np.array([stand.truth_at(k) for k in range(minutes.size)])
    for i, name in enumerate(stand.own.load.names):
        estimates = adaptive[name] / truth[:, i]
        bottom.plot(minutes, estimates, color=style.PARAMETERS[i], label=SYMBOLS[name])
    mark_in_force(bottom, adaptive)
    top.set(ylabel="output", title=f"seed {stand.seed}")
    middle.set(ylabel="V_c, V")
    bottom.set(xlabel="time, min", ylabel="estimate over truth", ylim=(0.0, 2.5))
    for axes in (top, middle, bottom):
        for time_s in stand.change_times_s:
            axes.axvline(time_s / 60.0, color="k", lw=0.6, ls=":")
        axes.grid(visible=True, alpha=0.3)
        axes.legend(loc="upper right")
    return figure
