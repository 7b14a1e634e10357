"""From an estimate to gains: the model, its checks, and the design.

The checks run in the order of their cost; the first that fails gives the verdict.
"""

import math
from dataclasses import dataclass

from adaptdrive.control import thresholds, vectors
from adaptdrive.control.design import pole_placement
from adaptdrive.control.design.noise import Law, detuned_loop, fast_loop, noise_gain
from adaptdrive.control.design.pole_placement import Plant
from adaptdrive.control.estimation.direct import continuous_model
from adaptdrive.control.estimation.estimator import LambdaEstimator
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import ControllerSettings
from adaptdrive.control.signals import SlowSample
from adaptdrive.control.supervision import supervisor
from adaptdrive.control.supervision.state import SlowState
from adaptdrive.control.supervision.supervisor import Verdict
from adaptdrive.control.vectors import Vector


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A design that waits for its verdict.

    Attributes:
        plant: Discrete model of the estimate.
        quiet: A_c of the quiet law.
        possible: Discrete models within the covariance of the estimate, empty where that is not
            known; None where the design does not ask for them.
    """

    plant: Plant
    quiet: Vector
    possible: list[Plant] | None


def adapt(settings: ControllerSettings, load: Load, state: SlowState, sample: SlowSample) -> None:
    """Judge the estimate and, if it is trusted, make gains of it."""
    verdict, candidate = _judged(settings, load, state, sample)
    _look_for_a_way_back(settings, load, state)
    periods = state.estimator.periods
    state.accepted = state.supervisor.take_verdict(verdict, periods, in_force=state.adaptive)
    taken = state.accepted or _is_recalled(settings, state, verdict)
    if taken and candidate is not None:
        state.law = _law(settings, state, candidate, sample.pole)
        state.reference_filter.asked = state.law.asked
        state.reference_filter.loop = candidate.quiet


def _is_recalled(settings: ControllerSettings, state: SlowState, verdict: int) -> bool:
    """Return whether gains follow from what a run before this one had trusted.

    They act from the first slow period on, and as long as nothing is learnt they fit the noise as
    it becomes known.
    """
    unchanged = state.estimator.periods <= max(1, settings.learning.settle_periods)
    possible = verdict == Verdict.TRUSTED or supervisor.is_uncertain(verdict)
    state.recalled = state.recalled and unchanged and possible
    state.supervisor.trusted = state.supervisor.trusted or state.recalled
    return state.recalled


def _look_for_a_way_back(settings: ControllerSettings, load: Load, state: SlowState) -> None:
    """Let an estimate that cannot be right for as long as it remembers begin anew."""
    estimator = state.estimator
    if not (settings.learning.alert and isinstance(estimator, LambdaEstimator)):
        return
    numerator, denominator = estimator.regression.model(estimator.estimate.theta)
    verdict = supervisor.judge_model(numerator, denominator)
    if verdict == Verdict.TRUSTED:
        values = load.physical(numerator, denominator)
        verdict = state.supervisor.judge_parameters(values, denominator)
    estimator.lost_periods = 0 if verdict == Verdict.TRUSTED else estimator.lost_periods + 1
    if estimator.lost_periods > thresholds.MEMORY:
        estimator.lost_periods = 0
        estimator.begin_anew()


def _judged(
    settings: ControllerSettings, load: Load, state: SlowState, sample: SlowSample
) -> tuple[int, _Candidate | None]:
    """Return the verdict on this period's estimate, and the design that has been made of it."""
    a, b, verdict = judged_model(settings, load, state, sample.period_s)
    if verdict != Verdict.TRUSTED:
        return verdict, None
    noise, limit = output_noise(settings, state, thresholds.NOISE_FLOOR), settings.supervision
    plant = Plant(a, b)
    quiet = detuned_loop(plant, sample.pole, noise, limit.noise_max)
    verdict = supervisor.judge_poles(plant.closed(plant.gains(quiet)), Verdict.UNSTABLE_LOOP)
    if verdict != Verdict.TRUSTED:
        return verdict, None
    possible: list[Plant] | None = None
    if limit.spread_max > 0.0 and state.estimator.physical:
        root = state.estimator.root(state.values)
        possible = pole_placement.possible_plants(
            settings, load, state.values, root, sample.period_s
        )
        state.spread = plant.response_spread(possible, quiet, sample.pole)
        if vectors.exceeds(state.spread, limit.spread_max):
            verdict = Verdict.UNCERTAIN
    return verdict, _Candidate(plant, quiet, possible)


