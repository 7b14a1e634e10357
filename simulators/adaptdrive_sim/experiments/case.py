"""One run of an experiment: which controller, which design, which noise; and the run itself.

Both designs are the daemon's: the paper's is its `load.design = "paper"`. A run happens in virtual
time, as fast as it goes. It depends on its case alone, so it is the same each time.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from adaptdrive.app.settings import controller_settings
from adaptdrive.config.file import validate_configuration
from adaptdrive.control.controller import Controller
from adaptdrive.control.settings import ControllerSettings
from adaptdrive.control.signals import Mode
from adaptdrive_sim.course import Array, Course, Run
from adaptdrive_sim.experiments.examples import FOLDER
from adaptdrive_sim.experiments.experiment import Experiment
from adaptdrive_sim.noise import NoiseParameters, read_spikes, samples
from adaptdrive_sim.parameters import SEED_MAX, check_range
from adaptdrive_sim.site import Site
from adaptdrive_sim.world import World

Design = Literal["paper", "exact"]
Variant = Literal["fixed", "adaptive", "direct_rls", "lm_rls"]


@dataclass(frozen=True, slots=True)
class Disturbance:
    """Measurement noise of every fast sample; deviations are fractions of the reference step.

    Attributes:
        noise: Standard deviation of every sample.
        spike_share: Share of samples that carry a spike.
        spike_noise: Standard deviation of the spikes.
    """

    noise: float
    spike_share: float = 0.0
    spike_noise: float = 0.0

    def __post_init__(self) -> None:
        check_range("noise", self.noise, 0.0, 10.0, "of the step")
        check_range("share of spikes", self.spike_share, 0.0, 1.0, "")
        check_range("noise of spikes", self.spike_noise, 0.0, 10.0, "of the step")

    def scaled(self, step: float) -> NoiseParameters:
        """The same in the unit of the output."""
        return NoiseParameters(self.noise * step, self.spike_share, self.spike_noise * step)


def disturbance_of(noise: float, spikes: str) -> Disturbance:
    """Return the disturbance that a command line requests.

    Args:
        noise: Standard deviation of every sample, as a fraction of the step.
        spikes: RATE,SIGMA.

    Raises:
        RefusedError: The spikes cannot be read.
        ParameterError: A value lies outside its range.
    """
    return Disturbance(noise, *read_spikes(spikes))


@dataclass(frozen=True, slots=True)
class Case:
    """Everything that one run depends on.

    Attributes:
        experiment: What is done.
        variant: Which controller runs; `direct_rls` and `lm_rls` are adaptive ones with the
            estimator named, whatever the design's own is.
        settings: Settings of the controller.
        disturbance: Measurement noise.
        seed: Of the noise; runs with the same seed see the same noise.
    """

    experiment: Experiment
    variant: Variant
    settings: ControllerSettings
    disturbance: Disturbance
    seed: int


_METHODS = {"direct_rls": "rls", "lm_rls": "lm-rls"}


def case_settings(experiment: Experiment, variant: Variant, design: Design) -> ControllerSettings:
    """Settings of one controller of an experiment."""
    settings = paper_settings(experiment) if design == "paper" else _exact_settings(experiment)
    method = _METHODS.get(variant, settings.learning.method)
    learning = dataclasses.replace(settings.learning, method=method)
    return dataclasses.replace(settings, learning=learning)


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


def _exact_settings(experiment: Experiment) -> ControllerSettings:
    """The daemon's default controller, for an experiment that starts at rest."""
    settings = _from_tables(experiment, experiment.tables())
    return from_rest(settings, experiment.paper.warm_up_s, experiment.period_s)


def from_rest(
    settings: ControllerSettings, warm_up_s: float, period_s: float
) -> ControllerSettings:
    """Return settings for a run that starts at rest: the load's initial state is known.

    Args:
        settings: Of the daemon.
        warm_up_s: Time until adaptive control may begin.
        period_s: T_k.
    """
    learning = dataclasses.replace(settings.learning, settle_periods=0)
    jacket = dataclasses.replace(settings.jacket, warm_up_periods=round(warm_up_s / period_s))
    return dataclasses.replace(settings, learning=learning, jacket=jacket)


def paper_settings(experiment: Experiment) -> ControllerSettings:
    """The daemon's controller with the paper's design, and with the paper's numbers."""
    tables, paper = experiment.tables(), experiment.paper
    tables["load"]["design"] = "paper"
    tables["estimator"] = {
        "method": paper.method,
        "forgetting": paper.forgetting,
        "tau_lambda_s": paper.tau_lambda_s,
        "initial_covariance": paper.covariance,
    }
    tables["supervisor"] = {"warm_up_s": paper.warm_up_s}
    return _from_tables(experiment, tables)


def _from_tables(experiment: Experiment, tables: dict[str, Any]) -> ControllerSettings:
    source = FOLDER / f"{experiment.name}.toml"
    return controller_settings(validate_configuration(tables, source))


def run_case(case: Case, *, keep_ticks: bool = False) -> Run:
    """Run one case from start to end.

    Args:
        case: What to run.
        keep_ticks: Whether the record is to hold output and boost voltage of every tick.

    Returns:
        The run, with the columns `time_s`, `reference` and `size`.
    """
    experiment, course = case.experiment, _course(case)
    site = Site(Controller(case.settings, experiment.nominal()), World(experiment.plant()))
    run = site.run(course, keep_ticks=keep_ticks)
    times_s = experiment.times_s()
    sizes = experiment.sizes_at(times_s)
    return run.beside(time_s=np.array(times_s), reference=course.references, size=sizes)


def _course(case: Case) -> Course:
    experiment = case.experiment
    times_s = experiment.times_s()
    ticks = len(times_s) * case.settings.rates.ticks_per_period
    noise = case.disturbance.scaled(experiment.step)
    return Course(
        references=np.array([experiment.reference.value(time_s) for time_s in times_s]),
        sizes=experiment.sizes_at(times_s, wanted=True),
        over_s=max((change.over_s for change in experiment.changes), default=0.0),
        disturbances=_disturbances(noise, case.seed, ticks + 1),
        mode=Mode.FIXED if case.variant == "fixed" else Mode.ADAPTIVE,
        pole=experiment.pole,
        start=experiment.reference.low,
    )


def _disturbances(noise: NoiseParameters, seed: int, count: int) -> Array:
    if noise.silent:
        return np.zeros(count)
    return np.fromiter(samples(noise, np.random.default_rng(seed)), np.float64, count)
