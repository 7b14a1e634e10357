"""Judges a run that is drawn from its seed and runs compiled: a motor's or a bath's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.signals import Mode
from adaptdrive.control.supervisor import Verdict
from adaptdrive_sim.campaign.criteria import UNSTABLE, error_columns, rms
from adaptdrive_sim.campaign.drawn import DrawnRun, Row, RunOutcome
from adaptdrive_sim.compiled import bench

Array = NDArray[np.float64]


def run_and_judge(stand: DrawnRun) -> Row:
    """Run one scenario with both controllers and judge them."""
    return judge(stand, stand.run(Mode.FIXED), stand.run(Mode.ADAPTIVE))


def judge(stand: DrawnRun, fixed: RunOutcome, adaptive: RunOutcome) -> Row:
    """One row of the results."""
    ideal = stand.ideal()
    row = stand.scenario.columns()
    for name, outcome in (("fixed", fixed), ("adaptive", adaptive)):
        shown = outcome.trace[:, bench.OUTPUT] + stand.offset
        errors = ((shown - ideal) / stand.step)[stand.running()]
        row |= error_columns(name, errors)
        row[f"unstable_{name}"] = is_unstable(stand, errors)
        row[f"interlock_{name}"] = outcome.interlock
    row["ratio"] = row["cost_adaptive"] / row["cost_fixed"]
    row |= _supervision(stand, adaptive.trace)
    return row


def is_unstable(stand: DrawnRun, errors: Array) -> bool:
    """Return whether the last period of the reference is nothing like what was designed."""
    last = errors[-stand.cycle_periods :]
    return not rms(last) < UNSTABLE * stand.largest_movement / stand.step


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
