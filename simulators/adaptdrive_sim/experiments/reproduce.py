"""`adaptdrive-sim reproduce`: an experiment of the paper from start to end."""

from __future__ import annotations

import dataclasses
import json
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from adaptdrive.errors import AdaptdriveError, RefusedError
from adaptdrive_sim.course import Run
from adaptdrive_sim.experiments.case import (
    Case,
    Design,
    Disturbance,
    Variant,
    case_settings,
    run_case,
)
from adaptdrive_sim.experiments.experiment import Experiment
from adaptdrive_sim.experiments.outcome import (
    ExperimentClaim,
    ExperimentOutcome,
    claims,
    judge,
    summary,
)
from adaptdrive_sim.experiments.published import BATH, DROPPED, MOTOR
from adaptdrive_sim.experiments.sweep import (
    listen,
    settings_over_forgetting,
    settings_over_tau_lambda,
    try_settings,
)
from adaptdrive_sim.parameters import SEED_MAX, check_range

VARIANTS: dict[str, tuple[Variant, ...]] = {
    "motor": ("fixed", "adaptive", "direct_rls"),
    "bath": ("fixed", "adaptive"),
}

_OTHER_STEPS = 4
_FIRST = ("time_s", "reference", "size", "output", "measured", "boost_reference_V", "applied_V")


class OutputError(AdaptdriveError):
    """The results cannot be written."""

    def __init__(self, folder: Path, problem: OSError) -> None:
        self.folder = folder
        self.problem = problem
        super().__init__(f"{folder}: {problem.strerror or problem}")


class RunError(AdaptdriveError):
    """A process that ran a controller has died."""


@dataclass(frozen=True, slots=True)
class ReproduceRequest:
    """Experiment to reproduce, and its options.

    Attributes:
        experiment: The experiment.
        design: The paper's controller or the daemon's default one.
        disturbance: Measurement noise.
        seed: Of the noise.
    """

    experiment: Experiment
    design: Design
    disturbance: Disturbance
    seed: int

    def __post_init__(self) -> None:
        check_range("seed", self.seed, 0, SEED_MAX, "")

    def case(self, variant: Variant) -> Case:
        """The run of one controller."""
        settings = case_settings(self.experiment, variant, self.design)
        return Case(self.experiment, variant, settings, self.disturbance, self.seed)

    def listener(self) -> Case:
        """The plain estimator that other settings are tried with; it always hears some noise."""
        settings = case_settings(self.experiment, "fixed", "paper")
        silent = self.disturbance.scaled(1.0).silent
        disturbance = Disturbance(self.experiment.noise) if silent else self.disturbance
        return Case(self.experiment, "fixed", settings, disturbance, self.seed)


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


def run_request(request: ReproduceRequest, folder: Path) -> list[ExperimentClaim]:
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
        _write_summary(folder, summary(outcome, found, time.perf_counter() - started_s))
    except OSError as problem:
        raise OutputError(folder, problem) from problem
    except BrokenProcessPool as problem:
        raise RunError(str(problem)) from problem
    return verdicts


def _carry_out(request: ReproduceRequest, folder: Path) -> ExperimentOutcome:
    """Run everything in parallel, and draw each figure as soon as its data is there."""
    experiment, variants = request.experiment, VARIANTS[request.experiment.name]
    with _pool(len(variants)) as pool, _progress(len(variants) + _OTHER_STEPS) as done:
        runs = {
            variant: pool.submit(run_case, request.case(variant), keep_ticks=variant == "fixed")
            for variant in variants
        }
        # Drawing takes a while to import: meanwhile the runs are under way.
        from adaptdrive_sim.experiments.figure import draw_experiment  # noqa: PLC0415
        from adaptdrive_sim.experiments.sweep_figure import draw_sweep  # noqa: PLC0415

        heard = listen(request.listener(), runs["fixed"].result())
        over_forgetting = pool.submit(try_settings, heard, settings_over_forgetting(experiment))
        over_tau_lambda = pool.submit(try_settings, heard, settings_over_tau_lambda(experiment))
        records: dict[Variant, Run] = {}
        for variant, run in runs.items():
            records[variant] = run.result()
            done(f"ran the {variant} controller")
        outcome = judge(experiment, request.design, request.disturbance, request.seed, records)
        draw_experiment(outcome, folder / "figure.png")
        done("drew the experiment")
        outcome = dataclasses.replace(
            outcome,
            over_forgetting=over_forgetting.result(),
            over_tau_lambda=over_tau_lambda.result(),
        )
        done("tried other settings of the estimator")
        draw_sweep(outcome, folder / "sweep.png")
        done("drew them")
    return outcome


def _pool(jobs: int) -> ProcessPoolExecutor:
    """Processes of their own that inherit nothing and end quietly on Ctrl-C."""
    return ProcessPoolExecutor(
        max_workers=min(jobs, os.cpu_count() or 1),
        mp_context=multiprocessing.get_context("spawn"),
        initializer=signal.signal,
        initargs=(signal.SIGINT, signal.SIG_DFL),
    )


@contextmanager
def _progress(steps: int) -> Iterator[Callable[[str], None]]:
    """Return a progress bar on a terminal, nothing in a pipe."""
    console = Console(stderr=True)
    columns = (BarColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
    with Progress(
        *columns, console=console, transient=True, disable=not sys.stderr.isatty()
    ) as bar:
        task = bar.add_task("running", total=steps)

        def done(what: str) -> None:
            bar.update(task, advance=1.0, description=what)

        yield done


def _write_summary(folder: Path, found: dict[str, Any]) -> None:
    text = json.dumps(found, indent=1, ensure_ascii=False, allow_nan=False)
    (folder / "summary.json").write_text(text + "\n", encoding="utf-8")


def _write_record(path: Path, outcome: ExperimentOutcome, variant: Variant) -> None:
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
    run, decisions = outcome.records[variant], outcome.records[variant].decisions
    columns: dict[str, Any] = {name: run[name] for name in _FIRST}
    columns |= {name: run[name] > 0.0 for name in ("adaptive", "accepted")}
    columns["reason"] = [one.reason for one in decisions]
    columns["gains"] = [list(one.gains) for one in decisions]
    columns["innovation"] = run["innovation"]
    columns["excitation"] = [one.excitation for one in decisions]
    names = decisions[0].estimates
    columns |= {name: [one.estimates[name].value for one in decisions] for name in names}
    columns |= {f"{name}_std": [one.estimates[name].std for one in decisions] for name in names}
    table = pa.table(columns).replace_schema_metadata(metadata)
    pq.write_table(table, path, compression="zstd")
