"""`adaptdrive-sim reproduce`: an experiment of the paper from start to end, and its claims.

Each claim has what was measured, what is expected, and whether it holds.
"""

import dataclasses
import json
import os
import sys
import time
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from adaptdrive.util.errors import AdaptdriveError, RefusedError
from adaptdrive_sim.course import Run, processes, progress
from adaptdrive_sim.experiments import case
from adaptdrive_sim.experiments import outcome as outcomes
from adaptdrive_sim.experiments.experiment import BATH, DROPPED, MOTOR, Experiment
from adaptdrive_sim.experiments.outcome import Outcome
from adaptdrive_sim.world import NoiseParameters

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


def summary(outcome: Outcome, claims: list[dict[str, Any]], wall_s: float) -> dict[str, Any]:
    """The content of summary.json."""
    changes = zip(outcome.experiment.changes, outcome.converged, strict=True)
    return {
        "experiment": outcome.experiment.name,
        "seed": outcome.case.seed,
        "wall_s": wall_s,
        "controllers": {
            variant: {"cycles": [dataclasses.asdict(cycle) for cycle in judged]}
            for variant, judged in outcome.cycles.items()
        },
        "estimates": [
            {"load_change_s": change.time_s, "cycles_to_5_percent": cycles_needed}
            for change, cycles_needed in changes
        ],
        "claims": claims,
    }


NOISY = NoiseParameters(sigma=0.002, spike_share=0.02, spike_sigma=0.10)
"""Under this noise direct least squares is held against the λ-method."""


_CYCLES_DROPPED = 3.0
"""Cycles until the estimates are right again where the speed drops with each disk."""

_MOVED = 0.05
"""An estimate that moves by this share has been disturbed."""


def claims(outcome: Outcome) -> list[Claim]:
    """Judge every claim that the paper makes of an experiment."""
    return [make(outcome) for make in _CLAIMS[outcome.experiment.name]]


def _fixed_motor(outcome: Outcome) -> Claim:
    overshoots = _last_of_segments(outcome, "fixed")
    rising = all(a < b for a, b in pairwise(overshoots))
    return Claim(
        "the fixed controller overshoots more with each disk",
        _percents(overshoots),
        "rising, the last above 15 %",
        rising and overshoots[-1] > 0.15,
    )


def _adaptive_motor(outcome: Outcome) -> Claim:
    overshoots = _last_of_segments(outcome, "adaptive")
    return Claim(
        "the adaptive one does not, in the last cycle with each load",
        _percents(overshoots),
        "each below 2 %",
        max(overshoots) < 0.02,
    )


def _converged(outcome: Outcome) -> Claim:
    found, most = outcome.converged, _CYCLES_DROPPED if outcome.experiment.dropped else 2.0
    return Claim(
        "its estimates are within 5 % of the truth about two cycles after each load change",
        ", ".join("never" if one is None else f"{one:.2f}" for one in found) + " cycles",
        f"at most {most:g} cycles",
        all(one is not None and one <= most for one in found),
    )


def _disturbed(outcome: Outcome) -> Claim:
    least = case.estimate_moves(outcome.experiment, outcome.records["adaptive"])
    judged = outcome.experiment.dropped and outcome.case.design == "paper"
    return Claim(
        "each load change disturbs all three estimates, the gain too, which is not changed",
        ", ".join(f"{name} {100.0 * move:.2g} %" for name, move in least.items()),
        f"each by {100.0 * _MOVED:g} % at least in the paper's design, where disks land at rest",
        min(least.values()) >= _MOVED if judged else None,
    )


def _direct_motor(outcome: Outcome) -> Claim:
    ratio = outcome.model_error("direct_rls") / outcome.model_error("adaptive")
    judged = outcome.case.disturbance == NOISY and outcome.case.design == "paper"
    return Claim(
        "where there are spikes, direct RLS is erratic: its model error over that of LM-RLS",
        f"{ratio:.2f}",
        f"at least 1.8 with --spikes {NOISY.spike_share},{NOISY.spike_sigma}",
        ratio >= 1.8 if judged else None,
    )


def _fixed_bath(outcome: Outcome) -> Claim:
    last = outcome.experiment.changes[-1].size
    overshoots = [one.overshoot for one in outcome.cycles["fixed"] if one.load == last]
    return Claim(
        "the fixed controller overshoots in each cycle after the change of volume",
        _percents(overshoots),
        "each above 7 %",
        min(overshoots) > 0.07,
    )


def _adaptive_bath(outcome: Outcome) -> Claim:
    overshoots = [one.overshoot for one in outcome.cycles["adaptive"]]
    return Claim(
        "the adaptive one hardly does, in any cycle",
        _percents(overshoots),
        "each below 3.5 %",
        max(overshoots) < 0.035,
    )


def _forgetting(outcome: Outcome) -> Claim:
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


def _tau_lambda(outcome: Outcome) -> Claim:
    experiment = outcome.experiment
    limit_s = outcomes.settling_time_s(experiment.nominal(), 0.1 * experiment.period_s)
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


