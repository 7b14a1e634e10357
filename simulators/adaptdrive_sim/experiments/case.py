"""One run of an experiment, and metrics of it.

Both designs are the daemon's: the paper's is its `load.design = "paper"`. A run happens in virtual
time, as fast as it goes. It depends on its case alone, so it is the same each time.

They compare with the closed loop as it was designed: the true load, no limits, no delays, no noise.

With the model A y = B u of the true load the design makes

    A_m y = A_m(1)/B(1) · B r

(27) and (15) in the paper's design; in the exact one B has the zero of the held load. All poles of
A_m are where the design wants them, so that a larger load changes B's zero at most.
"""

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from adaptdrive.analysis.curves import judge_step
from adaptdrive.app.settings import controller_settings
from adaptdrive.config.file import validate_configuration
from adaptdrive.control import controller, signals
from adaptdrive.control.settings import ControllerSettings
from adaptdrive.util.errors import RefusedError
from adaptdrive_sim import parameters, world
from adaptdrive_sim.course import Array, Course, Run, follow_ideal
from adaptdrive_sim.experiments.experiment import Experiment, LoadChange
from adaptdrive_sim.parameters import EXAMPLES
from adaptdrive_sim.site import Site

# One run of an experiment: which controller, which design, which noise; and the run itself.

Design = Literal["paper", "exact"]
Variant = Literal["fixed", "adaptive", "direct_rls", "lm_rls"]


def disturbance_of(noise: float, spikes: str) -> world.NoiseParameters:
    """Return the measurement noise that a command line requests, as fractions of the step.

    Args:
        noise: Standard deviation of every sample.
        spikes: RATE,SIGMA.

    Raises:
        RefusedError: The spikes cannot be read.
        ParameterError: A value lies outside its range.
    """
    try:
        share, sigma = (float(part) for part in spikes.split(","))
    except ValueError as problem:
        raise RefusedError(f"spikes {spikes!r} is not RATE,SIGMA") from problem
    parameters.check_range("noise", noise, 0.0, 10.0, "of the step")
    parameters.check_range("share of spikes", share, 0.0, 1.0, "")
    parameters.check_range("noise of spikes", sigma, 0.0, 10.0, "of the step")
    return world.NoiseParameters(noise, share, sigma)


_METHODS = {"direct_rls": "rls", "lm_rls": "lm-rls"}


@dataclass(frozen=True, slots=True)
class Case:
    """Everything that one run depends on.

    Attributes:
        experiment: What is done.
        design: The paper's controller or the daemon's default one.
        disturbance: Measurement noise, as fractions of the reference step.
        seed: Of the noise; runs with the same seed see the same noise.
        variant: Which controller runs; `direct_rls` and `lm_rls` are adaptive ones with the
            estimator named, whatever the design's own is.
    """

    experiment: Experiment
    design: Design
    disturbance: world.NoiseParameters
    seed: int
    variant: Variant = "fixed"

    def __post_init__(self) -> None:
        parameters.check_range("seed", self.seed, 0, parameters.SEED_MAX, "")

    @property
    def settings(self) -> ControllerSettings:
        """Settings of the controller."""
        experiment = self.experiment
        if self.design == "paper":
            settings = paper_settings(experiment)
        else:
            settings = _from_tables(experiment, experiment.tables())
            settings = from_rest(settings, experiment.paper.warm_up_s, experiment.period_s)
        method = _METHODS.get(self.variant, settings.learning.method)
        learning = dataclasses.replace(settings.learning, method=method)
        return dataclasses.replace(settings, learning=learning)

    def sweep(self) -> "Case":
        """The run on which other settings of the estimator are tried; there always is noise."""
        noise = self.disturbance
        if noise.silent:
            noise = world.NoiseParameters(self.experiment.noise)
        return dataclasses.replace(self, design="paper", variant="fixed", disturbance=noise)


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
    periods = round(warm_up_s / period_s)
    supervision = dataclasses.replace(settings.supervision, warm_up_periods=periods)
    return dataclasses.replace(settings, learning=learning, supervision=supervision)


