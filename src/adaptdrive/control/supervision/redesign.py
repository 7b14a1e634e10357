"""From an estimate to gains: the model, its checks, and the design.

The checks run in the order of their cost; the first that fails gives the verdict.
"""

import math

from adaptdrive.control import thresholds, vectors
from adaptdrive.control.design import pole_placement
from adaptdrive.control.design.noise import detuned_loop, fast_loop, noise_gain
from adaptdrive.control.estimation import methods, regression
from adaptdrive.control.estimation.estimator import begin_anew
from adaptdrive.control.estimation.regression import SlowSample
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import ControllerSettings
from adaptdrive.control.supervision import supervisor
from adaptdrive.control.supervision.state import SlowState
from adaptdrive.control.vectors import Vector


def adapt(settings: ControllerSettings, load: Load, state: SlowState, sample: SlowSample) -> None:
    """Judge the estimate and, if it is trusted, make gains of it."""
    gains = [0.0] * len(state.adaptive_gains)
    verdict = _redesign(settings, load, state, sample, gains)
    _look_for_a_way_back(settings, load, state)
    periods = state.estimator.periods
    state.accepted = supervisor.take_verdict(
        state.supervisor, verdict, settings.supervision, periods, state.adaptive
    )
    if state.accepted or _is_recalled(settings, state, verdict):
        vectors.copy_into(state.adaptive_gains, gains)
        _take_loop(load, state, sample.pole)
        _take_fast_law(settings, state, sample)
        state.trusted_a, state.trusted_b = state.model_a, state.model_b
        state.input_noise = _input_noise(settings, state, state.new_loop, thresholds.NOISE_FLOOR)
        state.fast_noise = _input_noise(settings, state, state.fast_loop, 0.0)


def _is_recalled(settings: ControllerSettings, state: SlowState, verdict: int) -> bool:
    """Return whether gains follow from what a run before this one had trusted.

    They act from the first slow period on, and as long as nothing is learnt they fit the noise as
    it becomes known.
    """
    unchanged = state.estimator.periods <= max(1, settings.learning.settle_periods)
    possible = verdict == supervisor.Verdict.TRUSTED or supervisor.is_uncertain(verdict)
    state.recalled = state.recalled and unchanged and possible
    state.supervisor.trusted = state.supervisor.trusted or state.recalled
    return state.recalled


def _look_for_a_way_back(settings: ControllerSettings, load: Load, state: SlowState) -> None:
    """Let an estimate that cannot be right for as long as it remembers begin anew."""
    estimator, learning = state.estimator, settings.learning
    if not (learning.alert and estimator.method.physical):
        return
    model = regression.filtered_model(estimator.estimate.theta, learning, load)
    verdict = _judge_parameters(
        settings, load, state.nominal, model, list(state.values), supervisor.SupervisorState()
    )
    possible = verdict == supervisor.Verdict.TRUSTED
    estimator.lost_periods = 0 if possible else estimator.lost_periods + 1
    if estimator.lost_periods > thresholds.MEMORY:
        estimator.lost_periods = 0
        begin_anew(estimator, learning, load)


def _take_loop(load: Load, state: SlowState, pole: float) -> None:
    """Make the reference filter fit the gains."""
    target = state.reference_filter
    vectors.copy_into(target.asked, pole_placement.asked_loop(state.model_b, load.order, pole))
    vectors.copy_into(target.loop, state.new_loop)


def _take_fast_law(settings: ControllerSettings, state: SlowState, sample: SlowSample) -> None:
    """Take over the fast law, or the quiet one where the covariance leaves the fast one unsure."""
    a, b, quiet, solved = state.model_a, state.model_b, state.new_loop, state.equation
    noise, limit = _output_noise(settings, state, 0.0), settings.supervision.noise_max
    loop = fast_loop(solved, a, b, sample.pole, quiet, noise, limit, state.circle)
    gains = pole_placement.loop_gains(solved, a, b, loop)
    most = settings.supervision.spread_max
    if most > 0.0 and vectors.exceeds(_spread(state, gains, loop, sample.pole), most):
        loop, gains = quiet, pole_placement.loop_gains(solved, a, b, quiet)
    vectors.copy_into(state.fast_loop, loop)
    vectors.copy_into(state.fast_gains, gains)


def _output_noise(
    settings: ControllerSettings, state: SlowState, least: float = thresholds.NOISE_FLOOR
) -> float:
    """σ_y of a slow sample: what a disturbance or an error of the estimate adds is not in it.

    At rest a rounded output stands still, and seems to have no noise.

    Args:
        settings: Designs, rates and rules.
        state: The estimate.
        least: Least σ_y², in the units of the scaled output.
    """
    if not state.estimator.method.physical:
        return 0.0
    estimator = state.estimator
    seen = math.sqrt(max(least, estimator.detector.noise))
    return max(seen, estimator.sample.rounding) * settings.learning.output_scale


def _input_noise(
    settings: ControllerSettings, state: SlowState, loop: Vector, least: float
) -> float:
    """σ_u of a loop, at most its limit; 0 where there is no limit."""
    limit = settings.supervision.noise_max
    if not limit > 0.0:
        return 0.0
    gain = noise_gain(state.equation, state.model_a, state.model_b, loop)
    return min(limit, gain * _output_noise(settings, state, least))


