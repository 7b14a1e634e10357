"""Judges a run: criteria that every load shares, and the row of a motor's or a bath's.

The cost of a controller is the squared error against the loop as it was designed, summed over the
slow instants, plus (0.005 · step)² for each: errors below any display cost nothing relative to
that.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.signals import Mode
from adaptdrive.control.supervisor import Verdict
from adaptdrive_sim.campaign.drawn import DrawnRun, Row
from adaptdrive_sim.course import Run

Array = NDArray[np.float64]


FLOOR = 0.005
WORSE = 1.05
UNSTABLE = 0.5
"""Of the largest movement that is expected: rms error at the end of an unstable run."""


def cost(errors: Array) -> float:
    """Mean squared error, as a fraction of the step, with the floor; infinite if it ended early."""
    if not np.all(np.isfinite(errors)):
        return float("inf")
    return float(np.mean(errors**2)) + FLOOR**2


def rms(errors: Array) -> float:
    """Return the root of the mean squared error."""
    return float(np.sqrt(np.mean(errors**2)))


def error_columns(name: str, errors: Array) -> Row:
    """Return the columns of one controller's errors.

    Args:
        name: The controller.
        errors: Differences to the designed loop, as fractions of the step.
    """
    return {
        f"cost_{name}": cost(errors),
        f"rms_{name}": rms(errors),
        f"largest_{name}": float(np.max(np.abs(errors))),
    }


def run_and_judge(stand: DrawnRun) -> Row:
    """Run one scenario with both controllers and judge them."""
    return judge(stand, stand.run(Mode.FIXED), stand.run(Mode.ADAPTIVE))


def judge(stand: DrawnRun, fixed: Run, adaptive: Run) -> Row:
    """One row of the results."""
    ideal = stand.ideal()
    row = stand.columns()
    for name, outcome in (("fixed", fixed), ("adaptive", adaptive)):
        shown = outcome["output"] + stand.offset
        errors = ((shown - ideal) / stand.step)[stand.running()]
        row |= error_columns(name, errors)
        row[f"unstable_{name}"] = is_unstable(stand, errors)
        row[f"interlock_{name}"] = outcome.interlock
    row["ratio"] = row["cost_adaptive"] / row["cost_fixed"]
    row |= _supervision(stand, adaptive)
    return row


def is_unstable(stand: DrawnRun, errors: Array) -> bool:
    """Return whether the last period of the reference is nothing like what was designed."""
    last = errors[-stand.cycle_periods :]
    return not rms(last) < UNSTABLE * stand.largest_movement / stand.step


def _supervision(stand: DrawnRun, run: Run) -> Row:
    in_force, verdicts = run["adaptive"] > 0.0, run["verdict"]
    truth = stand.truth_at(stand.times_s.size - 1)
    estimates = np.array([run[name][-1] for name in stand.own.load.names])
    row: Row = {
        "adaptive_share": float(np.mean(in_force)),
        "accepted_share": float(np.mean(run["accepted"] > 0.0)),
        "switches": int(np.count_nonzero(np.diff(in_force.astype(int)))),
        "estimate_error": float(np.max(np.abs(estimates / truth - 1.0))),
        "saturated_share": float(np.mean(_at_limit(run["boost_reference_V"]))),
    }
    for verdict in Verdict:
        row[f"verdict_{verdict.name.lower()}"] = int(np.count_nonzero(verdicts == verdict))
    return row


def _at_limit(voltage_V: Array) -> NDArray[np.bool_]:
    return (voltage_V <= 200.0 + 1e-9) | (voltage_V >= 400.0 - 1e-9)
