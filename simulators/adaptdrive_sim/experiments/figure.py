"""The figures of the experiments, laid out like the paper's, with more panels."""

import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullLocator

from adaptdrive.analysis import figures
from adaptdrive.control.loads.load import to_input
from adaptdrive_sim.course import Array, Run
from adaptdrive_sim.experiments.case import Variant
from adaptdrive_sim.experiments.experiment import Experiment
from adaptdrive_sim.experiments.outcome import Outcome, SweepPoint, settling_time_s

# The figures of the experiments, laid out like the paper's Fig. 4 and Fig. 9, with more panels.

SYMBOLS = {
    "gain": r"$\hat{g}_m$",
    "tau_sum_s": r"$\hat{\tau}_m+\hat{\tau}_f$",
    "tau_product_s2": r"$\hat{\tau}_m\hat{\tau}_f$",
    "resistance_K_per_W": r"$\hat{R}_{cw}$",
    "tau_s": r"$\hat{R}_{cw}\hat{C}_{bck}$",
}
CONTROLLERS: dict[str, tuple[str, figures.Look]] = {
    "fixed": ("fixed", figures.FIXED),
    "adaptive": ("adaptive", figures.ADAPTIVE),
    "direct_rls": ("adaptive, direct RLS", figures.DIRECT),
}
MEASURED: figures.Look = {"color": "0.80", "linewidth": 0.6, "zorder": 1}
APPLIED: figures.Look = {"color": "0.55", "linewidth": 0.6, "zorder": 1}
WARM_UP: figures.Look = {"color": "#f2e8d5", "linewidth": 0.0, "zorder": 0}
_MARGIN = 0.06


def describe(outcome: Outcome) -> str:
    """Design, noise, seed and the kind of load change, for the head of a figure."""
    case, noise = outcome.case, outcome.case.disturbance
    parts = [f"{case.design} design", f"noise {100.0 * noise.sigma:.3g} % of the step"]
    if noise.spike_share:
        share, size = 100.0 * noise.spike_share, 100.0 * noise.spike_sigma
        parts.append(f"spikes of {size:.3g} % in {share:.3g} % of the samples")
    parts.append(f"seed {case.seed}")
    if case.experiment.dropped:
        parts.append("disks at rest when they land")
    return ", ".join(parts)


def draw_output(axes: Axes, record: Run, label: str, look: figures.Look) -> None:
    """Draw reference, measured and true output."""
    minutes = minutes_of(record)
    axes.step(minutes, record["reference"], where="post", label="reference", **figures.REFERENCE)
    axes.plot(minutes, record["measured"], label="measured", **MEASURED)
    axes.plot(minutes, record["output"], label=label, **look)


def draw_voltage(axes: Axes, record: Run, look: figures.Look) -> None:
    """Draw V_c as commanded, and the mean v_bst that was applied in each slow period."""
    minutes = minutes_of(record)
    applied = [*record["applied_V"][1:], record["applied_V"][-1]]
    axes.step(minutes, applied, where="post", label=r"$v_{bst}$ applied", **APPLIED)
    commanded = record["boost_reference_V"]
    axes.step(minutes, commanded, where="post", label=r"$V_c$ commanded", **look)


def draw_estimates(axes: Axes, outcome: Outcome, limits: tuple[float, float]) -> None:
    """Draw estimates and truth, over the nominal values; transients beyond the limits are cut."""
    experiment, record = outcome.experiment, outcome.records["adaptive"]
    load = experiment.nominal()
    nominal = np.array(load.physical(list(load.numerator), list(load.denominator)))
    truth = np.array([experiment.truth_at(time_s) for time_s in record["time_s"]]) / nominal
    minutes = minutes_of(record)
    drawstyle = "default" if experiment.changes[0].over_s else "steps-post"
    for i, name in enumerate(load.names):
        label = "truth" if i == len(load.names) - 1 else None
        estimated, color = record[name] / nominal[i], figures.PARAMETERS[i]
        axes.plot(minutes, estimated, color=color, linewidth=0.9, label=SYMBOLS[name])
        axes.plot(minutes, truth[:, i], drawstyle=drawstyle, label=label, **figures.TRUTH)
    axes.set_ylim(*limits)
    axes.set_ylabel("Over nominal")
    figures.legend_above(axes, len(load.names) + 1)