def _redesign(
    settings: ControllerSettings, load: Load, state: SlowState, sample: SlowSample, gains: Vector
) -> int:
    a, b, verdict = judged_model(settings, load, state, sample.period_s)
    if verdict != supervisor.Verdict.TRUSTED:
        return verdict
    limit = settings.supervision.noise_max
    noise, solved = _output_noise(settings, state), pole_placement.equation(a, b)
    vectors.copy_into(state.new_loop, detuned_loop(solved, a, b, sample.pole, noise, limit))
    vectors.copy_into(gains, pole_placement.loop_gains(solved, a, b, state.new_loop))
    closed = pole_placement.closed_loop(gains, a, b)
    verdict = supervisor.judge_poles(closed, supervisor.Verdict.UNSTABLE_LOOP)
    if verdict != supervisor.Verdict.TRUSTED:
        return verdict
    state.model_a, state.model_b, state.equation = a, b, solved
    return _judge_response(settings, load, state, gains, sample)


def _judge_response(
    settings: ControllerSettings, load: Load, state: SlowState, gains: Vector, sample: SlowSample
) -> int:
    """Check how far the response may be off within the covariance of the estimate."""
    limit, learning = settings.supervision.spread_max, settings.learning
    if not (limit > 0.0 and state.estimator.method.physical):
        return supervisor.Verdict.TRUSTED
    root = state.estimator.method.root(state.estimator, learning, load, state.values)
    models = pole_placement.possible_models(settings, load, state.values, root, sample.period_s)
    vectors.copy_into(state.possible, models)
    state.spread = _spread(state, gains, state.new_loop, sample.pole)
    return supervisor.Verdict.TRUSTED if state.spread <= limit else supervisor.Verdict.UNCERTAIN


def _spread(state: SlowState, gains: Vector, loop: Vector, pole: float) -> float:
    """Return how far the response may be off within the covariance of the estimate; 0 for none."""
    if not state.estimator.method.physical:
        return 0.0
    return pole_placement.response_spread(state.possible, gains, loop, state.model_b, pole)


def _judge_parameters(
    settings: ControllerSettings,
    load: Load,
    nominal: Vector,
    model: tuple[Vector, Vector],
    values: Vector,
    memory: supervisor.SupervisorState,
) -> int:
    """Check whether a load can have a model in s: with a dc gain, within its bounds, damped.

    Args:
        settings: Limits of the supervisor.
        load: The meaning of the parameters.
        nominal: Nominal parameters.
        model: Numerator and denominator, highest power first.
        values: Parameters of the model, overwritten where it has a dc gain.
        memory: Index of the parameter that is out of bounds, overwritten.
    """
    numerator, denominator = model
    verdict = supervisor.judge_model(numerator, denominator)
    if verdict != supervisor.Verdict.TRUSTED:
        return verdict
    vectors.copy_into(values, load.physical(numerator, denominator))
    verdict = supervisor.judge_bounds(values, nominal, settings.supervision, memory)
    if verdict != supervisor.Verdict.TRUSTED:
        return verdict
    return supervisor.judge_damping(denominator, settings.supervision)


def judge_physical(
    settings: ControllerSettings,
    load: Load,
    state: SlowState,
    numerator: Vector,
    denominator: Vector,
    period_s: float,
) -> tuple[Vector, Vector, int]:
    """Check the physical parameters of an estimated model in s.

    Args:
        settings: Designs, rates and rules.
        load: The nominal model and the meaning of the parameters.
        state: The estimate; its physical parameters are overwritten.
        numerator: Of the estimated model, highest power first.
        denominator: Of the estimated model, highest power first.
        period_s: T_k in s.

    Returns:
        A and B of the discrete model, and the verdict; the polynomials count only if trusted.
    """
    model = numerator, denominator
    verdict = _judge_parameters(
        settings, load, state.nominal, model, state.values, state.supervisor
    )
    if verdict == supervisor.Verdict.TRUSTED:
        verdict = supervisor.judge_residual(state.supervisor, settings.supervision)
    if verdict != supervisor.Verdict.TRUSTED:
        return denominator, numerator, verdict
    a, b = pole_placement.discrete_model(settings, load, numerator, denominator, period_s)
    return a, b, supervisor.judge_poles(a, supervisor.Verdict.UNSTABLE_LOAD)


def judged_model(
    settings: ControllerSettings, load: Load, state: SlowState, period_s: float
) -> tuple[Vector, Vector, int]:
    """Return A and B of the estimate, and the verdict on its parameters."""
    estimator = state.estimator
    numerator, denominator = estimator.method.model(estimator, settings.learning, load)
    if estimator.method.physical:
        return judge_physical(settings, load, state, numerator, denominator, period_s)
    a, b = denominator, numerator
    _show(load, state, a, b, period_s)
    return a, b, supervisor.judge_poles(a, supervisor.Verdict.UNSTABLE_LOAD)


def _show(load: Load, state: SlowState, a: Vector, b: Vector, period_s: float) -> None:
    """Make the physical parameters that are published; NaN where the model has none."""
    numerator, denominator = methods.continuous_model(a, b, period_s)
    if supervisor.judge_model(numerator, denominator) == supervisor.Verdict.TRUSTED:
        vectors.copy_into(state.values, load.physical(numerator, denominator))
    else:
        vectors.copy_into(state.values, [math.nan] * len(state.values))