def _last_of_segments(outcome: Outcome, variant: case.Variant) -> list[float]:
    """Overshoot in the last cycle with each load."""
    cycle_s = outcome.experiment.reference.period_s
    found = {one.start_s + cycle_s: one.overshoot for one in outcome.cycles[variant]}
    return [found[end] for end in outcome.experiment.ends_s]


def _percents(values: list[float]) -> str:
    return ", ".join(f"{100.0 * value:.1f}" for value in values) + " %"


def _cycles(point: outcomes.SweepPoint) -> float:
    return float("inf") if point.cycles is None else point.cycles


def _speed_and_noise(point: outcomes.SweepPoint) -> str:
    speed = "never" if point.cycles is None else f"{point.cycles:.2f} cycles"
    return f"{speed}, {100.0 * point.deviation:.2g} %"


_CLAIMS: dict[str, tuple[Callable[[Outcome], Claim], ...]] = {
    "motor": (
        *(_fixed_motor, _adaptive_motor, _converged, _disturbed, _direct_motor),
        *(_forgetting, _tau_lambda),
    ),
    "bath": (_fixed_bath, _adaptive_bath, _forgetting, _tau_lambda),
}


# The command.

VARIANTS: dict[str, tuple[case.Variant, ...]] = {
    "motor": ("fixed", "adaptive", "direct_rls"),
    "bath": ("fixed", "adaptive"),
}

_OTHER_STEPS = 4


def find_experiment(name: str, *, keep_speed: bool) -> Experiment:
    """Return an experiment by its name on the command line.

    Args:
        name: motor or bath.
        keep_speed: Whether the motor's speed stays when a disk is added.

    Raises:
        RefusedError: The load has no disks.
    """
    if name == "bath":
        if keep_speed:
            raise RefusedError("--keep-speed: a bath has no disks")
        return BATH
    return MOTOR if keep_speed else DROPPED


def run_experiment(request: case.Case, folder: Path) -> list[Claim]:
    """Run an experiment, and write its figures, its summary and its recorded runs.

    Args:
        request: What to reproduce.
        folder: Where the results go; made when it is not there.

    Returns:
        The verdict on each of the paper's claims.

    Raises:
        AdaptdriveError: The results cannot be written, or a process has died.
    """
    started_s = time.perf_counter()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        outcome = _carry_out(request, folder)
        verdicts = claims(outcome)
        for variant in outcome.records:
            _write_record(folder / f"{variant}.parquet", outcome, variant)
        found = [dataclasses.asdict(one) for one in verdicts]
        content = summary(outcome, found, time.perf_counter() - started_s)
        text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
        (folder / "summary.json").write_text(text + "\n", encoding="utf-8")
    except OSError as problem:
        raise AdaptdriveError(f"{folder}: {problem.strerror or problem}") from problem
    except BrokenProcessPool as problem:
        raise AdaptdriveError(str(problem)) from problem
    return verdicts


def _carry_out(request: case.Case, folder: Path) -> Outcome:
    """Run everything in parallel, and draw each figure as soon as its data is there."""
    variants = VARIANTS[request.experiment.name]
    workers = min(len(variants), os.cpu_count() or 1)
    with processes(workers) as pool, progress(len(variants) + _OTHER_STEPS) as done:
        runs = {
            one: pool.submit(
                case.run_case, dataclasses.replace(request, variant=one), keep_ticks=one == "fixed"
            )
            for one in variants
        }
        # Drawing takes a while to import: meanwhile the runs are under way.
        from adaptdrive_sim.experiments import figure  # noqa: PLC0415

        sweep_case = request.sweep()
        given = outcomes.recording_of(sweep_case, runs["fixed"].result())
        over_forgetting, over_tau_lambda = (
            pool.submit(outcomes.try_settings, given, settings(sweep_case))
            for settings in (outcomes.settings_over_forgetting, outcomes.settings_over_tau_lambda)
        )
        records: dict[case.Variant, Run] = {}
        for variant, run in runs.items():
            records[variant] = run.result()
            done(1, f"ran the {variant} controller")
        outcome = outcomes.judge(request, records)
        figure.draw(figure.experiment_figure, outcome, folder / "figure.png")
        done(1, "drew the experiment")
        outcome = dataclasses.replace(
            outcome,
            over_forgetting=over_forgetting.result(),
            over_tau_lambda=over_tau_lambda.result(),
        )
        done(1, "tried other settings of the estimator")
        figure.draw(figure.sweep_figure, outcome, folder / "sweep.png")
        done(1, "drew them")
    return outcome


def _write_record(path: Path, outcome: Outcome, variant: case.Variant) -> None:
    """Write a row for each slow period; what a run was made with is in the file's metadata."""
    made, disturbance = outcome.case, outcome.case.disturbance
    metadata = {
        "experiment": made.experiment.name,
        "controller": variant,
        "design": made.design,
        "seed": str(made.seed),
        "noise": repr(disturbance.sigma),
        "dropped_at_rest": str(made.experiment.dropped).lower(),
        "spikes": f"{disturbance.spike_share!r},{disturbance.spike_sigma!r}",
    }
    table = outcome.records[variant].table().replace_schema_metadata(metadata)
    pq.write_table(table, path, compression="zstd")
