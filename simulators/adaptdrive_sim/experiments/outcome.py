"""Result of an experiment: runs, metrics, claims and the verdicts on them.

Each claim has what was measured, what is expected, and whether it holds.
"""

import dataclasses
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from adaptdrive_sim.course import Run
from adaptdrive_sim.experiments.case import (
    Cycle,
    Disturbance,
    ReproduceRequest,
    Variant,
    convergence_cycles,
    cycles,
    estimate_moves,
)
from adaptdrive_sim.experiments.sweep import SweepPoint, settling_time_s

# Claims about what was simulated, and the verdicts on them.

_VERDICTS = {True: "holds", False: "FAILS", None: "not judged"}


@dataclass(frozen=True, slots=True)
class Claim:
    """One claim.

    Attributes:
        claim: What is claimed.
        measured: What was measured.
        target: What is expected.
        met: Whether it holds; None where this run's noise is not the one to judge it by.
    """

    claim: str
    measured: str
    target: str
    met: bool | None


def print_claims(title: str, claims: list[Claim]) -> None:
    """Print the verdict on every claim."""
    lines = [
        f"{_VERDICTS[one.met]}: {one.claim}: {one.measured} (target: {one.target})"
        for one in claims
    ]
    sys.stdout.write("\n".join((title, *lines)) + "\n")


# Result of an experiment: its runs, its metrics, and the verdicts on the paper's claims.


@dataclass(frozen=True, slots=True)
class ExperimentOutcome(ReproduceRequest):
    """Everything that was found.

    Attributes:
        records: Recorded runs by controller.
        cycles: Metrics of each run by controller.
        converged: Cycles until the adaptive run's estimates were right, for each load change.
        over_forgetting: What other values of ρ do.
        over_tau_lambda: What other values of τ_λ do.
    """

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


def judge(request: ReproduceRequest, records: dict[Variant, Run]) -> ExperimentOutcome:
    """Work out the metrics of all runs."""
    experiment, design = request.experiment, request.design
    judged = {variant: cycles(experiment, design, record) for variant, record in records.items()}
    adaptive = records["adaptive"]
    converged = [convergence_cycles(experiment, adaptive, one) for one in experiment.changes]
    noise, seed = request.disturbance, request.seed
    return ExperimentOutcome(experiment, design, noise, seed, records, judged, converged)


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


NOISY = Disturbance(noise=0.002, spike_share=0.02, spike_noise=0.10)
"""Under this noise direct least squares is held against the λ-method."""


_CYCLES_DROPPED = 3.0
"""Cycles until the estimates are right again where the speed drops with each disk."""

_MOVED = 0.05
"""An estimate that moves by this share has been disturbed."""


def claims(outcome: ExperimentOutcome) -> list[Claim]:
    """Judge every claim that the paper makes of an experiment."""
    return [make(outcome) for make in _CLAIMS[outcome.experiment.name]]


def _fixed_motor(outcome: ExperimentOutcome) -> Claim:
    overshoots = _last_of_segments(outcome, "fixed")
    rising = all(a < b for a, b in pairwise(overshoots))
    return Claim(
        "the fixed controller overshoots more with each disk",
        _percents(overshoots),
        "rising, the last above 15 %",
        rising and overshoots[-1] > 0.15,
    )


def _adaptive_motor(outcome: ExperimentOutcome) -> Claim:
    overshoots = _last_of_segments(outcome, "adaptive")
    return Claim(
        "the adaptive one does not, in the last cycle with each load",
        _percents(overshoots),
        "each below 2 %",
        max(overshoots) < 0.02,
    )


def _converged(outcome: ExperimentOutcome) -> Claim:
    found, most = outcome.converged, _CYCLES_DROPPED if outcome.experiment.dropped else 2.0
    return Claim(
        "its estimates are within 5 % of the truth about two cycles after each load change",
        ", ".join("never" if one is None else f"{one:.2f}" for one in found) + " cycles",
        f"at most {most:g} cycles",
        all(one is not None and one <= most for one in found),
    )


