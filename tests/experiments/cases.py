"""Short ways to the runs that several tests look at."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor

from adaptdrive_sim.course import Run
from adaptdrive_sim.experiments.case import (
    Case,
    Design,
    Disturbance,
    ReproduceRequest,
    Variant,
    case_settings,
    run_case,
)
from adaptdrive_sim.experiments.experiment import Experiment
from adaptdrive_sim.experiments.outcome import ExperimentOutcome, judge

SEEDS = range(20)


def make_case(
    experiment: Experiment,
    variant: Variant,
    design: Design = "paper",
    disturbance: Disturbance | None = None,
    seed: int = 0,
) -> Case:
    """One run; under the published noise when none is given."""
    noise = disturbance or Disturbance(experiment.noise)
    return Case(experiment, variant, case_settings(experiment, variant, design), noise, seed)


def run_all(cases: Iterable[Case]) -> list[Run]:
    """Run many cases on all processors, in order."""
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as pool:
        return list(pool.map(run_case, cases))


def run_all_compiled(cases: Iterable[Case]) -> list[Run]:
    """The same on compiled code, for many cases of one kind."""
    return [run_case(case, compiled=True) for case in cases]


def outcomes(
    experiment: Experiment,
    variants: tuple[Variant, ...],
    disturbance: Disturbance | None = None,
    seeds: Iterable[int] = SEEDS,
    run: Callable[[Iterable[Case]], list[Run]] = run_all,
) -> list[ExperimentOutcome]:
    """The experiment in the paper's design, once for each seed."""
    noise = disturbance or Disturbance(experiment.noise)
    wanted = [(seed, variant) for seed in seeds for variant in variants]
    cases = [make_case(experiment, variant, "paper", noise, seed) for seed, variant in wanted]
    records = dict(zip(wanted, run(cases), strict=True))
    return [
        judge(
            ReproduceRequest(experiment, "paper", noise, seed),
            {variant: records[seed, variant] for variant in variants},
        )
        for seed in dict.fromkeys(seed for seed, _ in wanted)
    ]
