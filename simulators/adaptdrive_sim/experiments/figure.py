"""The figure of an experiment, laid out like the paper's."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from adaptdrive.analysis import style
from adaptdrive.control.load import to_input
from adaptdrive_sim.experiments.experiment import Experiment
from adaptdrive_sim.experiments.outcome import ExperimentOutcome
from adaptdrive_sim.experiments.runner import RunRecord

Array = NDArray[np.float64]

SYMBOLS = {
    "gain": r"$\hat{g}_m$",
    "tau_sum_s": r"$\hat{\tau}_m+\hat{\tau}_f$",
    "tau_product_s2": r"$\hat{\tau}_m\hat{\tau}_f$",
    "resistance_K_per_W": r"$\hat{R}_{cw}$",
    "tau_s": r"$\hat{R}_{cw}\hat{C}_{bck}$",
}


def draw_experiment(outcome: ExperimentOutcome, path: Path) -> None:
    """Draw the figure of an experiment as a PNG."""
    with style.journal():
        figure = _DRAW[outcome.experiment.name](outcome)
        save(figure, path)


def save(figure: Figure, path: Path) -> None:
    """Write a figure as a PNG, the same bytes each time."""
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=style.DPI, metadata={"Software": None})


def _draw_motor(outcome: ExperimentOutcome) -> Figure:
    """Speed and voltage of the fixed and of the adaptive controller, as in Fig. 9, and more."""
    figure = Figure(figsize=(style.WIDTH_in, 8.8), layout="constrained")
    axes = figure.subplots(6, 1, sharex=True, height_ratios=(1.3, 0.9, 1.3, 0.9, 1.2, 0.9))
    fixed, adaptive = outcome.records["fixed"], outcome.records["adaptive"]
    _speed(axes[0], fixed, "fixed controller", style.FIXED)
    style.letter(axes[0], "a", "Speed, fixed controller")
    _voltage(axes[1], fixed, style.FIXED)
    style.letter(axes[1], "b", "Drive voltage, fixed controller")
    _speed(axes[2], adaptive, "adaptive controller", style.ADAPTIVE)
    style.letter(axes[2], "c", "Speed, adaptive controller")
    _voltage(axes[3], adaptive, style.ADAPTIVE)
    style.letter(axes[3], "d", "Drive voltage, adaptive controller")
    _estimates(axes[4], outcome, (0.0, 3.6))
    style.letter(axes[4], "e", "Estimates")
    _model_errors(axes[5], outcome)
    style.letter(axes[5], "f", "Deviation from the ideal closed loop")
    for one in (axes[0], axes[2]):
        one.set_ylim(2.94, 3.29)
        one.set_ylabel("Tachometer (V)")
    for one in (axes[1], axes[3]):
        one.set_ylim(190.0, 410.0)
        one.set_yticks((200, 300, 400))
        one.set_ylabel(r"$V_c$ (V)")
    _mark_changes(axes, outcome.experiment)
    _name_segments(axes[0], outcome.experiment, ("1 disk", "2 disks", "3 disks"))
    _time_axis(axes[-1], outcome.experiment, 2.0)
    figure.align_ylabels(list(axes))
    return figure


def _draw_bath(outcome: ExperimentOutcome) -> Figure:
    """Response and power of both controllers, as in Fig. 4, and the estimates."""
    figure = Figure(figsize=(style.WIDTH_in, 6.2), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True, height_ratios=(1.5, 1.2, 1.1))
    response, power, estimates = axes
    minutes = _minutes(outcome.records["fixed"])
    reference = outcome.records["fixed"].reference
    response.step(minutes, reference, where="post", label="reference", **style.REFERENCE)
    load = outcome.experiment.nominal()
    both = {"fixed": style.FIXED, "adaptive": style.ADAPTIVE}
    for variant, record in outcome.records.items():
        look = both[variant]
        heater_W = [
            to_input(voltage_V, load.input_gain, load.input_exponent)
            for voltage_V in record.boost_reference_V
        ]
        response.plot(minutes, record.output, label=variant, **look)
        power.step(minutes, heater_W, where="post", label=variant, **look)
    response.set_ylabel("Above the inflow (K)")
    response.set_ylim(9.4, 14.0)
    power.set_ylabel("Heater power (W)")
    style.letter(response, "a", "Bath temperature")
    style.letter(power, "b", "Commanded power")
    style.legend_above(response, 3)
    style.legend_above(power, 2)
    _estimates(estimates, outcome, (0.0, 3.4))
    style.letter(estimates, "c", "Estimates of the adaptive controller")
    _mark_changes(axes, outcome.experiment)
    _name_segments(response, outcome.experiment, ("0.6 gal", "1.5 gal"))
    _time_axis(estimates, outcome.experiment, 20.0)
    figure.align_ylabels(list(axes))
    return figure


def _speed(axes: Axes, record: RunRecord, label: str, look: style.Look) -> None:
    minutes = _minutes(record)
    axes.step(minutes, record.reference, where="post", label="reference", **style.REFERENCE)
    axes.plot(minutes, record.output, label=label, **look)
    style.legend_above(axes, 2)


def _voltage(axes: Axes, record: RunRecord, look: style.Look) -> None:
    axes.step(_minutes(record), record.boost_reference_V, where="post", **look)


def _estimates(axes: Axes, outcome: ExperimentOutcome, limits: tuple[float, float]) -> None:
    """Estimates and truth, over the nominal values."""
    experiment, record = outcome.experiment, outcome.records["adaptive"]
    load = experiment.nominal()
    nominal = np.array(load.physical(list(load.numerator), list(load.denominator)))
    truth = np.array([experiment.truth_at(time_s) for time_s in record.time_s]) / nominal
    minutes = _minutes(record)
    drawstyle = "default" if experiment.changes[0].over_s else "steps-post"
    for i, name in enumerate(load.names):
        label = "truth" if i == len(load.names) - 1 else None
        estimated = np.array(record.estimates[name]) / nominal[i]
        axes.plot(minutes, estimated, color=style.PARAMETERS[i], linewidth=0.9, label=SYMBOLS[name])
        axes.plot(minutes, truth[:, i], drawstyle=drawstyle, label=label, **style.TRUTH)
    axes.set_ylim(*limits)
    axes.set_ylabel("Over nominal")
    style.legend_above(axes, len(load.names) + 1)


def _model_errors(axes: Axes, outcome: ExperimentOutcome) -> None:
    """One bar-like step for each reference cycle and controller."""
    looks = {"fixed": style.FIXED, "adaptive": style.ADAPTIVE, "direct_rls": style.DIRECT}
    labels = {"fixed": "fixed", "adaptive": "adaptive (LM-RLS)", "direct_rls": "direct RLS"}
    for variant, cycles in outcome.cycles.items():
        edges = [one.start_s / 60.0 for one in cycles] + [outcome.experiment.duration_s / 60.0]
        percents = [100.0 * one.model_error_rms for one in cycles]
        axes.step(
            edges, [*percents, percents[-1]], where="post", label=labels[variant], **looks[variant]
        )
    axes.set_yscale("log")
    axes.set_ylim(0.5, 30.0)
    axes.set_yticks((1.0, 3.0, 10.0), ("1", "3", "10"))
    axes.set_ylabel("rms (% of step)")
    style.legend_above(axes, 3)


def _mark_changes(axes: Iterable[Axes], experiment: Experiment) -> None:
    """Show in every panel when the load changes."""
    for one in axes:
        for change in experiment.changes:
            start, end = change.time_s / 60.0, (change.time_s + change.over_s) / 60.0
            if change.over_s:
                one.axvspan(start, end, color="0.90", linewidth=0.0, zorder=0)
            else:
                one.axvline(start, color="0.35", linewidth=0.6, linestyle=":", zorder=0)


def _name_segments(axes: Axes, experiment: Experiment, names: tuple[str, ...]) -> None:
    ends = [change.time_s for change in experiment.changes] + [experiment.duration_s]
    starts = [0.0, *ends[:-1]]
    for start, end, name in zip(starts, ends, names, strict=True):
        axes.annotate(
            name,
            (0.5 * (start + end) / 60.0, 0.99),
            xycoords=("data", "axes fraction"),
            ha="center",
            va="top",
            fontsize=8.0,
        )


def _time_axis(axes: Axes, experiment: Experiment, step_min: float) -> None:
    last = experiment.duration_s / 60.0
    axes.set_xlim(0.0, last)
    axes.set_xticks(np.arange(0.0, last + 0.5 * step_min, step_min))
    axes.set_xlabel("Time (min)")


def _minutes(record: RunRecord) -> Array:
    return np.array(record.time_s) / 60.0


_DRAW = {"motor": _draw_motor, "bath": _draw_bath}