def paper_settings(experiment: Experiment) -> ControllerSettings:
    """The daemon's controller with the paper's design, and with the paper's numbers."""
    tables, paper = experiment.tables(), experiment.paper
    tables["load"]["design"] = "paper"
    tables["estimator"] = {
        "method": paper.method,
        "forgetting": paper.forgetting,
        "tau_lambda_s": paper.tau_lambda_s,
    }
    tables["supervisor"] = {"warm_up_s": paper.warm_up_s}
    return _from_tables(experiment, tables)


def _from_tables(experiment: Experiment, tables: dict[str, Any]) -> ControllerSettings:
    source = EXAMPLES / f"{experiment.name}.toml"
    return controller_settings(validate_configuration(tables, source))


def run_case(case: Case, *, keep_ticks: bool = False) -> Run:
    """Run one case from start to end.

    Args:
        case: What to run.
        keep_ticks: Whether the record is to hold output and boost voltage of every tick.

    Returns:
        The run, with the columns `time_s`, `reference` and `size`.
    """
    experiment, settings = case.experiment, case.settings
    course = _course(case, settings.rates.ticks_per_period)
    control = controller.Controller(settings, experiment.nominal())
    run = Site(control, world.World(experiment.plant())).run(course, keep_ticks=keep_ticks)
    times_s = experiment.times_s()
    sizes = experiment.sizes_at(times_s)
    return run.beside(time_s=np.array(times_s), reference=course.references, size=sizes)


def _course(case: Case, ticks_per_period: int) -> Course:
    experiment = case.experiment
    times_s = experiment.times_s()
    ticks = len(times_s) * ticks_per_period
    noise, disturbances = case.disturbance.scaled(experiment.step), np.zeros(ticks + 1)
    if not noise.silent:
        drawn = world.samples(noise, np.random.default_rng(case.seed))
        disturbances = np.fromiter(drawn, np.float64, ticks + 1)
    return Course(
        references=np.array([experiment.reference.value(time_s) for time_s in times_s]),
        sizes=experiment.sizes_at(times_s, wanted=True),
        over_s=max((change.over_s for change in experiment.changes), default=0.0),
        disturbances=disturbances,
        mode=signals.Mode.FIXED if case.variant == "fixed" else signals.Mode.ADAPTIVE,
        pole=experiment.pole,
        start=experiment.reference.low,
    )


# Metrics of an experiment, always from the output without noise at the slow instants.

CONVERGED = 0.05


@dataclass(frozen=True, slots=True)
class Cycle:
    """One reference cycle.

    Attributes:
        start_s: Its start.
        load: Size of the load at its end, as a multiple of the nominal one.
        overshoot: The larger one of its two half cycles, as a fraction of the step.
        settling_s: Time until the output stays within 5 % of the step; the longer one of its two
            half cycles, None when a half cycle ends before.
        model_error_rms: Deviation from the ideal closed loop, as a fraction of the step.
    """

    start_s: float
    load: float
    overshoot: float
    settling_s: float | None
    model_error_rms: float


def cycles(experiment: Experiment, design: Design, record: Run) -> list[Cycle]:
    """Judge every reference cycle of a run."""
    errors = model_errors(experiment, design, record)
    return [_cycle(experiment, record, errors, start_s) for start_s in experiment.cycle_starts()]


def model_errors(experiment: Experiment, design: Design, record: Run) -> Array:
    """Deviation from the ideal closed loop at each slow instant, as a fraction of the step."""
    return (record["output"] - ideal_output(experiment, design)) / experiment.step


def ideal_output(experiment: Experiment, design: Design) -> Array:
    """Output of the ideal loop at every slow instant, from rest on the lower reference."""
    times_s, reference = experiment.times_s(), experiment.reference
    references = np.array([reference.low, *(reference.value(time_s) for time_s in times_s)])
    loads = [experiment.true_load(float(size)) for size in experiment.sizes_at([0.0, *times_s])]
    pole, period_s, paper = experiment.pole, experiment.period_s, design == "paper"
    return follow_ideal(references, loads, pole, period_s, paper=paper)[1:]


