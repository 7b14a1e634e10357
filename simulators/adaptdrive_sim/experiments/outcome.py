"""Outcome of an experiment: its metrics, and the estimator with other ρ and τ_λ than the paper's.

For the latter nothing is simulated again: the estimators run on one recorded run under the fixed
controller, once without noise, for the speed, and several times with it, for what the noise does to
them. Of the λ chains only the values at the slow instants are worked out.
"""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from adaptdrive.control.estimation import filters
from adaptdrive.control.estimation.direct import METHODS, DirectEstimator, continuous_model
from adaptdrive.control.estimation.estimator import LambdaEstimator
from adaptdrive.control.loads.discretise import held_model
from adaptdrive.control.loads.load import Load, to_input
from adaptdrive.control.settings import EstimatorSettings
from adaptdrive.control.vectors import Vector, shift_in
from adaptdrive_sim.course import Array, Run
from adaptdrive_sim.experiments import case as cases
from adaptdrive_sim.experiments.experiment import Experiment
from adaptdrive_sim.world import samples

# Speed and noise of the estimator, for other ρ and τ_λ than the paper's.

SETTLED = 0.02

_HORIZON = 20.0
_REALISATIONS = 3


@dataclass(frozen=True, slots=True)
class Recording:
    """Input of the estimators.

    Attributes:
        case: The run; its settings are the estimator's but for ρ and τ_λ.
        output: Output without noise at every tick.
        load_input: The load's input at every tick.
        held_input: The input that each slow period was given.
    """

    case: cases.Case
    output: Array
    load_input: Array
    held_input: list[float]


@dataclass(frozen=True, slots=True)
class SweepPoint:
    """Result of one setting of the estimator.

    Attributes:
        setting: The setting: method, ρ and τ_λ.
        cycles: Reference cycles until all estimates are within 5 % without noise; the slower one
            of the load changes, None when one is never followed.
        deviation: What noise adds to the estimates, as a fraction of them; root of the mean
            square over all parameters and the last cycle before each change and the end.
        transient: Largest distance of an estimate from the truth within one cycle after a change
            of the load, without noise, as a multiple of the truth.
    """

    setting: EstimatorSettings
    cycles: float | None
    deviation: float
    transient: float


def recording_of(case: cases.Case, record: Run) -> Recording:
    """Take what the estimators need from a run that kept its ticks."""
    load = case.experiment.nominal()
    gain, exponent = load.input_gain, load.input_exponent
    voltage_V = np.array(record.fast_voltage_V)
    held = [to_input(value, gain, exponent) for value in record["boost_reference_V"].tolist()]
    return Recording(case, np.array(record.fast_output), gain * voltage_V**exponent, held)


def settings_over_forgetting(case: cases.Case) -> list[EstimatorSettings]:
    """Every ρ at the paper's τ_λ."""
    sweep, tau_lambda_s = case.experiment.sweep, case.experiment.paper.tau_lambda_s
    return [
        setting(case, method, forgetting, tau_lambda_s)
        for method in sweep.methods
        for forgetting in sweep.forgetting
    ]


def settings_over_tau_lambda(case: cases.Case) -> list[EstimatorSettings]:
    """Every τ_λ at the paper's ρ."""
    forgetting = case.experiment.paper.forgetting
    taus_s = case.experiment.sweep.tau_lambda_s
    return [setting(case, "lm-rls", forgetting, tau_s) for tau_s in taus_s]


def setting(
    case: cases.Case, method: str, forgetting: float, tau_lambda_s: float
) -> EstimatorSettings:
    """Return the estimator's settings of a run with another method, ρ and τ_λ."""
    return dataclasses.replace(
        case.settings.learning, method=method, forgetting=forgetting, tau_lambda_s=tau_lambda_s
    )


def try_settings(given: Recording, settings: list[EstimatorSettings]) -> list[SweepPoint]:
    """See how settings of the estimator do."""
    outputs = [given.output, *(given.output + noise for noise in _noises(given))]
    return [_try_setting(given, outputs, one) for one in settings]


