"""Criteria of a run.

The cost of a controller is the squared error against the loop as it was designed, summed over the
slow instants, plus (0.005 · step)² for each: errors below any display cost nothing relative to
that.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.signals import Mode
from adaptdrive.control.supervisor import Verdict
from adaptdrive_sim.campaign.drawn import DrawnRun, Row, RunOutcome
from adaptdrive_sim.campaign.kinds import AnyCampaign, stand_of
from adaptdrive_sim.compiled import bench

Array = NDArray[np.float64]

FLOOR = 0.005
WORSE = 1.05
_UNSTABLE = 0.5


def run_seed(campaign: AnyCampaign, seed: int) -> Row:
    """Run one scenario with both controllers and judge them."""
    stand = stand_of(campaign, seed)
    return judge(stand, stand.run(Mode.FIXED), stand.run(Mode.ADAPTIVE))


def judge(stand: DrawnRun, fixed: RunOutcome, adaptive: RunOutcome) -> Row:
    """One row of the results."""
    ideal = stand.ideal()
    row = stand.columns()
    for name, outcome in (("fixed", fixed), ("adaptive", adaptive)):
        shown = outcome.trace[:, bench.OUTPUT] + stand.offset
        errors = ((shown - ideal) / stand.step)[stand.running()]
        row[f"cost_{name}"] = cost(errors)
        row[f"rms_{name}"] = float(np.sqrt(np.mean(errors**2)))
        row[f"largest_{name}"] = float(np.max(np.abs(errors)))
        row[f"unstable_{name}"] = is_unstable(stand, errors)
        row[f"interlock_{name}"] = outcome.interlock
    row["ratio"] = row["cost_adaptive"] / row["cost_fixed"]
    row |= _supervision(stand, adaptive.trace)
    return row


def cost(errors: Array) -> float:
    """Mean squared error, as a fraction of the step, with the floor; infinite if it ended early."""
    if not np.all(np.isfinite(errors)):
        return float("inf")
    return float(np.mean(errors**2)) + FLOOR**2


def is_unstable(stand: DrawnRun, errors: Array) -> bool:
    """Return whether the last period of the reference is nothing like what was designed."""
    last = errors[-stand.cycle_periods :]
    return not float(np.sqrt(np.mean(last**2))) < _UNSTABLE * stand.largest_movement / stand.step


def _supervision(stand: DrawnRun, trace: Array) -> Row:
    in_force = trace[:, bench.ADAPTIVE] > 0.0
    verdicts = trace[:, bench.VERDICT]
    truth = stand.truth_at(stand.times_s.size - 1)
    estimates = trace[-1, bench.VALUES : bench.VALUES + len(truth)]
    row: Row = {
        "adaptive_share": float(np.mean(in_force)),
        "accepted_share": float(np.mean(trace[:, bench.ACCEPTED] > 0.0)),
        "switches": int(np.count_nonzero(np.diff(in_force.astype(int)))),
        "estimate_error": float(np.max(np.abs(estimates / truth - 1.0))),
        "saturated_share": float(np.mean(_at_limit(trace[:, bench.REFERENCE_V]))),
    }
    for verdict in Verdict:
        row[f"verdict_{verdict.name.lower()}"] = int(np.count_nonzero(verdicts == verdict))
    return row


def _at_limit(voltage_V: Array) -> NDArray[np.bool_]:
    return (voltage_V <= 200.0 + 1e-9) | (voltage_V >= 400.0 - 1e-9)
