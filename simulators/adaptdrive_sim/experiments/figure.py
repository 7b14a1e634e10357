"""The figures of the experiments, laid out like the paper's Fig. 4 and Fig. 9, with more panels."""

from __future__ import annotations

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from adaptdrive.analysis import style
from adaptdrive.control.load import to_input
from adaptdrive_sim.experiments import figure_parts as parts
from adaptdrive_sim.experiments.case import Variant
from adaptdrive_sim.experiments.outcome import ExperimentOutcome
from adaptdrive_sim.experiments.runner import RunRecord

_TITLES: dict[Variant, str] = {
    "fixed": "fixed controller",
    "adaptive": "adaptive controller",
    "direct_rls": "direct RLS",
}


def draw_experiment(outcome: ExperimentOutcome, path: Path) -> None:
    """Draw the figure of an experiment as a PNG."""
    with style.journal():
        save(experiment_figure(outcome), path)


def experiment_figure(outcome: ExperimentOutcome) -> Figure:
    """Return the figure of an experiment."""
    return _DRAW[outcome.experiment.name](outcome)


def save(figure: Figure, path: Path) -> None:
    """Write a figure as a PNG, the same bytes each time."""
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=style.DPI, metadata={"Software": None})


def _draw_motor(outcome: ExperimentOutcome) -> Figure:
    """Tachometer and drive voltage of each controller, as in Fig. 9; estimates; model errors."""
    figure = Figure(figsize=(style.WIDTH_in, 11.4), layout="constrained")
    rows = figure.subplots(
        8, 1, sharex=True, height_ratios=(1.5, 0.8, 1.5, 0.8, 1.5, 0.8, 1.1, 0.9)
    )
    axes = list(rows)
    speeds, voltages = axes[0:6:2], axes[1:6:2]
    for i, (variant, title) in enumerate(_TITLES.items()):
        record, look = outcome.records[variant], parts.CONTROLLERS[variant][1]
        parts.draw_output(speeds[i], record, "without noise", look)
        parts.draw_voltage(voltages[i], record, look)
        style.letter(speeds[i], "ace"[i], f"Speed, {title}")
        style.letter(voltages[i], "bdf"[i], f"Drive voltage, {title}")
        if variant != "fixed":
            parts.mark_warm_up(voltages[i], outcome, record)
        style.legend_above(speeds[i], 3)
        style.legend_above(voltages[i], 4)
        speeds[i].set_ylabel("Tachometer (V)")
        voltages[i].set_ylabel("Voltage (V)")
    parts.show_whole(speeds, _outputs(outcome))
    parts.show_whole(voltages, [one.applied_V for one in outcome.records.values()] + [[200, 400]])
    parts.draw_estimates(axes[6], outcome, (-0.5, 4.5))
    style.letter(axes[6], "g", "Estimates (transients beyond the axis are cut)")
    parts.draw_model_errors(axes[7], outcome)
    style.letter(axes[7], "h", "Deviation from the ideal closed loop")
    parts.mark_changes(axes, outcome.experiment)
    parts.name_segments(speeds[0], outcome.experiment, ("1 disk", "2 disks", "3 disks"))
    parts.time_axis(axes[-1], outcome.experiment, 2.0)
    return _finished(figure, outcome)


def _draw_bath(outcome: ExperimentOutcome) -> Figure:
    """Temperature and power of both controllers, as in Fig. 4; estimates; model errors."""
    figure = Figure(figsize=(style.WIDTH_in, 8.2), layout="constrained")
    axes = list(figure.subplots(4, 1, sharex=True, height_ratios=(1.7, 1.2, 1.0, 0.9)))
    response, power, estimates, errors = axes
    for variant, record in outcome.records.items():
        label, look = parts.CONTROLLERS[variant]
        minutes = parts.minutes_of(record)
        if variant == "fixed":
            parts.draw_output(response, record, label, look)
        else:
            response.plot(minutes, record.output, label=label, **look)
        power.step(minutes, _heater_W(outcome, record), where="post", label=label, **look)
    parts.mark_warm_up(power, outcome, outcome.records["adaptive"])
    response.set_ylabel(r"$T_b$ above the inflow (K)")
    power.set_ylabel("Heater power (W)")
    style.letter(response, "a", "Bath temperature")
    style.letter(power, "b", "Commanded power")
    style.legend_above(response, 4)
    style.legend_above(power, 4)
    parts.show_whole([response], _outputs(outcome))
    parts.draw_estimates(estimates, outcome, (0.0, 3.4))
    style.letter(estimates, "c", "Estimates of the adaptive controller")
    parts.draw_model_errors(errors, outcome)
    style.letter(errors, "d", "Deviation from the ideal closed loop")
    parts.mark_changes(axes, outcome.experiment)
    parts.name_segments(response, outcome.experiment, ("0.6 gal", "1.5 gal"))
    parts.time_axis(errors, outcome.experiment, 20.0)
    return _finished(figure, outcome)


def _outputs(outcome: ExperimentOutcome) -> list[list[float]]:
    records = outcome.records.values()
    return [one.output for one in records] + [one.measured for one in records]


def _heater_W(outcome: ExperimentOutcome, record: RunRecord) -> list[float]:
    load = outcome.experiment.nominal()
    return [to_input(one, load.input_gain, load.input_exponent) for one in record.boost_reference_V]


def _finished(figure: Figure, outcome: ExperimentOutcome) -> Figure:
    figure.suptitle(parts.describe(outcome), fontsize=9.0)
    figure.align_ylabels(list(figure.axes))
    return figure


_DRAW = {"motor": _draw_motor, "bath": _draw_bath}