def draw_model_errors(axes: Axes, outcome: Outcome) -> None:
    """Draw one step for each reference cycle and controller, on an axis that holds all of them."""
    found = []
    for variant, cycles in outcome.cycles.items():
        label, look = CONTROLLERS[variant]
        edges = [one.start_s / 60.0 for one in cycles] + [outcome.experiment.duration_s / 60.0]
        percents = [100.0 * one.model_error_rms for one in cycles]
        axes.step(edges, [*percents, percents[-1]], where="post", label=label, **look)
        found += percents
    axes.set_yscale("log")
    axes.set_ylim(0.7 * min(found), 1.5 * max(found))
    axes.set_ylabel("rms (% of step)")
    figures.legend_above(axes, len(outcome.cycles))


def show_whole(axes: Sequence[Axes], values: Iterable[Iterable[float]]) -> None:
    """Give axes one range that holds all values, so that they can be compared."""
    everything = np.concatenate([np.asarray(list(one), dtype=float) for one in values])
    low, high = float(everything.min()), float(everything.max())
    margin = _MARGIN * (high - low)
    for one in axes:
        one.set_ylim(low - margin, high + margin)


def mark_warm_up(axes: Axes, outcome: Outcome, record: Run) -> None:
    """Shade the warm-up, and draw a bar while the adaptive gains were in force."""
    warm_up_min = outcome.experiment.paper.warm_up_s / 60.0
    axes.axvspan(0.0, warm_up_min, label="warm-up", **WARM_UP)
    mark_in_force(axes, record)


def mark_in_force(axes: Axes, record: Run) -> None:
    """Draw a bar while the adaptive gains were in force."""
    minutes, in_force = minutes_of(record), record["adaptive"] > 0.0
    look: figures.Look = {
        "transform": axes.get_xaxis_transform(),
        "color": figures.ADAPTIVE["color"],
    }
    look |= {"linewidth": 0.0, "label": "adaptive in force"}
    axes.fill_between(minutes, 0.0, 0.03, where=in_force.tolist(), step="post", **look)


def mark_changes(axes: Iterable[Axes], experiment: Experiment) -> None:
    """Show in every panel when the load changes."""
    for one in axes:
        for change in experiment.changes:
            start, end = change.time_s / 60.0, (change.time_s + change.over_s) / 60.0
            if change.over_s:
                one.axvspan(start, end, color="0.90", linewidth=0.0, zorder=0)
            else:
                one.axvline(start, color="0.35", linewidth=0.6, linestyle=":", zorder=0)


def name_segments(axes: Axes, experiment: Experiment, names: tuple[str, ...]) -> None:
    """Name the load in each segment of the experiment, at the bottom of a panel."""
    ends = experiment.ends_s
    for start, end, name in zip([0.0, *ends[:-1]], ends, names, strict=True):
        _annotate(axes, name, (0.5 * (start + end) / 60.0, 0.03), ha="center", va="bottom")


def time_axis(axes: Axes, experiment: Experiment, step_min: float) -> None:
    """Label the common axis of time."""
    last = experiment.duration_s / 60.0
    axes.set_xlim(0.0, last)
    axes.set_xticks(np.arange(0.0, last + 0.5 * step_min, step_min))
    axes.set_xlabel("Time (min)")


def minutes_of(record: Run) -> Array:
    """Return the times of a record in minutes."""
    return record["time_s"] / 60.0


_TITLES: dict[Variant, str] = {
    "fixed": "fixed controller",
    "adaptive": "adaptive controller",
    "direct_rls": "direct RLS",
}


def experiment_figure(outcome: Outcome) -> Figure:
    """Return the figure of an experiment."""
    return _DRAW[outcome.experiment.name](outcome)


def draw(figure_of: Callable[[Outcome], Figure], outcome: Outcome, path: Path) -> None:
    """Draw a figure of an experiment as a PNG, the same bytes each time."""
    with figures.journal():
        figure = figure_of(outcome)
        FigureCanvasAgg(figure)
        figure.savefig(path, dpi=figures.DPI, metadata={"Software": None})


def _draw_motor(outcome: Outcome) -> Figure:
    """Tachometer and drive voltage of each controller, as in Fig. 9; estimates; model errors."""
    figure = Figure(figsize=(figures.WIDTH_in, 11.4), layout="constrained")
    heights = (1.5, 0.8, 1.5, 0.8, 1.5, 0.8, 1.1, 0.9)
    axes = list(figure.subplots(8, 1, sharex=True, height_ratios=heights))
    speeds, voltages = axes[0:6:2], axes[1:6:2]
    for i, (variant, title) in enumerate(_TITLES.items()):
        record, look = outcome.records[variant], CONTROLLERS[variant][1]
        draw_output(speeds[i], record, "without noise", look)
        draw_voltage(voltages[i], record, look)
        figures.letter(speeds[i], "ace"[i], f"Speed, {title}")
        figures.letter(voltages[i], "bdf"[i], f"Drive voltage, {title}")
        if variant != "fixed":
            mark_warm_up(voltages[i], outcome, record)
        figures.legend_above(speeds[i], 3)
        figures.legend_above(voltages[i], 4)
        speeds[i].set_ylabel("Tachometer (V)")
        voltages[i].set_ylabel("Voltage (V)")
    show_whole(speeds, _outputs(outcome))
    show_whole(voltages, [one["applied_V"] for one in outcome.records.values()] + [[200, 400]])
    figures.letter(axes[6], "g", "Estimates (transients beyond the axis are cut)")
    figures.letter(axes[7], "h", "Deviation from the ideal closed loop")
    name_segments(speeds[0], outcome.experiment, ("1 disk", "2 disks", "3 disks"))
    return _finished(figure, outcome, (-0.5, 4.5), 2.0)


