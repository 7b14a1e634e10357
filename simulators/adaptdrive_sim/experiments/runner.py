"""An experiment in virtual time, as fast as it goes.

A run depends on its case alone, so it is the same each time.
"""

from __future__ import annotations

import itertools
from array import array
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.controller import Controller
from adaptdrive.control.signals import Mode
from adaptdrive_sim.course import Course, Run, run_course, start_at_rest
from adaptdrive_sim.experiments.case import Case
from adaptdrive_sim.experiments.experiment import Experiment
from adaptdrive_sim.noise import NoiseParameters, samples
from adaptdrive_sim.world import World

Array = NDArray[np.float64]


@dataclass(slots=True)
class RunRecord:
    """Record of a run: one entry for each slow period, taken at its first tick.

    Attributes:
        time_s: Time since the start.
        reference: Reference.
        size: Multiple of the load's nominal inertia or volume.
        output: Output without noise.
        measured: Output as the slow half saw it.
        boost_reference_V: V_c that was decided.
        applied_V: Mean boost voltage over the period before.
        adaptive: Whether the adaptive gains were in force.
        accepted: Whether the estimate reached the adaptive gains.
        reason: Why the controller in force was in force.
        estimates: Estimated parameters, by name.
        deviations: Their standard deviations, by name.
        gains: Gains in force.
        innovation: Prediction error of the estimator.
        excitation: What the sample could teach.
        fast_output: Output without noise at every tick, where asked for.
        fast_voltage_V: Boost voltage at every tick, where asked for.
    """

    time_s: list[float] = field(default_factory=list)
    reference: list[float] = field(default_factory=list)
    size: list[float] = field(default_factory=list)
    output: list[float] = field(default_factory=list)
    measured: list[float] = field(default_factory=list)
    boost_reference_V: list[float] = field(default_factory=list)
    applied_V: list[float] = field(default_factory=list)
    adaptive: list[bool] = field(default_factory=list)
    accepted: list[bool] = field(default_factory=list)
    reason: list[str] = field(default_factory=list)
    estimates: dict[str, list[float]] = field(default_factory=dict)
    deviations: dict[str, list[float]] = field(default_factory=dict)
    gains: list[list[float]] = field(default_factory=list)
    innovation: list[float] = field(default_factory=list)
    excitation: list[float] = field(default_factory=list)
    fast_output: array[float] = field(default_factory=lambda: array("d"))
    fast_voltage_V: array[float] = field(default_factory=lambda: array("d"))


def run_case(case: Case, *, keep_ticks: bool = False) -> RunRecord:
    """Run one case from start to end.

    Args:
        case: What to run.
        keep_ticks: Whether the record is to hold output and boost voltage of every tick.
    """
    course, controller, world = start_case(case)
    run = run_course(controller, world, course, case.settings.rates, keep_ticks=keep_ticks)
    return _record(case.experiment, course, run)


def start_case(case: Case) -> tuple[Course, Controller, World]:
    """Everything at rest on the lower value of the reference."""
    experiment = case.experiment
    course, controller = _course(case), Controller(case.settings, experiment.nominal())
    world = World(experiment.plant())
    start_at_rest(controller, world, course, experiment.reference.low)
    return course, controller, world


def _course(case: Case) -> Course:
    experiment = case.experiment
    times_s = _times_s(experiment)
    ticks = len(times_s) * case.settings.rates.ticks_per_period
    noise = case.disturbance.scaled(experiment.step)
    return Course(
        references=np.array([experiment.reference.value(time_s) for time_s in times_s]),
        sizes=np.array([_size_wanted(experiment, time_s) for time_s in times_s]),
        over_s=max((change.over_s for change in experiment.changes), default=0.0),
        disturbances=_disturbances(noise, case.seed, ticks + 1),
        mode=case.mode,
        pole=experiment.pole,
    )


def _times_s(experiment: Experiment) -> list[float]:
    periods = round(experiment.duration_s / experiment.period_s)
    return [k * experiment.period_s for k in range(periods)]


def _size_wanted(experiment: Experiment, time_s: float) -> float:
    """Return the present or next size of the load."""
    sizes = [change.size for change in experiment.changes if change.time_s <= time_s]
    return sizes[-1] if sizes else 1.0


def _disturbances(noise: NoiseParameters, seed: int, count: int) -> Array:
    if noise.silent:
        return np.zeros(count)
    drawn = samples(noise, np.random.default_rng(seed))
    return np.fromiter(itertools.islice(drawn, count), np.float64, count)


def planned(experiment: Experiment, course: Course) -> dict[str, Any]:
    """Return the entries of a record that were known before."""
    times_s = _times_s(experiment)
    return {
        "time_s": times_s,
        "reference": course.references.tolist(),
        "size": [experiment.size_at(time_s) for time_s in times_s],
    }


def _record(experiment: Experiment, course: Course, run: Run) -> RunRecord:
    decisions, names = run.decisions, run.decisions[0].estimates
    return RunRecord(
        **planned(experiment, course),
        output=run.outputs,
        measured=[one.output for one in run.snapshots],
        boost_reference_V=[one.boost_reference_V for one in decisions],
        applied_V=[one.applied_V for one in run.snapshots],
        adaptive=[one.controller is Mode.ADAPTIVE for one in decisions],
        accepted=[one.accepted for one in decisions],
        reason=[one.reason for one in decisions],
        estimates={name: [one.estimates[name].value for one in decisions] for name in names},
        deviations={name: [one.estimates[name].std for one in decisions] for name in names},
        gains=[list(one.gains) for one in decisions],
        innovation=[one.innovation for one in decisions],
        excitation=[one.excitation for one in decisions],
        fast_output=run.fast_output,
        fast_voltage_V=run.fast_voltage_V,
    )
