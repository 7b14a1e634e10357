"""Judges a run by criteria that every load shares.

The cost of a controller is the squared error against the loop as it was designed, summed over the
slow instants, plus (0.005 · step)² for each: errors below any display cost nothing relative to
that.
"""

from __future__ import annotations

import numpy as np

from adaptdrive_sim.campaign.drawn import Row, Trial
from adaptdrive_sim.course import Array, Run

FLOOR = 0.005
WORSE = 1.05
UNSTABLE = 0.5
"""Of the largest movement that is expected: rms error at the end of an unstable run, whose last
period of the reference is nothing like what was designed."""


def cost(errors: Array) -> float:
    """Mean squared error, as a fraction of the step, with the floor; infinite if it ended early."""
    if not np.all(np.isfinite(errors)):
        return float("inf")
    return float(np.mean(errors**2)) + FLOOR**2


def rms(errors: Array) -> float:
    """Return the root of the mean squared error."""
    return float(np.sqrt(np.mean(errors**2)))


def judge(trial: Trial, fixed: Run, adaptive: Run) -> Row:
    """Return one row of the results."""
    row = trial.columns()
    unstable = UNSTABLE * trial.largest_movement / trial.step
    for name, run in (("fixed", fixed), ("adaptive", adaptive)):
        errors = trial.errors(run)
        row[f"cost_{name}"], row[f"rms_{name}"] = cost(errors), rms(errors)
        row[f"largest_{name}"] = float(np.max(np.abs(errors)))
        row[f"unstable_{name}"] = not rms(errors[-trial.cycle_periods :]) < unstable
        row[f"interlock_{name}"] = run.interlock
        row |= {f"trip_{name}": run.trip, f"refused_{name}": len(run.refused)}
    row["ratio"] = row["cost_adaptive"] / row["cost_fixed"]
    return row | trial.seen(adaptive)