def _draw_bath(outcome: Outcome) -> Figure:
    """Temperature and power of both controllers, as in Fig. 4; estimates; model errors."""
    figure = Figure(figsize=(figures.WIDTH_in, 8.2), layout="constrained")
    rows = figure.subplots(4, 1, sharex=True, height_ratios=(1.7, 1.2, 1.0, 0.9))
    response, power, estimates, errors = rows
    load = outcome.experiment.nominal()
    powers = load.input_gain, load.input_exponent
    for variant, record in outcome.records.items():
        label, look = CONTROLLERS[variant]
        minutes = minutes_of(record)
        if variant == "fixed":
            draw_output(response, record, label, look)
        else:
            response.plot(minutes, record["output"], label=label, **look)
        heater_W = [to_input(one, *powers) for one in record["boost_reference_V"]]
        power.step(minutes, heater_W, where="post", label=label, **look)
    mark_warm_up(power, outcome, outcome.records["adaptive"])
    response.set_ylabel(r"$T_b$ above the inflow (K)")
    power.set_ylabel("Heater power (W)")
    figures.letter(response, "a", "Bath temperature")
    figures.letter(power, "b", "Commanded power")
    figures.legend_above(response, 4)
    figures.legend_above(power, 4)
    show_whole([response], _outputs(outcome))
    figures.letter(estimates, "c", "Estimates of the adaptive controller")
    figures.letter(errors, "d", "Deviation from the ideal closed loop")
    name_segments(response, outcome.experiment, ("0.6 gal", "1.5 gal"))
    return _finished(figure, outcome, (0.0, 3.4), 20.0)


def _outputs(outcome: Outcome) -> list[Array]:
    return [one[name] for one in outcome.records.values() for name in ("output", "measured")]


def _finished(
    figure: Figure, outcome: Outcome, limits: tuple[float, float], step_min: float
) -> Figure:
    """Draw estimates and model errors in the last panels, and what all panels share."""
    *_, estimates, errors = axes = list(figure.axes)
    draw_estimates(estimates, outcome, limits)
    draw_model_errors(errors, outcome)
    mark_changes(axes, outcome.experiment)
    time_axis(errors, outcome.experiment, step_min)
    figure.suptitle(describe(outcome), fontsize=9.0)
    figure.align_ylabels(axes)
    return figure


_DRAW = {"motor": _draw_motor, "bath": _draw_bath}


# The second figure: speed of the estimator against its noise, over ρ and over τ_λ.

_DOTS = {"markersize": 3.2}
_LOOKS: dict[str, tuple[str, figures.Look]] = {
    "lm-rls": ("LM-RLS", {**figures.ADAPTIVE, "marker": "o", **_DOTS}),
    "rls": ("direct RLS", {**figures.DIRECT, "marker": "s", **_DOTS}),
}
_PAPER: figures.Look = {"color": "0.35", "linewidth": 0.6, "linestyle": ":", "zorder": 0}
_NEVER = 0.95
_OPEN = {"o": 5.4, "s": 3.0}
_CROWDED = (0.96, 0.985)
_PLAIN = FuncFormatter(lambda value, _: f"{value:g}")

Grid = Sequence[Sequence[Axes]]
Position = Callable[[SweepPoint], float]


def sweep_figure(outcome: Outcome) -> Figure:
    """Return the figure of other values of ρ and τ_λ."""
    figure = Figure(figsize=(figures.WIDTH_in, 6.6), layout="constrained")
    axes = figure.subplots(3, 2, sharex="col", sharey="row")
    _column(axes[:, 0], outcome.over_forgetting, lambda one: _memory(one.setting.forgetting))
    _column(axes[:, 1], outcome.over_tau_lambda, lambda one: one.setting.tau_lambda_s)
    _name(axes, outcome.experiment)
    _mark(axes, outcome.experiment)
    figure.suptitle(describe(outcome), fontsize=9.0)
    figure.align_ylabels(list(axes[:, 0]))
    return figure


