"""Short ways to the runs that several tests look at."""

from __future__ import annotations

from dataclasses import replace

from adaptdrive_sim.experiments.case import Case, Design, Variant, run_case
from adaptdrive_sim.experiments.experiment import MOTOR, Experiment, LoadChange
from adaptdrive_sim.experiments.outcome import Outcome, judge
from adaptdrive_sim.world import NoiseParameters

SEEDS = range(20)
SHORT_MOTOR = replace(
    MOTOR, duration_s=840.0, changes=(LoadChange(360.0, 2.0), LoadChange(600.0, 3.0))
)
"""The paper's experiment with the motor, in seven cycles in the place of eleven."""

SHORT_LAST_CYCLES = (2, 4, 6)
"""Of it, with one, two and three disks."""


def make_case(
    experiment: Experiment,
    variant: Variant,
    design: Design = "paper",
    disturbance: NoiseParameters | None = None,
    seed: int = 0,
) -> Case:
    """One run; under the published noise when none is given."""
    noise = disturbance or NoiseParameters(experiment.noise)
    return Case(experiment, design, noise, seed, variant)


def outcome(
    experiment: Experiment,
    variants: tuple[Variant, ...],
    disturbance: NoiseParameters | None = None,
    seed: int = 0,
) -> Outcome:
    """The experiment in the paper's design."""
    case = make_case(experiment, "fixed", "paper", disturbance, seed)
    return judge(case, {one: run_case(replace(case, variant=one)) for one in variants})