def settling_time_s(load: Load, tick_s: float) -> float:
    """Return the time after which the step response of a load stays within 2 % of its end."""
    a, b = held_model(list(load.numerator), list(load.denominator), tick_s, 0.0, 0.0)
    lags_s = load.denominator[load.order - 1] / load.denominator[load.order]
    outputs = [0.0] * (load.order + 1)
    for k in range(math.ceil(_HORIZON * lags_s / tick_s)):
        past = sum(a[i + 1] * outputs[-1 - i] for i in range(load.order))
        outputs.append(sum(b[: k + 2]) - past)
    error = np.array(outputs[load.order :]) * sum(a) / sum(b) - 1.0
    return float(np.flatnonzero(np.abs(error) > SETTLED)[-1] + 1) * tick_s


def _noises(given: Recording) -> list[Array]:
    """Noise of every tick, several times."""
    case, count = given.case, given.output.size
    parameters = case.disturbance.scaled(case.experiment.step)
    generators = [np.random.default_rng([case.seed, i]) for i in range(_REALISATIONS)]
    return [np.fromiter(samples(parameters, one), np.float64, count) for one in generators]


def _try_setting(given: Recording, outputs: list[Array], learning: EstimatorSettings) -> SweepPoint:
    if METHODS[learning.method].physical:
        quiet, *noisy = _estimate_filtered(given, learning, outputs)
    else:
        ticks = given.case.settings.rates.ticks_per_period
        quiet, *noisy = (_follow(given, learning, one[::ticks].tolist()) for one in outputs)
    experiment = given.case.experiment
    spread = _spread(given, quiet, noisy)
    return SweepPoint(learning, _speed(experiment, quiet), spread, _transient(experiment, quiet))


def _estimate_filtered(
    given: Recording, learning: EstimatorSettings, outputs: list[Array]
) -> list[Array]:
    """Physical parameters at every slow instant, from each output."""
    load, rates = given.case.experiment.nominal(), given.case.settings.rates
    ticks = rates.ticks_per_period
    tick_s = given.case.experiment.period_s / ticks
    chain = _chain(load.order, tick_s, learning.tau_lambda_s, ticks)
    inputs, *signals = (
        np.column_stack((one[::ticks], _sampled(chain, one))).tolist()
        for one in (given.load_input, *outputs)
    )
    return [_follow_filtered(load, learning, one, inputs) for one in signals]


def _follow_filtered(
    load: Load, learning: EstimatorSettings, outputs: list[list[float]], inputs: list[list[float]]
) -> Array:
    estimator, found = LambdaEstimator(learning, load, load.order), []
    for (target, *filtered), applied in zip(outputs, inputs, strict=True):
        estimator.regression.fill_signals(estimator.sample.regressor, filtered, applied)
        estimator.take_output(target, usable=True)
        found.append(_physical(load, *estimator.model()))
    return np.array(found)


def _follow(given: Recording, learning: EstimatorSettings, outputs: list[float]) -> Array:
    """Physical parameters by least squares on the samples of an output themselves."""
    load, period_s = given.case.experiment.nominal(), given.case.experiment.period_s
    estimator = DirectEstimator(learning, load, load.order)
    past_outputs = [outputs[0]] * load.order
    past_inputs = [float(given.load_input[0])] * load.order
    found = []
    for target, applied in zip(outputs, given.held_input, strict=True):
        estimator.fill(past_outputs, past_inputs)
        estimator.take_output(target, usable=True)
        b, a = estimator.model()
        found.append(_physical(load, *continuous_model(a, b, period_s)))
        shift_in(past_outputs, target)
        shift_in(past_inputs, applied)
    return np.array(found)


def _physical(load: Load, numerator: Vector, denominator: Vector) -> Vector:
    if not denominator[-1]:
        return [math.nan] * len(load.names)
    return load.physical(numerator, denominator)


