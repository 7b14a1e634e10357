"""The second figure: speed of the estimator against its noise, over ρ and over τ_λ."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullLocator

from adaptdrive.analysis import style
from adaptdrive_sim.experiments.experiment import Experiment
from adaptdrive_sim.experiments.figure import describe
from adaptdrive_sim.experiments.outcome import ExperimentOutcome
from adaptdrive_sim.experiments.sweep import SweepPoint, settling_time_s

_DOTS = {"markersize": 3.2}
_LOOKS: dict[str, tuple[str, style.Look]] = {
    "lm-rls": ("LM-RLS", {**style.ADAPTIVE, "marker": "o", **_DOTS}),
    "rls": ("direct RLS", {**style.DIRECT, "marker": "s", **_DOTS}),
}
_PAPER: style.Look = {"color": "0.35", "linewidth": 0.6, "linestyle": ":", "zorder": 0}
_NEVER = 0.95
_OPEN = {"o": 5.4, "s": 3.0}
_CROWDED = (0.96, 0.985)
_PLAIN = FuncFormatter(lambda value, _: f"{value:g}")

Grid = Sequence[Sequence[Axes]]


def sweep_figure(outcome: ExperimentOutcome) -> Figure:
    """Return the figure of other values of ρ and τ_λ."""
    figure = Figure(figsize=(style.WIDTH_in, 6.6), layout="constrained")
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


def _column(
    axes: Sequence[Axes], points: list[SweepPoint], position: Callable[[SweepPoint], float]
) -> None:
    for method, (label, look) in _LOOKS.items():
        chosen = [one for one in points if one.setting.method == method]
        if chosen:
            _curves(axes, chosen, position, label, look)


def _curves(
    axes: Sequence[Axes],
    points: list[SweepPoint],
    position: Callable[[SweepPoint], float],
    label: str,
    look: style.Look,
) -> None:
    """Speed and noise of one estimator; open marks where it never follows."""
    speed, noise, transient = axes
    followed = [(position(one), one.cycles) for one in points if one.cycles is not None]
    speed.plot([x for x, _ in followed], [y for _, y in followed], **look)
    noise.plot(
        [position(one) for one in points],
        [100.0 * one.deviation for one in points],
        label=label,
        **look,
    )
    transient.plot([position(one) for one in points], [one.transient for one in points], **look)
    never = [position(one) for one in points if one.cycles is None]
    if never:
        heights = [_NEVER] * len(never)
        (marks,) = speed.plot(never, heights, transform=speed.get_xaxis_transform(), **look)
        marks.set(markerfacecolor="none", linestyle="none", markersize=_OPEN[look["marker"]])
        _annotate(speed, "never", (never[0], _NEVER), shift=-6.0, ha="right", va="center")


def _name(axes: Grid, experiment: Experiment) -> None:
    paper = experiment.paper
    (speed, speed_tau), (noise, noise_tau), (transient, transient_tau) = axes
    style.letter(speed, "a", rf"Convergence over $\rho$, $\tau_\lambda$ = {paper.tau_lambda_s:g} s")
    style.letter(speed_tau, "b", rf"Convergence over $\tau_\lambda$, $\rho$ = {paper.forgetting:g}")
    style.letter(noise, "c", r"Noise over $\rho$")
    style.letter(noise_tau, "d", r"Noise over $\tau_\lambda$")
    speed.set_ylabel("Cycles until within 5 %")
    noise.set_ylabel("Noise in the estimates (%)")
    style.letter(transient, "e", r"Transient over $\rho$, without noise")
    style.letter(transient_tau, "f", r"Transient over $\tau_\lambda$, without noise")
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
    transient.set_xticks(
        [_memory(one) for one in forgettings], [f"{one:g}" for one in forgettings], minor=False
    )
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
