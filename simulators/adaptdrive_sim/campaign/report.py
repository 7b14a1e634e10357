"""The results of a campaign: verdicts, a file, a table, pictures; and one run again.

The cost of a controller is the squared error against the loop as it was designed, summed over the
slow instants, plus (0.005 · step)² for each: errors below any display cost nothing relative to
that.
"""

from collections.abc import Callable
from itertools import cycle
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from adaptdrive.analysis import figures
from adaptdrive.control.signals import Mode
from adaptdrive_sim.campaign.batteries import BatteryScenario
from adaptdrive_sim.campaign.drawn import DrawnRun, Row
from adaptdrive_sim.course import Array, Run
from adaptdrive_sim.experiments.figure import CONTROLLERS, SYMBOLS, mark_in_force, minutes_of
from adaptdrive_sim.experiments.reproduce import Claim, print_claims

Trial = DrawnRun | BatteryScenario
"""The run of one seed, for as many controllers as are to run it."""

# Judges a run by criteria that every load shares.

FLOOR = 0.005
WORSE = 1.05
UNSTABLE = 0.5
"""Of the largest movement that is expected: rms error at the end of an unstable run, whose last
period of the reference is nothing like what was designed."""


def cost(errors: Array) -> float:
    """Mean squared error, as a fraction of the step, with the floor; infinite if it ended early."""
    if not np.all(np.isfinite(errors)):
        return float("inf")
    return float(np.mean(errors**2)) + FLOOR**2


def rms(errors: Array) -> float:
    """Return the root of the mean squared error."""
    return float(np.sqrt(np.mean(errors**2)))


def judge(trial: Trial, fixed: Run, adaptive: Run) -> Row:
    """Return one row of the results."""
    row = trial.columns()
    unstable = UNSTABLE * trial.largest_movement / trial.step
    for name, run in (("fixed", fixed), ("adaptive", adaptive)):
        errors = trial.errors(run)
        row[f"cost_{name}"], row[f"rms_{name}"] = cost(errors), rms(errors)
        row[f"largest_{name}"] = float(np.max(np.abs(errors)))
        row[f"unstable_{name}"] = not rms(errors[-trial.cycle_periods :]) < unstable
        row[f"interlock_{name}"] = run.interlock
        row |= {f"trip_{name}": run.trip, f"refused_{name}": len(run.refused)}
    row["ratio"] = row["cost_adaptive"] / row["cost_fixed"]
    return row | trial.seen(adaptive)


# The results of a campaign: a file, a table, pictures; and one run again, recorded and drawn.

BETTER_SHARE = 0.95

_MUCH = 0.1
"""Share of the time that is named as a reason."""


Failure = tuple[str, Row]
"""Kind of a failure, and the row of the run in which it was."""

_NAMES = "fixed", "adaptive"

_HELD = "interlock", "unstable"
"""Columns of each controller that say that it did not hold the load."""


def failures(rows: list[Row]) -> list[Failure]:
    """Every run in which adaptive control failed, the worst first."""
    found = [(cause, row) for cause in _HELD for row in _lost(rows, cause, fixed_too=False)]
    found += [("worse than fixed", row) for row in rows if row["ratio"] > WORSE]
    return sorted(found, key=lambda one: (one[0], -one[1]["ratio"]))


def shared_failures(rows: list[Row]) -> list[Failure]:
    """Every run that neither controller has held."""
    return [
        (f"{cause}, fixed too", row)
        for cause in _HELD
        for row in _lost(rows, cause, fixed_too=True)
    ]


def _lost(rows: list[Row], cause: str, *, fixed_too: bool) -> list[Row]:
    lost = (row for row in rows if row[f"{cause}_adaptive"])
    return [row for row in lost if bool(row[f"{cause}_fixed"]) is fixed_too]


def reason_of(row: Row) -> str:
    """Return what lasted for much of a run with adaptive control and keeps it from its design."""
    verdicts = sum(value for name, value in row.items() if name.startswith("verdict_"))
    shares = {
        "V_c at a limit": row.get("saturated_share", 0.0),
        "estimate outside of the bounds": row.get("verdict_out_of_bounds", 0) / max(1, verdicts),
    }
    named = [f"{one} for {share:.0%} of the time" for one, share in shares.items() if share > _MUCH]
    return "; ".join(named) or "none of those that are looked for"