def _chain(order: int, tick_s: float, tau_s: float, ticks: int) -> tuple[Array, Array]:
    """Weights of the values within a slow period, and the transition over it, of a λ chain."""
    decay, held, ramp = filters.chain_gains(order, tick_s, tau_s)
    rise = np.array(ramp)
    fall = np.array(held) - rise
    once = sum(decay[j] * np.eye(order, k=-j) for j in range(order))
    weights, over = np.zeros((order, ticks + 1)), np.eye(order)
    for tick in range(ticks - 1, -1, -1):
        weights[:, tick] += over @ fall
        weights[:, tick + 1] += over @ rise
        over = over @ once
    return weights, over


def _sampled(chain: tuple[Array, Array], signal: Array) -> Array:
    """The chain at the ticks 0, Q, 2Q, ..., having seen the first value for ever."""
    weights, over = chain
    ticks = weights.shape[1] - 1
    gained = sliding_window_view(signal, ticks + 1)[::ticks] @ weights.T
    values = np.full((len(gained) + 1, len(weights)), signal[0])
    for k in range(len(gained)):
        values[k + 1] = over @ values[k] + gained[k]
    return values


def _speed(experiment: Experiment, estimates: Array) -> float | None:
    found = [cases.cycles_until_right(experiment, estimates, one) for one in experiment.changes]
    known = [one for one in found if one is not None]
    return max(known, default=0.0) if len(known) == len(found) else None


def _spread(given: Recording, quiet: Array, noisy: list[Array]) -> float:
    experiment = given.case.experiment
    periods = round(experiment.reference.period_s / experiment.period_s)
    chosen = np.concatenate(
        [np.arange(-periods, 0) + round(end / experiment.period_s) for end in experiment.ends_s]
    )
    relative = np.array([(one[chosen] - quiet[chosen]) / quiet[chosen] for one in noisy])
    return float(np.sqrt(np.mean(relative * relative)))


def _transient(experiment: Experiment, estimates: Array) -> float:
    cycle = round(experiment.reference.period_s / experiment.period_s)
    firsts = [round(change.time_s / experiment.period_s) for change in experiment.changes]
    found = (cases.distances(experiment, estimates, first, first + cycle) for first in firsts)
    return max((float(np.nanmax(one)) for one in found), default=0.0)


# The outcome of an experiment.


@dataclass(frozen=True, slots=True)
class Outcome:
    """Everything that was found.

    Attributes:
        case: What all runs share.
        records: Recorded runs by controller.
        cycles: Metrics of each run by controller.
        converged: Cycles until the adaptive run's estimates were right, for each load change.
        over_forgetting: What other values of ρ do.
        over_tau_lambda: What other values of τ_λ do.
    """

    case: cases.Case
    records: dict[cases.Variant, Run]
    cycles: dict[cases.Variant, list[cases.Cycle]]
    converged: list[float | None]
    over_forgetting: list[SweepPoint] = dataclasses.field(default_factory=list)
    over_tau_lambda: list[SweepPoint] = dataclasses.field(default_factory=list)

    @property
    def experiment(self) -> Experiment:
        """What was done."""
        return self.case.experiment

    def model_error(self, variant: cases.Variant) -> float:
        """Root mean square of the model error, all but the first reference cycle.

        The cycles in which the speed drops with a disk are left out too: no controller can help.
        """
        drops = {one.time_s for one in self.experiment.changes if self.experiment.dropped}
        counted = [one for one in self.cycles[variant][1:] if one.start_s not in drops]
        squares = [one.model_error_rms * one.model_error_rms for one in counted]
        return math.sqrt(sum(squares) / len(squares))


def judge(case: cases.Case, records: dict[cases.Variant, Run]) -> Outcome:
    """Work out the metrics of all runs."""
    experiment, adaptive = case.experiment, records["adaptive"]
    judged = {one: cases.cycles(experiment, case.design, run) for one, run in records.items()}
    converged = [cases.convergence_cycles(experiment, adaptive, one) for one in experiment.changes]
    return Outcome(case, records, judged, converged)
