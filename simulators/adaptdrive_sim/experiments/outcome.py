"""Result of an experiment: its runs, its metrics, and the verdicts on the paper's claims."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

from adaptdrive_sim.course import Run
from adaptdrive_sim.experiments.case import Design, Disturbance, Variant
from adaptdrive_sim.experiments.experiment import Experiment
from adaptdrive_sim.experiments.metrics import Cycle, convergence_cycles, cycles
from adaptdrive_sim.experiments.sweep import SweepPoint


@dataclass(frozen=True, slots=True)
class ExperimentOutcome:
    """Everything that was found.

    Attributes:
        experiment: What was done.
        design: In which design.
        disturbance: Under which noise.
        seed: Of the noise.
        records: Recorded runs by controller.
        cycles: Metrics of each run by controller.
        converged: Cycles until the adaptive run's estimates were right, for each load change.
        over_forgetting: What other values of ρ do.
        over_tau_lambda: What other values of τ_λ do.
    """

    experiment: Experiment
    design: Design
    disturbance: Disturbance
    seed: int
    records: dict[Variant, Run]
    cycles: dict[Variant, list[Cycle]]
    converged: list[float | None]
    over_forgetting: list[SweepPoint] = dataclasses.field(default_factory=list)
    over_tau_lambda: list[SweepPoint] = dataclasses.field(default_factory=list)

    def model_error(self, variant: Variant) -> float:
        """Root mean square of the model error, all but the first reference cycle.

        The cycles in which the speed drops with a disk are left out too: no controller can help.
        """
        drops = {one.time_s for one in self.experiment.changes if self.experiment.dropped}
        counted = [one for one in self.cycles[variant][1:] if one.start_s not in drops]
        squares = [one.model_error_rms * one.model_error_rms for one in counted]
        return math.sqrt(sum(squares) / len(squares))


def judge(
    experiment: Experiment,
    design: Design,
    disturbance: Disturbance,
    seed: int,
    records: dict[Variant, Run],
) -> ExperimentOutcome:
    """Work out the metrics of all runs."""
    judged = {variant: cycles(experiment, design, record) for variant, record in records.items()}
    adaptive = records["adaptive"]
    converged = [convergence_cycles(experiment, adaptive, one) for one in experiment.changes]
    return ExperimentOutcome(experiment, design, disturbance, seed, records, judged, converged)


def summary(
    outcome: ExperimentOutcome, claims: list[dict[str, Any]], wall_s: float
) -> dict[str, Any]:
    """The content of summary.json."""
    return {
        "experiment": outcome.experiment.name,
        "seed": outcome.seed,
        "wall_s": wall_s,
        "controllers": {
            variant: {"cycles": [dataclasses.asdict(cycle) for cycle in judged]}
            for variant, judged in outcome.cycles.items()
        },
        "estimates": [
            {"load_change_s": change.time_s, "cycles_to_5_percent": cycles_needed}
            for change, cycles_needed in zip(
                outcome.experiment.changes, outcome.converged, strict=True
            )
        ],
        "claims": claims,
    }