def claims(rows: list[Row]) -> list[Claim]:
    """Return the claims of a campaign."""
    changed = [row for row in rows if row["changes"]]
    better = sum(row["ratio"] < 1.0 for row in changed)
    share = better / len(changed) if changed else 1.0
    return [
        _none(rows, "no run is unstable that fixed control holds", "unstable"),
        _none(rows, "no run ends with an interlock that fixed control ends without", "interlock"),
        _none(rows, "adaptive never costs over 5 % more than fixed", "worse than fixed"),
        Claim(
            "adaptive is better in the runs whose load changed",
            f"{better} of {len(changed)}, {100.0 * share:.1f} %",
            f"at least {100.0 * BETTER_SHARE:g} %",
            share >= BETTER_SHARE,
        ),
    ]


def _none(rows: list[Row], text: str, cause: str) -> Claim:
    count = sum(one == cause for one, _ in failures(rows))
    shared = sum(one.startswith(cause) for one, _ in shared_failures(rows))
    others = f"; {shared} with fixed control too" if shared else ""
    return Claim(text, f"{count} of {len(rows)}{others}", "none", count == 0)


_SHOWN = 20

_INFLUENCES: tuple[dict[str, str], ...] = (
    {
        "size_largest": "largest inertia, disks",
        "sigma": "noise σ, fraction of the step",
        "gain": "gain, relative",
        "filter": "τ_f, relative",
        "step": "step, V",
        "period_s": "period of the reference, s",
    },
    {
        "size_largest": "largest volume, US gal",
        "sigma": "noise σ, K",
        "resistance": "heater resistance, relative",
        "drift_K_per_h": "drift of the inflow, K/h",
        "step": "step, K",
        "period_s": "period of the reference, s",
    },
    {
        "full_V": "full voltage, V",
        "current_A": "current, A",
        "charge": "charge at the start",
        "series": "series resistance, relative",
        "relaxation_s": "relaxation time, relative",
        "noise": "noise σ, fraction of the largest current",
    },
)
"""Six drawn values of a motor, of a bath, and of a battery."""


def write_results(rows: list[Row], output: Path) -> None:
    """Write results.parquet and the pictures."""
    pq.write_table(pa.Table.from_pylist(rows), output / "results.parquet")
    with figures.journal():
        costs(rows).savefig(output / "costs.png", dpi=figures.DPI)
        influences(rows).savefig(output / "influences.png", dpi=figures.DPI)


def print_results(rows: list[Row], seconds: float, campaign: Path, console: Console) -> None:
    """Print what was found and how to repeat what failed."""
    speed = 2.0 * len(rows) / seconds
    title = f"{len(rows)} runs, each fixed and adaptive, in {seconds:.1f} s"
    print_claims(f"{title}: {speed:.1f} experiments per second", claims(rows))
    console.print(_cost_table(rows))
    again = f"adaptdrive-sim campaign {campaign} --output DIR --only"
    for found, heading, last, text_of in (
        (failures(rows), "failure", "repeat", lambda row: f"{again} {row['seed']}"),
        (shared_failures(rows), "neither controller", "what the run shows", reason_of),
    ):
        if found:
            console.print(
                _failure_table(found, Table(heading, "seed", "cost ratio", last), text_of)
            )


def _cost_table(rows: list[Row]) -> Table:
    table = Table("runs", "count", "fixed", "adaptive", "ratio, median", "95 %", "worst")
    groups = {
        "load changed": [row for row in rows if row["changes"]],
        "load unchanged": [row for row in rows if not row["changes"]],
    }
    for name, group in groups.items():
        if not group:
            continue
        ratios = np.array([row["ratio"] for row in group])
        rms = [f"{np.median([row[f'rms_{one}'] for row in group]):.4f}" for one in _NAMES]
        marks = [f"{float(np.quantile(ratios, share)):.3f}" for share in (0.5, 0.95, 1.0)]
        table.add_row(name, str(len(group)), *rms, *marks)
    table.caption = "rms error against the designed loop, fraction of the step, median; cost ratio"
    return table