def _disturbed(outcome: ExperimentOutcome) -> Claim:
    least = estimate_moves(outcome.experiment, outcome.records["adaptive"])
    judged = outcome.experiment.dropped and outcome.design == "paper"
    return Claim(
        "each load change disturbs all three estimates, the gain too, which is not changed",
        ", ".join(f"{name} {100.0 * move:.2g} %" for name, move in least.items()),
        f"each by {100.0 * _MOVED:g} % at least in the paper's design, where disks land at rest",
        min(least.values()) >= _MOVED if judged else None,
    )


def _direct_motor(outcome: ExperimentOutcome) -> Claim:
    ratio = outcome.model_error("direct_rls") / outcome.model_error("adaptive")
    judged = outcome.disturbance == NOISY and outcome.design == "paper"
    return Claim(
        "where there are spikes, direct RLS is erratic: its model error over that of LM-RLS",
        f"{ratio:.2f}",
        f"at least 1.8 with --spikes {NOISY.spike_share},{NOISY.spike_noise}",
        ratio >= 1.8 if judged else None,
    )


def _fixed_bath(outcome: ExperimentOutcome) -> Claim:
    last = outcome.experiment.changes[-1].size
    overshoots = [one.overshoot for one in outcome.cycles["fixed"] if one.load == last]
    return Claim(
        "the fixed controller overshoots in each cycle after the change of volume",
        _percents(overshoots),
        "each above 7 %",
        min(overshoots) > 0.07,
    )


def _adaptive_bath(outcome: ExperimentOutcome) -> Claim:
    overshoots = [one.overshoot for one in outcome.cycles["adaptive"]]
    return Claim(
        "the adaptive one hardly does, in any cycle",
        _percents(overshoots),
        "each below 3.5 %",
        max(overshoots) < 0.035,
    )


def _forgetting(outcome: ExperimentOutcome) -> Claim:
    method = outcome.experiment.sweep.methods[0]
    points = [one for one in outcome.over_forgetting if one.setting.method == method]
    first, last = points[0], points[-1]
    return Claim(
        "forgetting faster brings speed and costs noise",
        f"ρ = {first.setting.forgetting:g}: {_speed_and_noise(first)}; "
        f"ρ = {last.setting.forgetting:g}: {_speed_and_noise(last)}",
        "faster and noisier at the smaller ρ",
        _cycles(first) < _cycles(last) and first.deviation > last.deviation,
    )


def _tau_lambda(outcome: ExperimentOutcome) -> Claim:
    experiment = outcome.experiment
    limit_s = settling_time_s(experiment.nominal(), 0.1 * experiment.period_s)
    below, beyond = (
        min(
            one.deviation
            for one in outcome.over_tau_lambda
            if (one.setting.tau_lambda_s > limit_s) is slower
        )
        for slower in (False, True)
    )
    return Claim(
        f"λ filters slower than the load's settling time of {limit_s:.0f} s gain nothing",
        f"noise in the estimates at best {100.0 * beyond:.2g} %",
        f"no more than a tenth below the {100.0 * below:.2g} % of faster ones",
        beyond >= 0.9 * below,
    )


def _last_of_segments(outcome: ExperimentOutcome, variant: Variant) -> list[float]:
    """Overshoot in the last cycle with each load."""
    experiment = outcome.experiment
    found = {
        one.start_s + experiment.reference.period_s: one.overshoot
        for one in outcome.cycles[variant]
    }
    return [found[end] for end in experiment.ends_s]


def _percents(values: list[float]) -> str:
    return ", ".join(f"{100.0 * value:.1f}" for value in values) + " %"


def _cycles(point: SweepPoint) -> float:
    return float("inf") if point.cycles is None else point.cycles


def _speed_and_noise(point: SweepPoint) -> str:
    speed = "never" if point.cycles is None else f"{point.cycles:.2f} cycles"
    return f"{speed}, {100.0 * point.deviation:.2g} %"


_CLAIMS: dict[str, tuple[Callable[[ExperimentOutcome], Claim], ...]] = {
    "motor": (
        *(_fixed_motor, _adaptive_motor, _converged, _disturbed, _direct_motor),
        *(_forgetting, _tau_lambda),
    ),
    "bath": (_fixed_bath, _adaptive_bath, _forgetting, _tau_lambda),
}
