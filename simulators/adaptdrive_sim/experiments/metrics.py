"""Metrics of an experiment, always from the output without noise at the slow instants."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from adaptdrive_sim.experiments.case import Design
from adaptdrive_sim.experiments.experiment import Experiment, LoadChange
from adaptdrive_sim.experiments.ideal import ideal_output
from adaptdrive_sim.experiments.runner import RunRecord

Array = NDArray[np.float64]

SETTLED = 0.05
CONVERGED = 0.05


@dataclass(frozen=True, slots=True)
class Cycle:
    """One reference cycle.

    Attributes:
        start_s: Its start.
        load: Size of the load at its end, as a multiple of the nominal one.
        overshoot: The larger one of its two half cycles, as a fraction of the step.
        settling_s: Time until the output stays within 5 % of the step; the longer one of its two
            half cycles, None when a half cycle ends before.
        model_error_rms: Deviation from the ideal closed loop, as a fraction of the step.
    """

    start_s: float
    load: float
    overshoot: float
    settling_s: float | None
    model_error_rms: float


def cycles(experiment: Experiment, design: Design, record: RunRecord) -> list[Cycle]:
    """Judge every reference cycle of a run."""
    errors = model_errors(experiment, design, record)
    return [_cycle(experiment, record, errors, start_s) for start_s in experiment.cycle_starts()]


def model_errors(experiment: Experiment, design: Design, record: RunRecord) -> Array:
    """Deviation from the ideal closed loop at each slow instant, as a fraction of the step."""
    return (np.array(record.output) - ideal_output(experiment, design)) / experiment.step


def rms_between(record: RunRecord, errors: Array, first_s: float, last_s: float) -> float:
    """Root of the mean square over first <= t < last."""
    return _rms(errors[_between(record, first_s, last_s)])


def _cycle(experiment: Experiment, record: RunRecord, errors: Array, start_s: float) -> Cycle:
    half_s = 0.5 * experiment.reference.period_s
    end_s = min(start_s + 2.0 * half_s, experiment.duration_s)
    halves = [_half(experiment, record, start_s, start_s + half_s)]
    if end_s > start_s + half_s:
        halves.append(_half(experiment, record, start_s + half_s, end_s))
    overshoot = max(half[0] for half in halves)
    settling_s = max(half[1] for half in halves)
    return Cycle(
        start_s=start_s,
        load=experiment.size_at(math.nextafter(end_s, start_s)),
        overshoot=overshoot,
        settling_s=settling_s if math.isfinite(settling_s) else None,
        model_error_rms=rms_between(record, errors, start_s, end_s),
    )


def _half(
    experiment: Experiment, record: RunRecord, first_s: float, last_s: float
) -> tuple[float, float]:
    """Overshoot, and settling time or infinity, of one half cycle."""
    chosen = _between(record, first_s, last_s)
    target = experiment.reference.value(first_s)
    sign = 1.0 if target == experiment.reference.high else -1.0
    excess = sign * (np.array(record.output)[chosen] - target) / experiment.step
    outside = np.flatnonzero(np.abs(excess) > SETTLED)
    settled = int(outside[-1]) + 1 if outside.size else 0
    settling_s = settled * experiment.period_s if settled < excess.size else math.inf
    return max(0.0, float(excess.max())), settling_s


def convergence_cycles(
    experiment: Experiment, record: RunRecord, change: LoadChange
) -> float | None:
    """Reference cycles until every estimate is within 5 % of the truth and stays so.

    Args:
        experiment: What was done.
        record: Of an adaptive run.
        change: The load change after which to look; only until the next one.

    Returns:
        None when the estimates never get there.
    """
    chosen = _between(record, change.time_s, experiment.until_next_change(change))
    names = experiment.nominal().names
    estimates = np.array([record.estimates[name] for name in names])[:, chosen]
    times = np.array(record.time_s)[chosen]
    truth = np.array([experiment.truth_at(time_s) for time_s in times]).T
    with np.errstate(invalid="ignore"):
        good = np.all(np.abs(estimates / truth - 1.0) <= CONVERGED, axis=0)
    bad = np.flatnonzero(~good)
    first = int(bad[-1]) + 1 if bad.size else 0
    if first == good.size:
        return None
    return float(times[first] - change.time_s) / experiment.reference.period_s


def _between(record: RunRecord, first_s: float, last_s: float) -> NDArray[np.bool_]:
    times = np.array(record.time_s)
    return (times >= first_s) & (times < last_s)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values * values)))


def estimate_moves(experiment: Experiment, record: RunRecord) -> dict[str, float]:
    """Return the smallest move of each estimate among the load changes, relative to its value.

    A move is the largest distance from the last value before the change, within one cycle after
    it.
    """
    periods = round(experiment.reference.period_s / experiment.period_s)
    firsts = [round(change.time_s / experiment.period_s) for change in experiment.changes]
    return {
        name: min(_move(np.array(record.estimates[name]), first, periods) for first in firsts)
        for name in experiment.nominal().names
    }


def _move(values: Array, first: int, periods: int) -> float:
    before = values[first - 1]
    return float(np.max(np.abs(values[first : first + periods] / before - 1.0)))