def _failure_table(found: list[Failure], table: Table, text_of: Callable[[Row], str]) -> Table:
    """Add the first failures to a table, each with what its last column contains."""
    for cause, row in found[:_SHOWN]:
        table.add_row(cause, str(row["seed"]), f"{row['ratio']:.3f}", text_of(row))
    if len(found) > _SHOWN:
        table.caption = f"and {len(found) - _SHOWN} more, see results.parquet"
    return table


def costs(rows: list[Row]) -> Figure:
    """Cost of the adaptive controller over that of the fixed one, run by run."""
    figure = Figure(figsize=(figures.WIDTH_in, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    groups = (True, figures.ADAPTIVE["color"], "changed"), (False, figures.FIXED["color"], "same")
    for changed, colour, label in groups:
        group = [row for row in rows if bool(row["changes"]) is changed]
        fixed = [row["cost_fixed"] for row in group]
        adaptive = [row["cost_adaptive"] for row in group]
        left.loglog(fixed, adaptive, ".", ms=2.5, alpha=0.6, color=colour, label=f"load {label}")
        ratios = np.sort([row["ratio"] for row in group])
        share = (np.arange(ratios.size) + 1.0) / max(1, ratios.size)
        right.semilogx(ratios, share, color=colour, label=f"load {label}")
    ends = [row[f"cost_{one}"] for row in rows for one in _NAMES]
    ends = [value for value in ends if np.isfinite(value)]
    if ends:
        left.loglog([min(ends), max(ends)], [min(ends), max(ends)], color="0.35", lw=0.6)
    left.set(xlabel="cost of the fixed controller", ylabel="cost of the adaptive controller")
    right.axvline(WORSE, color="0.35", lw=0.6, ls=":", label="5 % worse")
    right.set(xlabel="cost ratio, adaptive over fixed", ylabel="share of the runs below")
    for axes in (left, right):
        axes.legend()
    figures.letter(left, "a", "Cost of each run")
    figures.letter(right, "b", "Distribution of the cost ratio")
    return figure


def influences(rows: list[Row]) -> Figure:
    """Plot the cost ratio over the drawn values that matter most."""
    names = next(one for one in _INFLUENCES if set(one) <= set(rows[0]))
    figure = Figure(figsize=(figures.WIDTH_in, 4.6), layout="constrained")
    shapes = sorted({row["shape"] for row in rows})
    for axes, (name, label) in zip(figure.subplots(2, 3).flat, names.items(), strict=True):
        for shape, colour in zip(shapes, cycle((*figures.PARAMETERS, "0.5")), strict=False):
            chosen = [row for row in rows if row["shape"] == shape]
            values, ratios = ([row[one] for row in chosen] for one in (name, "ratio"))
            axes.semilogy(values, ratios, ".", ms=2.5, color=colour, label=shape)
        axes.axhline(WORSE, color="0.35", lw=0.6, ls=":")
        axes.set(xlabel=label, ylabel="cost ratio")
    named = figure.axes[0].get_legend_handles_labels()
    figure.legend(*named, loc="outside upper center", ncols=len(shapes))
    return figure


def repeat(trial: Trial, seed: int, output: Path, console: Console) -> None:
    """Run one seed with both controllers; write run-SEED.parquet, and a picture."""
    modes = Mode.FIXED, Mode.ADAPTIVE
    runs = {mode.value: trial.run(mode) for mode in modes}
    if isinstance(trial, DrawnRun):
        runs = {name: trial.described(run) for name, run in runs.items()}
    path = output / f"run-{seed}.parquet"
    pq.write_table(pa.concat_tables([run.table(mode=name) for name, run in runs.items()]), path)
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
    top.plot(minutes, fixed["ideal"], label="as designed", **figures.TRUTH)
    for name, run in (("fixed", fixed), ("adaptive", adaptive)):
        label, look = CONTROLLERS[name]
        top.plot(minutes, run["output"], label=label, **look)
        middle.plot(minutes, run["boost_reference_V"], label=label, **look)
    truth = np.array([stand.truth_at(k) for k in range(minutes.size)])
    for i, name in enumerate(stand.own.load.names):
        estimates = adaptive[name] / truth[:, i]
        bottom.plot(minutes, estimates, color=figures.PARAMETERS[i], label=SYMBOLS[name])
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
