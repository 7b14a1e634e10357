"""The closed loop as it was designed: the true load, no limits, no delays, no noise.

With the model A y = B u of the true load the design makes

    A_m y = A_m(1)/B(1) · B r

(27) and (15) in the paper's design; in the exact one B has the zero of the held load. All poles of
A_m are where the design wants them, so that a larger load changes B's zero at most.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.discretise import held_model
from adaptdrive.control.load import Load
from adaptdrive.control.pole_placement import desired_polynomial
from adaptdrive.control.vectors import Vector
from adaptdrive_sim.experiments.case import Design
from adaptdrive_sim.experiments.experiment import Experiment


def ideal_output(experiment: Experiment, design: Design) -> NDArray[np.float64]:
    """Output of the ideal loop at every slow instant, from rest on the lower reference."""
    periods = round(experiment.duration_s / experiment.period_s)
    desired = desired_polynomial(experiment.pole, 2 * experiment.nominal().order)
    low = experiment.reference.low
    outputs = [0.0] * (len(desired) - 1)
    references = [0.0] * len(desired)
    found = np.empty(periods)
    for k in range(periods):
        time_s = k * experiment.period_s
        references = [experiment.reference.value(time_s) - low, *references[:-1]]
        weights = _weights(experiment.true_load(experiment.size_at(time_s)), design, experiment)
        output = sum(weights[i] * references[i] for i in range(len(weights)))
        output -= sum(desired[i + 1] * outputs[i] for i in range(len(outputs)))
        outputs = [output, *outputs[:-1]]
        found[k] = low + output
    return found


def _weights(load: Load, design: Design, experiment: Experiment) -> Vector:
    """A_m(1)/B(1) · B."""
    desired = desired_polynomial(experiment.pole, 2 * load.order)
    b = _numerator(load, design, experiment.period_s)
    return [sum(desired) / sum(b) * value for value in b]


@cache
def _numerator(load: Load, design: Design, period_s: float) -> Vector:
    numerator, denominator = list(load.numerator), list(load.denominator)
    if design == "paper":
        return load.paper_model(numerator, denominator, period_s)[1]
    return held_model(numerator, denominator, period_s, 0.0, 0.0)[1]