def _memory(forgetting: float) -> float:
    """Samples that a forgetting factor remembers."""
    return 1.0 / (1.0 - forgetting)


def _column(axes: Sequence[Axes], points: list[SweepPoint], position: Position) -> None:
    for method, (label, look) in _LOOKS.items():
        chosen = [one for one in points if one.setting.method == method]
        if chosen:
            _curves(axes, chosen, position, label, look)


def _curves(
    axes: Sequence[Axes],
    points: list[SweepPoint],
    position: Position,
    label: str,
    look: figures.Look,
) -> None:
    """Speed and noise of one estimator; open marks where it never follows."""
    speed, noise, transient = axes
    followed = [(position(one), one.cycles) for one in points if one.cycles is not None]
    speed.plot([x for x, _ in followed], [y for _, y in followed], **look)
    places = [position(one) for one in points]
    noise.plot(places, [100.0 * one.deviation for one in points], label=label, **look)
    transient.plot(places, [one.transient for one in points], **look)
    never = [position(one) for one in points if one.cycles is None]
    if never:
        heights = [_NEVER] * len(never)
        (marks,) = speed.plot(never, heights, transform=speed.get_xaxis_transform(), **look)
        marks.set(markerfacecolor="none", linestyle="none", markersize=_OPEN[look["marker"]])
        _annotate(speed, "never", (never[0], _NEVER), shift=-6.0, ha="right", va="center")


def _name(axes: Grid, experiment: Experiment) -> None:
    paper = experiment.paper
    (speed, speed_tau), (noise, noise_tau), (transient, transient_tau) = axes
    over = "Convergence over"
    figures.letter(speed, "a", rf"{over} $\rho$, $\tau_\lambda$ = {paper.tau_lambda_s:g} s")
    figures.letter(speed_tau, "b", rf"{over} $\tau_\lambda$, $\rho$ = {paper.forgetting:g}")
    figures.letter(noise, "c", r"Noise over $\rho$")
    figures.letter(noise_tau, "d", r"Noise over $\tau_\lambda$")
    speed.set_ylabel("Cycles until within 5 %")
    noise.set_ylabel("Noise in the estimates (%)")
    figures.letter(transient, "e", r"Transient over $\rho$, without noise")
    figures.letter(transient_tau, "f", r"Transient over $\tau_\lambda$, without noise")
    transient.set_ylabel("Largest error (× truth)")
    transient.set_xlabel(r"Forgetting factor $\rho$, spaced by its memory $1/(1-\rho)$")
    transient_tau.set_xlabel(r"$\tau_\lambda$ (s)")
    for one in (noise, noise_tau, transient, transient_tau):
        one.set_xscale("log")
        one.set_yscale("log")
        one.yaxis.set_major_formatter(_PLAIN)
        one.xaxis.set_major_formatter(_PLAIN)
    noise.legend(loc="best")
    speed.set_ylim(bottom=0.0, top=1.2 * speed.get_ylim()[1])
    forgettings = [one for one in experiment.sweep.forgetting if one not in _CROWDED]
    places, names = [_memory(one) for one in forgettings], [f"{one:g}" for one in forgettings]
    transient.set_xticks(places, names, minor=False)
    transient.xaxis.set_minor_locator(NullLocator())


def _mark(axes: Grid, experiment: Experiment) -> None:
    """The paper's choice, and what is slower than the load itself."""
    paper, load = experiment.paper, experiment.nominal()
    settled_s = settling_time_s(load, 0.1 * experiment.period_s)
    for row in axes:
        row[0].axvline(_memory(paper.forgetting), **_PAPER)
        row[1].axvline(paper.tau_lambda_s, **_PAPER)
        last = row[1].get_xlim()[1]
        row[1].axvspan(settled_s, last, color="0.93", linewidth=0.0, zorder=0)
        row[1].set_xlim(right=last)
    place = _memory(paper.forgetting), 0.03
    _annotate(axes[0][0], "as used", place, -4.0, rotation=90.0, ha="right", va="bottom")
    place, text = (math.sqrt(settled_s * last), 0.03), "slower than the\nload settles"
    _annotate(axes[0][1], text, place, ha="center", va="bottom")


def _annotate(
    axes: Axes,
    text: str,
    place: tuple[float, float],
    shift: float = 0.0,
    **look: Any,  # noqa: ANN401 - of matplotlib
) -> None:
    """Write at an abscissa and a share of the height, shifted by so many points."""
    look |= {"xycoords": axes.get_xaxis_transform(), "textcoords": "offset points"}
    axes.annotate(text, place, (shift, 0.0), fontsize=8.0, **look)
