"""The picture of the comparison: one run with three disks, and the error of every case."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adaptdrive.analysis import figures
from adaptdrive.analysis.figures import as_png
from tools.benchmarks.rivals.cases import CASES, MOTORS
from tools.benchmarks.rivals.runs import run_of

LOOKS: dict[str, tuple[str, str, str, Any]] = {
    "adaptive": ("adaptdrive, adaptive", "#1d4e79", "o", "-"),
    "fixed": ("adaptdrive, fixed", "#b4472e", "s", (0, (5, 1.5))),
    "SIMC PI": ("PI, SIMC", "#c79a2b", "^", (0, (1, 1))),
    "relay PID": ("PID, relay", "#7a5195", "v", (0, (3, 1, 1, 1))),
    "RLS": ("RLS and pole placement", "#4c8b57", "D", (0, (2, 1))),
    "MPC": ("MPC, load known", "0.35", "x", (0, (6, 2, 1, 2))),
}
SHOWN = ("adaptive", "fixed", "SIMC PI", "relay PID")
FROM_s, TO_s = 1195.0, 1320.0
LEAST = 0.01
"""Smallest error that is drawn, in percent."""


def draw(result: dict[str, Any]) -> bytes:
    """Draw it as a PNG."""
    with figures.journal():
        figure = Figure(figsize=(figures.WIDTH_in, 3.4), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
        _responses(left)
        _errors(right, result)
        handles, labels = right.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3)
        return as_png(figure)


def _look(name: str) -> figures.Look:
    """Colour and form; the one in question is small, filled and on top."""
    _, color, marker, _ = LOOKS[name]
    look: figures.Look = {"color": color, "marker": marker, "linestyle": "none"}
    if name == "adaptive":
        return look | {"markersize": 3.5, "zorder": 4}
    return look | {"markersize": 5.5, "markerfacecolor": "none", "zorder": 3}


def _responses(axes: Axes) -> None:
    stand = CASES["B"].stand(0)
    shown = (stand.times_s >= FROM_s) & (stand.times_s < TO_s)
    time_s = stand.times_s[shown] - FROM_s
    axes.step(time_s, stand.plan.references[shown], where="post", **figures.REFERENCE)
    for place, name in enumerate(SHOWN):
        output = run_of(CASES["B"].stand(0), name)["output"][shown]
        look = _look(name) | {"linestyle": LOOKS[name][3], "linewidth": 1.2}
        axes.plot(time_s, output, markevery=(3 * place, 12), **look)
    axes.set_xlim(0.0, TO_s - FROM_s)
    axes.set_xlabel("time (s)")
    axes.set_ylabel("speed (tachometer volts)")
    figures.letter(axes, "a", "three disks in place of one")


def _errors(axes: Axes, result: dict[str, Any]) -> None:
    names = [case.name for case in MOTORS]
    for key in LOOKS:
        values = [max(LEAST, result["cases"][name][key]["rms"][0]) for name in names]
        axes.plot(values, names, label=LOOKS[key][0], clip_on=False, **_look(key))
    axes.set_xscale("log")
    axes.set_xlim(LEAST, 100.0)
    axes.set_xticks([0.01, 0.1, 1.0, 10.0, 100.0], ["0.01", "0.1", "1", "10", "100"])
    axes.invert_yaxis()
    axes.grid(axis="y", color="0.9", linewidth=0.6)
    axes.set_xlabel("rms deviation (% of the step), median of 20 seeds")
    axes.tick_params(axis="y", length=0.0)
    figures.letter(axes, "b", "the cases of a motor")
