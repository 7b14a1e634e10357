"""Draw docs/images/motor.png: one motor, two controllers, disks that drop onto the shaft.

Both runs are those of `adaptdrive-sim reproduce motor --keep-speed --design exact --seed 0`.

Run it with `.venv/bin/python docs/images/motor.py`.
"""

# ruff: noqa: INP001 - a script, not part of a package

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adaptdrive.analysis import figures
from adaptdrive_sim.course import Run
from adaptdrive_sim.experiments.case import Case, Variant, run_case
from adaptdrive_sim.experiments.experiment import MOTOR
from adaptdrive_sim.world import NoiseParameters

FIRST_min, LAST_min = 8.0, 20.0


def run(variant: Variant) -> Run:
    """The standard experiment under one controller."""
    return run_case(Case(MOTOR, "exact", NoiseParameters(MOTOR.noise), 0, variant))


def draw_speed(axes: Axes, record: Run, look: figures.Look, title: str) -> None:
    """Speed and reference."""
    minutes = record["time_s"] / 60.0
    axes.step(minutes, record["reference"], where="post", **figures.REFERENCE)
    axes.plot(minutes, record["output"], **(look | {"linewidth": 1.3}))
    axes.set_title(title, color=look["color"])
    axes.set_ylabel("speed (V)")
    axes.set_ylim(2.93, 3.28)
    axes.set_yticks((3.0, 3.1, 3.2))


def draw_inertia(axes: Axes, record: Run) -> None:
    """What the adaptive controller has learnt: the mechanical time constant, in disks."""
    nominal_s = MOTOR.nominal().physical(
        list(MOTOR.nominal().numerator), list(MOTOR.nominal().denominator)
    )[2]
    minutes = record["time_s"] / 60.0
    learnt = record["tau_product_s2"] / nominal_s
    axes.step(minutes, record["size"], where="post", **figures.TRUTH)
    axes.plot(minutes, learnt, **(figures.ADAPTIVE | {"linewidth": 1.3}))
    axes.set_title("Inertia as the adaptive controller has learnt it, and the truth (dashed)")
    axes.set_ylabel("disks")
    axes.set_ylim(0.7, 3.4)
    axes.set_yticks((1, 2, 3))


def draw(fixed: Run, adaptive: Run, path: Path) -> None:
    """The whole picture."""
    with figures.journal():
        figure = Figure(figsize=(figures.WIDTH_in, 4.3), layout="constrained")
        axes = figure.subplots(3, 1, sharex=True, height_ratios=(1.3, 1.3, 0.8))
        draw_speed(axes[0], fixed, figures.FIXED, "Fixed controller, designed for one disk")
        draw_speed(axes[1], adaptive, figures.ADAPTIVE, "Adaptive controller")
        draw_inertia(axes[2], adaptive)
        for one in axes:
            for change in MOTOR.changes:
                one.axvline(change.time_s / 60.0, color="0.4", linewidth=0.7, linestyle=":")
        for minute, text in ((9.0, "1 disk"), (13.0, "2 disks"), (18.0, "3 disks")):
            axes[0].text(minute, 3.265, text, ha="center", va="top", fontsize=9.0)
        axes[2].set_xlim(FIRST_min, LAST_min)
        axes[2].set_xlabel("time (min)")
        figure.align_ylabels(list(axes))
        figure.savefig(path, dpi=figures.DPI, metadata={"Software": None})


if __name__ == "__main__":
    draw(run("fixed"), run("adaptive"), Path(__file__).with_suffix(".png"))
