"""Criteria of a run.

The cost of a controller is the squared error against the loop as it was designed, summed over the
slow instants, plus (0.005 · step)² for each: errors below any display cost nothing relative to
that.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.signals import Mode
from adaptdrive.control.supervisor import Verdict
from adaptdrive_sim.campaign.bench import RunOutcome, Stand
from adaptdrive_sim.campaign.scenario import Scenario, draw
from adaptdrive_sim.campaign.settings import Campaign
from adaptdrive_sim.compiled import bench

Array = NDArray[np.float64]
Row = dict[str, Any]

FLOOR = 0.005
WORSE = 1.05
_UNSTABLE = 0.5


def run_seed(campaign: Campaign, seed: int) -> Row:
    """Run one scenario with both controllers and judge them."""
    stand = Stand(draw(campaign, seed))
    return judge(stand, stand.run(Mode.FIXED), stand.run(Mode.ADAPTIVE))


def judge(stand: Stand, fixed: RunOutcome, adaptive: RunOutcome) -> Row:
    """One row of the results."""
    ideal = stand.ideal()
    row = parameters(stand.scenario)
    for name, outcome in (("fixed", fixed), ("adaptive", adaptive)):
        shown = outcome.trace[:, bench.OUTPUT] + stand.scenario.life.offset
        errors = ((shown - ideal) / stand.scenario.step)[stand.running()]
        row[f"cost_{name}"] = cost(errors)
        row[f"rms_{name}"] = float(np.sqrt(np.mean(errors**2)))
        row[f"largest_{name}"] = float(np.max(np.abs(errors)))
        row[f"unstable_{name}"] = is_unstable(stand.scenario, errors)
        row[f"interlock_{name}"] = outcome.interlock
    row["ratio"] = row["cost_adaptive"] / row["cost_fixed"]
    row |= _supervision(stand, adaptive.trace)
    return row


def parameters(scenario: Scenario) -> Row:
    """Return the drawn values as columns."""
    return {
        "seed": scenario.seed,
        "inertia_first": scenario.inertias[0],
        "inertia_last": scenario.inertias[-1],
        "inertia_largest": max(scenario.inertias),
        "changes": len(scenario.change_times_s),
        "gain": scenario.gain,
        "filter": scenario.filter,
        "shape": scenario.reference.shape.value,
        "step": scenario.step,
        "period_s": scenario.reference.period_s,
        "sigma": scenario.sigma / scenario.step,
        "spike_share": scenario.spike_share,
        "line_voltage": scenario.line_voltage,
        "frequency_Hz": scenario.frequency_Hz,
        "output_delay_ticks": scenario.output_delay_ticks,
        "torque_changes": len(scenario.life.torques_V),
        "torque_largest_V": scenario.life.largest_torque_V,
        "restarts": len(scenario.life.stop_times_s),
        "idle_s": min(scenario.duration_s, sum(scenario.life.idle_s)),
        "coulomb_V": scenario.life.coulomb_V,
        "drag_V": scenario.life.drag_V,
        "offset": scenario.life.offset,
    }


def cost(errors: Array) -> float:
    """Mean squared error, as a fraction of the step, with the floor; infinite if it ended early."""
    if not np.all(np.isfinite(errors)):
        return float("inf")
    return float(np.mean(errors**2)) + FLOOR**2


def is_unstable(scenario: Scenario, errors: Array) -> bool:
    """Return whether the last period of the reference is nothing like what was designed."""
    last = errors[-round(scenario.reference.period_s) :]
    return (
        not float(np.sqrt(np.mean(last**2))) < _UNSTABLE * scenario.largest_movement / scenario.step
    )


def _supervision(stand: Stand, trace: Array) -> Row:
    in_force = trace[:, bench.ADAPTIVE] > 0.0
    verdicts = trace[:, bench.VERDICT]
    truth = stand.truth_of(stand.scenario.inertias[-1])
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
