"""Virtual time on compiled code: the same case as in `runner`, some thirty times as fast.

Compiling takes a minute or two for each kind of load and design, and is kept: this is for many
runs of one kind.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.controller import Controller
from adaptdrive_sim.compiled import bench
from adaptdrive_sim.compiled.course import Course, Interlocks
from adaptdrive_sim.compiled.deployed import start_at_rest
from adaptdrive_sim.compiled.run import run_compiled
from adaptdrive_sim.compiled.wire import perfect_wire
from adaptdrive_sim.experiments.case import Case
from adaptdrive_sim.experiments.experiment import Experiment
from adaptdrive_sim.experiments.runner import Record
from adaptdrive_sim.noise import NoiseParameters, samples
from adaptdrive_sim.world import World

Array = NDArray[np.float64]

_NO_INTERLOCKS = Interlocks(math.inf, math.inf)


def run_case_compiled(case: Case) -> Record:
    """Run one case from start to end on compiled code.

    Returns:
        A record without reasons, gains, deviations and excitation.
    """
    experiment = case.experiment
    course, low = _course(case), experiment.reference.low
    controller = Controller(case.settings, experiment.nominal())
    world = World(experiment.plant())
    world.settle(world.boost_voltage_for(low))
    start_at_rest(controller, world, course, low)
    trace, cause = run_compiled(controller, world, perfect_wire(low), course, _NO_INTERLOCKS)
    if cause:
        raise RuntimeError(f"the run of seed {case.seed} ended by itself, cause {cause}")
    return _record(experiment, course, trace)


def _course(case: Case) -> Course:
    experiment = case.experiment
    times_s = _times_s(experiment)
    ticks = len(times_s) * case.settings.rates.ticks_per_period
    noise = case.disturbance.scaled(experiment.step)
    return Course(
        references=np.array([experiment.reference.value(time_s) for time_s in times_s]),
        sizes=np.array([_size_wanted(experiment, time_s) for time_s in times_s]),
        over_s=max(change.over_s for change in experiment.changes),
        disturbances=_disturbances(noise, case.seed, ticks + 1),
        mode=case.mode,
        pole=experiment.pole,
    )


def _times_s(experiment: Experiment) -> list[float]:
    periods = round(experiment.duration_s / experiment.period_s)
    return [k * experiment.period_s for k in range(periods)]


def _size_wanted(experiment: Experiment, time_s: float) -> float:
    """Where the load is, or is on its way to."""
    sizes = [change.size for change in experiment.changes if change.time_s <= time_s]
    return sizes[-1] if sizes else 1.0


def _disturbances(noise: NoiseParameters, seed: int, count: int) -> Array:
    """What the simulated plant itself would draw."""
    if noise.silent:
        return np.zeros(count)
    drawn = samples(noise, np.random.default_rng(seed))
    return np.fromiter(itertools.islice(drawn, count), np.float64, count)


def _record(experiment: Experiment, course: Course, trace: Array) -> Record:
    times_s = _times_s(experiment)
    names = experiment.nominal().names
    return Record(
        time_s=times_s,
        reference=course.references.tolist(),
        size=[experiment.size_at(time_s) for time_s in times_s],
        output=trace[:, bench.OUTPUT].tolist(),
        measured=trace[:, bench.MEASURED].tolist(),
        boost_reference_V=trace[:, bench.REFERENCE_V].tolist(),
        applied_V=trace[:, bench.APPLIED_V].tolist(),
        adaptive=(trace[:, bench.ADAPTIVE] > 0.0).tolist(),
        accepted=(trace[:, bench.ACCEPTED] > 0.0).tolist(),
        estimates={name: trace[:, bench.VALUES + i].tolist() for i, name in enumerate(names)},
        innovation=trace[:, bench.INNOVATION].tolist(),
    )
