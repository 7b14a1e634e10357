"""One run of one controller in one case, and its figures."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.loads.load import to_input, to_voltage
from adaptdrive.control.signals import Mode
from adaptdrive_sim.campaign.drawn import DrawnRun
from adaptdrive_sim.course import Run
from adaptdrive_sim.experiments.case import paper_settings
from adaptdrive_sim.experiments.experiment import BATH, MOTOR
from tools.benchmarks.rivals.cases import Case
from tools.benchmarks.rivals.controllers import RIVALS, Rival, Task
from tools.benchmarks.rivals.held import run_held
from tools.benchmarks.rivals.trust import share_wrong

Array = NDArray[np.float64]

OURS = {"fixed": Mode.FIXED, "adaptive": Mode.ADAPTIVE}
PAPER = "paper's design"
CONTROLLERS = (*OURS, *RIVALS, PAPER)
LIMITED = ("E", "F")
"""Cases in which somebody who knows the waveform does something else."""


@dataclass(frozen=True, slots=True)
class Figures:
    """What a run has shown in the part that is judged.

    Attributes:
        rms: Deviation from the response asked for, rms, in percent.
        peak: The largest one, in percent.
        overshoot: Furthest beyond the set-points, in percent.
        iae_s: Integral of the error's size over the step, in s.
        variation: Total variation of V_c, in V.
        in_force: Share of the time with adaptive gains, of the whole run from 60 s on.
        wrong: Share of the trusted estimates whose response is off by over 5 % of the step.
    """

    rms: float
    peak: float
    overshoot: float
    iae_s: float
    variation: float
    in_force: float
    wrong: float


def takes_part(controller: str, case: str) -> bool:
    """Return whether a controller is run in the case of that name."""
    if controller == "MPC, preview":
        return case in LIMITED
    return controller != PAPER or not case.startswith("battery")


def task_of(stand: DrawnRun) -> Task:
    """What the rivals know of a run."""
    own, course = stand.own, stand.course(Mode.FIXED)
    rates, stage, load = own.settings.rates, own.settings.stage, own.load
    tick_s = own.period_s / rates.ticks_per_period
    limits_V = stage.boost_reference_min_V, stage.boost_reference_max_V
    rounding = stand.site().wire.output_quantum / math.sqrt(12.0)
    spread = float(np.std(course.disturbances[1:4000])) / math.sqrt(rates.samples)
    low, high, rest = (
        to_input(one, load.input_gain, load.input_exponent)
        for one in (*limits_V, stand.world().boost_voltage_for(float(course.references[0])))
    )
    return Task(
        nominal=load,
        lags_s=getattr(stand, "lags_s", tuple(abs(1.0 / np.roots(load.denominator)))),
        truth=stand.true_load,
        pole=own.pole,
        period_s=own.period_s,
        delay_s=(rates.latency_ticks + rates.lag_ticks - 0.5) * tick_s,
        window_s=rates.samples * tick_s,
        low=low,
        high=high,
        output=float(course.references[0]),
        rest=rest,
        noise=math.hypot(spread, rounding),
        references=course.references,
    )


def run_of(stand: DrawnRun, controller: str) -> Run:
    """Run a controller; one that ends early leaves NaNs."""
    if controller == PAPER:
        experiment = BATH if stand.own.load.input_exponent > 1 else MOTOR
        stand.own = replace(stand.own, settings=paper_settings(experiment))
        return stand.run(Mode.ADAPTIVE)
    if controller in OURS:
        return stand.run(OURS[controller])
    task, load = task_of(stand), stand.own.load
    rival: Rival = RIVALS[controller](task)

    def decide(k: int, output: float, _applied_V: float) -> float:
        return to_voltage(rival.decide(k, output), load.input_gain, load.input_exponent)

    course = stand.course(Mode.FIXED)
    return run_held(stand.site(), course, decide)


def figures(case: Case, seed: int, controller: str) -> Figures:
    """Run a controller once, and judge it."""
    stand = case.stand(seed)
    run, references = run_of(stand, controller), stand.plan.references
    judged = (stand.times_s >= case.begin_s) & (stand.times_s < case.end_s)
    output = run["output"] + stand.plan.offset
    errors = 100.0 * (output - stand.ideal)[judged] / case.unit
    beyond = np.maximum(output - references.max(), references.min() - output)[judged]
    adaptive = controller == "adaptive"
    in_force = run["adaptive"][stand.times_s >= 60.0] if adaptive else np.zeros(1)
    return Figures(
        rms=float(np.sqrt(np.mean(errors**2))),
        peak=float(np.max(np.abs(errors))),
        overshoot=100.0 * max(0.0, float(np.max(beyond))) / case.unit,
        iae_s=float(np.sum(np.abs(output - references)[judged])) * stand.own.period_s / case.unit,
        variation=float(np.nansum(np.abs(np.diff(run["boost_reference_V"][judged])))),
        in_force=float(np.mean(in_force > 0.0)),
        wrong=share_wrong(stand, task_of(stand), run) if adaptive else 0.0,
    )
