"""Whether an estimate that was trusted is right for the loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from adaptdrive.control.design.pole_placement import Plant, desired_polynomial
from adaptdrive.control.loads.load import Load
from adaptdrive_sim.campaign.drawn import DrawnRun
from adaptdrive_sim.course import Run
from tools.benchmarks.rivals.controllers import Task

Array = NDArray[np.float64]

LIMIT = 0.05
"""Largest error of the step response, as a share of the step."""

GRACE_s = 20.0
"""Time after a change in which no controller can know of it."""

EACH = 5
"""Every so many slow periods are looked at."""


def step_response(task: Task, designed_for: Load, on: Load) -> Array:
    """Response to a step of the loop designed for one load, on another one."""
    a, b = task.model(on)
    guessed_a, guessed_b = map(list, task.model(designed_for))
    desired = desired_polynomial(task.pole, 2 * designed_for.order)
    gains = Plant(guessed_a, guessed_b).gains(desired)
    loop = Plant(list(a), list(b)).closed(gains)
    found: Array = lfilter(sum(gains[len(b) - 1 :]) * b, loop, np.ones(60))
    return found


def share_wrong(stand: DrawnRun, task: Task, run: Run) -> float:
    """Share of the trusted estimates whose response is off from its design by over the limit."""
    load, wrong, seen = stand.own.load, 0, 0
    if load.numerator[0] != 0.0:
        return 0.0  # its set-points are filtered
    trusted = (run["adaptive"] > 0.0) & (run["accepted"] > 0.0)
    for time_s in stand.change_times_s:
        trusted &= (stand.times_s < time_s) | (stand.times_s > time_s + GRACE_s)
    for k in np.flatnonzero(trusted)[::EACH].tolist():
        numerator, denominator = load.realise([float(run[name][k]) for name in load.names])
        guess = replace(load, numerator=tuple(numerator), denominator=tuple(denominator))
        truth = stand.true_load(k)
        errors = step_response(task, guess, truth) - step_response(task, guess, guess)
        seen, wrong = seen + 1, wrong + (not np.max(np.abs(errors)) <= LIMIT)
    return wrong / max(1, seen)