def _law(settings: ControllerSettings, state: SlowState, candidate: _Candidate, pole: float) -> Law:
    """Design the fast law; the quiet one acts where the covariance leaves the fast one unsure."""
    plant, quiet, limits = candidate.plant, candidate.quiet, settings.supervision
    fast = fast_loop(plant, pole, quiet, output_noise(settings, state, 0.0), limits.noise_max)
    if candidate.possible is not None:
        spread = plant.response_spread(candidate.possible, fast, pole)
        fast = quiet if vectors.exceeds(spread, limits.spread_max) else fast
    least = thresholds.NOISE_FLOOR
    return Law(
        plant=plant,
        asked=plant.asked(pole),
        quiet_gains=plant.gains(quiet),
        fast_loop=fast,
        fast_gains=plant.gains(fast),
        quiet_noise=_input_noise(settings, state, plant, quiet, least),
        fast_noise=_input_noise(settings, state, plant, fast, 0.0),
    )


def output_noise(settings: ControllerSettings, state: SlowState, least: float) -> float:
    """σ_y of a slow sample: what a disturbance or an error of the estimate adds is not in it.

    At rest a rounded output stands still, and seems to have no noise.

    Args:
        settings: Scales.
        state: The estimate.
        least: Least σ_y², in the units of the scaled output.
    """
    estimator = state.estimator
    if not estimator.physical:
        return 0.0
    seen = math.sqrt(max(least, estimator.detector.noise))
    return max(seen, estimator.sample.rounding) * settings.learning.output_scale


def _input_noise(
    settings: ControllerSettings, state: SlowState, plant: Plant, loop: Vector, least: float
) -> float:
    """σ_u of a loop, at most its limit; 0 where there is no limit."""
    limit = settings.supervision.noise_max
    if not limit > 0.0:
        return 0.0
    return min(limit, noise_gain(plant, loop) * output_noise(settings, state, least))


def judged_model(
    settings: ControllerSettings, load: Load, state: SlowState, period_s: float
) -> tuple[Vector, Vector, int]:
    """Return A and B of the estimate, which count only if trusted, and the verdict on them.

    Args:
        settings: Designs, rates and rules.
        load: The nominal model and the meaning of the parameters.
        state: The estimate; the physical parameters that are published are overwritten.
        period_s: T_k in s.
    """
    estimator, judge = state.estimator, state.supervisor
    numerator, denominator = estimator.model()
    if not estimator.physical:
        _show(load, state, numerator, denominator, period_s)
        return denominator, numerator, supervisor.judge_poles(denominator, Verdict.UNSTABLE_LOAD)
    verdict = supervisor.judge_model(numerator, denominator)
    if verdict == Verdict.TRUSTED:
        state.values = load.physical(numerator, denominator)
        verdict = judge.judge_parameters(state.values, denominator)
    if verdict == Verdict.TRUSTED:
        verdict = judge.judge_residual()
    if verdict != Verdict.TRUSTED:
        return denominator, numerator, verdict
    a, b = pole_placement.discrete_model(settings, load, numerator, denominator, period_s)
    return a, b, supervisor.judge_poles(a, Verdict.UNSTABLE_LOAD)


def _show(load: Load, state: SlowState, b: Vector, a: Vector, period_s: float) -> None:
    """Make the physical parameters that are published; NaN where the model has none."""
    numerator, denominator = continuous_model(a, b, period_s)
    state.values = [math.nan] * len(state.values)
    if supervisor.judge_model(numerator, denominator) == Verdict.TRUSTED:
        state.values = load.physical(numerator, denominator)
