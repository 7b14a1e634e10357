"""`adaptdrive-sim reproduce`: an experiment of the paper from start to end."""

import dataclasses
import json
import os
import time
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pyarrow.parquet as pq

from adaptdrive.util.errors import AdaptdriveError, RefusedError
from adaptdrive_sim.course import Run, processes, progress
from adaptdrive_sim.experiments import case, sweep
from adaptdrive_sim.experiments.experiment import BATH, DROPPED, MOTOR, Experiment
from adaptdrive_sim.experiments.outcome import Claim, ExperimentOutcome, claims, judge, summary

VARIANTS: dict[str, tuple[case.Variant, ...]] = {
    "motor": ("fixed", "adaptive", "direct_rls"),
    "bath": ("fixed", "adaptive"),
}

_OTHER_STEPS = 4


class OutputError(AdaptdriveError):
    """The results cannot be written."""


class RunError(AdaptdriveError):
    """A process that ran a controller has died."""


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


def run_request(request: case.ReproduceRequest, folder: Path) -> list[Claim]:
    """Run an experiment, and write its figures, its summary and its recorded runs.

    Args:
        request: What to reproduce.
        folder: Where the results go; made when it is not there.

    Returns:
        The verdict on each of the paper's claims.

    Raises:
        OutputError: The results cannot be written.
        RunError: A process that ran a controller has died.
    """
    started_s = time.perf_counter()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        outcome = _carry_out(request, folder)
        verdicts = claims(outcome)
        for variant in outcome.records:
            _write_record(folder / f"{variant}.parquet", outcome, variant)
        found = [dataclasses.asdict(one) for one in verdicts]
        told = summary(outcome, found, time.perf_counter() - started_s)
        text = json.dumps(told, indent=1, ensure_ascii=False, allow_nan=False)
        (folder / "summary.json").write_text(text + "\n", encoding="utf-8")
    except OSError as problem:
        raise OutputError(f"{folder}: {problem.strerror or problem}") from problem
    except BrokenProcessPool as problem:
        raise RunError(str(problem)) from problem
    return verdicts


def _carry_out(request: case.ReproduceRequest, folder: Path) -> ExperimentOutcome:
    """Run everything in parallel, and draw each figure as soon as its data is there."""
    experiment, variants = request.experiment, VARIANTS[request.experiment.name]
    workers = min(len(variants), os.cpu_count() or 1)
    with processes(workers) as pool, progress(len(variants) + _OTHER_STEPS) as done:
        runs = {
            variant: pool.submit(
                case.run_case, request.case(variant), keep_ticks=variant == "fixed"
            )
            for variant in variants
        }
        # Drawing takes a while to import: meanwhile the runs are under way.
        from adaptdrive_sim.experiments.figure import (  # noqa: PLC0415
            draw,
            experiment_figure,
            sweep_figure,
        )

        heard = sweep.listen(request.listener(), runs["fixed"].result())
        over_forgetting = pool.submit(
            sweep.try_settings, heard, sweep.settings_over_forgetting(experiment)
        )
        over_tau_lambda = pool.submit(
            sweep.try_settings, heard, sweep.settings_over_tau_lambda(experiment)
        )
        records: dict[case.Variant, Run] = {}
        for variant, run in runs.items():
            records[variant] = run.result()
            done(1, f"ran the {variant} controller")
        outcome = judge(request, records)
        draw(experiment_figure, outcome, folder / "figure.png")
        done(1, "drew the experiment")
        outcome = dataclasses.replace(
            outcome,
            over_forgetting=over_forgetting.result(),
            over_tau_lambda=over_tau_lambda.result(),
        )
        done(1, "tried other settings of the estimator")
        draw(sweep_figure, outcome, folder / "sweep.png")
        done(1, "drew them")
    return outcome


def _write_record(path: Path, outcome: ExperimentOutcome, variant: case.Variant) -> None:
    """Write a row for each slow period; what a run was made with is in the file's metadata."""
    disturbance = outcome.disturbance
    metadata = {
        "experiment": outcome.experiment.name,
        "controller": variant,
        "design": outcome.design,
        "seed": str(outcome.seed),
        "noise": repr(disturbance.noise),
        "dropped_at_rest": str(outcome.experiment.dropped).lower(),
        "spikes": f"{disturbance.spike_share!r},{disturbance.spike_noise!r}",
    }
    table = outcome.records[variant].table().replace_schema_metadata(metadata)
    pq.write_table(table, path, compression="zstd")