def rms_between(record: Run, errors: Array, first_s: float, last_s: float) -> float:
    """Root of the mean square over first <= t < last."""
    values = errors[_between(record, first_s, last_s)]
    return float(np.sqrt(np.mean(values * values)))


def _cycle(experiment: Experiment, record: Run, errors: Array, start_s: float) -> Cycle:
    half_s = 0.5 * experiment.reference.period_s
    end_s = min(start_s + 2.0 * half_s, experiment.duration_s)
    begins_s = [one for one in (start_s, start_s + half_s) if one < end_s]
    halves = [_half(experiment, record, one, min(one + half_s, end_s)) for one in begins_s]
    overshoot, settling_s = (max(one) for one in zip(*halves, strict=True))
    return Cycle(
        start_s=start_s,
        load=experiment.size_at(math.nextafter(end_s, start_s)),
        overshoot=overshoot,
        settling_s=settling_s if math.isfinite(settling_s) else None,
        model_error_rms=rms_between(record, errors, start_s, end_s),
    )


def _half(experiment: Experiment, run: Run, first_s: float, last_s: float) -> tuple[float, float]:
    """Overshoot, and settling time or infinity, of one half cycle."""
    reference, target = experiment.reference, experiment.reference.value(first_s)
    before = reference.low + reference.high - target
    outputs = run["output"][_between(run, first_s, last_s)]
    overshoot, periods = judge_step(outputs, before, target)
    return overshoot, periods * experiment.period_s


def convergence_cycles(experiment: Experiment, record: Run, change: LoadChange) -> float | None:
    """Return `cycles_until_right` of an adaptive run."""
    return cycles_until_right(experiment, estimates_of(experiment, record), change)


def estimates_of(experiment: Experiment, record: Run) -> Array:
    """Return the estimates of a run, a row for each slow period."""
    return np.column_stack([record[name] for name in experiment.nominal().names])


def cycles_until_right(
    experiment: Experiment, estimates: Array, change: LoadChange
) -> float | None:
    """Reference cycles until every estimate is within 5 % of the truth and stays so.

    Args:
        experiment: What was done.
        estimates: A row for each slow period.
        change: The load change after which to look; only until the next one.

    Returns:
        None when the estimates never get there.
    """
    end_s = min(one for one in experiment.ends_s if one > change.time_s)
    first, last = (round(time_s / experiment.period_s) for time_s in (change.time_s, end_s))
    with np.errstate(invalid="ignore"):
        good = np.all(distances(experiment, estimates, first, last) <= CONVERGED, axis=1)
    bad = np.flatnonzero(~good)
    settled = int(bad[-1]) + 1 if bad.size else 0
    if settled == good.size:
        return None
    return settled * experiment.period_s / experiment.reference.period_s


def distances(experiment: Experiment, estimates: Array, first: int, last: int) -> Array:
    """Return the distances of estimates from the truth over some slow periods, relative to it."""
    truth = [experiment.truth_at(k * experiment.period_s) for k in range(first, last)]
    found: Array = np.abs(estimates[first:last] / np.array(truth) - 1.0)
    return found


def _between(record: Run, first_s: float, last_s: float) -> NDArray[np.bool_]:
    times = record["time_s"]
    return (times >= first_s) & (times < last_s)


def estimate_moves(experiment: Experiment, record: Run) -> dict[str, float]:
    """Return the smallest move of each estimate among the load changes, relative to its value.

    A move is the largest distance from the last value before the change, within one cycle after
    it.
    """
    estimates = estimates_of(experiment, record)
    periods = round(experiment.reference.period_s / experiment.period_s)
    firsts = [round(change.time_s / experiment.period_s) for change in experiment.changes]
    moves = [estimates[first : first + periods] / estimates[first - 1] - 1.0 for first in firsts]
    least = np.min([np.max(np.abs(one), axis=0) for one in moves], axis=0)
    return dict(zip(experiment.nominal().names, least.tolist(), strict=True))
