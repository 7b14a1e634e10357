"""Speed and noise of the estimator, for other ρ and τ_λ than the paper's.

Nothing is simulated again: the estimators listen to one recorded run under the fixed controller,
once without noise, for the speed, and several times with it, for what the noise does to them. The
λ chains are linear, so that signal and noise pass them apart, and only their values at the slow
instants are worked out.
"""

import dataclasses
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from adaptdrive.control.estimation import estimator as est
from adaptdrive.control.estimation import methods
from adaptdrive.control.estimation import regression as reg
from adaptdrive.control.estimation.filters import chain_decay, ramp_gains, step_gains
from adaptdrive.control.loads.discretise import held_model
from adaptdrive.control.loads.load import Load, to_input
from adaptdrive.control.settings import EstimatorSettings
from adaptdrive.control.vectors import Vector, shift_in
from adaptdrive_sim.course import Array, Run
from adaptdrive_sim.experiments.case import Case, cycles_until_right, distances
from adaptdrive_sim.experiments.experiment import Experiment
from adaptdrive_sim.wire import samples

SETTLED = 0.02

_HORIZON = 20.0
_REALISATIONS = 3


Method = Literal["lm-rls", "rls"]


@dataclass(frozen=True, slots=True)
class Heard:
    """Input of the estimators.

    Attributes:
        case: The run; its settings are the estimator's but for ρ and τ_λ.
        output: Output without noise at every tick.
        load_input: The load's input at every tick.
        held_input: The input that each slow period was given.
    """

    case: Case
    output: Array
    load_input: Array
    held_input: list[float]


@dataclass(frozen=True, slots=True)
class Setting:
    """A setting of the estimator."""

    method: Method
    forgetting: float
    tau_lambda_s: float


@dataclass(frozen=True, slots=True)
class SweepPoint:
    """Result of one setting of the estimator.

    Attributes:
        setting: The setting.
        cycles: Reference cycles until all estimates are within 5 % without noise; the slower one
            of the load changes, None when one is never followed.
        deviation: What noise adds to the estimates, as a fraction of them; root of the mean
            square over all parameters and the last cycle before each change and the end.
        transient: Largest distance of an estimate from the truth within one cycle after a change
            of the load, without noise, as a multiple of the truth.
    """

    setting: Setting
    cycles: float | None
    deviation: float
    transient: float


def listen(case: Case, record: Run) -> Heard:
    """Take what the estimators need from a run that kept its ticks."""
    load = case.experiment.nominal()
    gain, exponent = load.input_gain, load.input_exponent
    voltage_V = np.array(record.fast_voltage_V)
    held = [to_input(value, gain, exponent) for value in record["boost_reference_V"].tolist()]
    return Heard(case, np.array(record.fast_output), gain * voltage_V**exponent, held)


def settings_over_forgetting(experiment: Experiment) -> list[Setting]:
    """Every ρ at the paper's τ_λ."""
    tau_lambda_s = experiment.paper.tau_lambda_s
    return [
        Setting(method, forgetting, tau_lambda_s)
        for method in experiment.sweep.methods
        for forgetting in experiment.sweep.forgetting
    ]


def settings_over_tau_lambda(experiment: Experiment) -> list[Setting]:
    """Every τ_λ at the paper's ρ."""
    forgetting = experiment.paper.forgetting
    return [Setting("lm-rls", forgetting, tau_s) for tau_s in experiment.sweep.tau_lambda_s]


def try_settings(heard: Heard, settings: list[Setting]) -> list[SweepPoint]:
    """See how settings of the estimator do."""
    noises = _noises(heard)
    return [_try_setting(heard, noises, setting) for setting in settings]


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


def _noises(heard: Heard) -> list[Array]:
    """Noise of every tick, several times."""
    case, count = heard.case, heard.output.size
    parameters = case.disturbance.scaled(case.experiment.step)
    generators = [np.random.default_rng([case.seed, i]) for i in range(_REALISATIONS)]
    return [np.fromiter(samples(parameters, one), np.float64, count) for one in generators]


def _try_setting(heard: Heard, noises: list[Array], setting: Setting) -> SweepPoint:
    learning = dataclasses.replace(
        heard.case.settings.learning,
        method=setting.method,
        forgetting=setting.forgetting,
        tau_lambda_s=setting.tau_lambda_s,
    )
    estimate = (
        _estimate_filtered if methods.METHODS[learning.method].physical else _estimate_directly
    )
    quiet, *noisy = estimate(heard, learning, noises)
    experiment = heard.case.experiment
    spread = _spread(heard, quiet, noisy)
    return SweepPoint(setting, _speed(experiment, quiet), spread, _transient(experiment, quiet))


def _estimate_filtered(
    heard: Heard, learning: EstimatorSettings, noises: list[Array]
) -> list[Array]:
    """Physical parameters at every slow instant: without noise, and with each one."""
    load, rates = heard.case.experiment.nominal(), heard.case.settings.rates
    ticks = rates.ticks_per_period
    tick_s = heard.case.experiment.period_s / ticks
    chain = _Chain(load.order, tick_s, learning.tau_lambda_s, ticks)
    clean = np.column_stack((heard.output[::ticks], chain.sampled(heard.output)))
    inputs = np.column_stack((heard.load_input[::ticks], chain.sampled(heard.load_input))).tolist()
    found = [_follow_filtered(load, learning, clean.tolist(), inputs)]
    for noise in noises:
        added = np.column_stack((noise[::ticks], chain.sampled(noise)))
        found.append(_follow_filtered(load, learning, (clean + added).tolist(), inputs))
    return found


def _follow_filtered(
    load: Load, learning: EstimatorSettings, outputs: list[list[float]], inputs: list[list[float]]
) -> Array:
    state = est.new_estimator(methods.METHODS[learning.method], learning, load, load.paper_taps)
    found = []
    for (target, *filtered), applied in zip(outputs, inputs, strict=True):
        reg.fill_filtered_regressor(state.sample.regressor, learning, load, filtered, applied)
        est.update_estimate(state, learning, load, target, usable=True)
        numerator, denominator = reg.filtered_model(state.estimate.theta, learning, load)
        found.append(_physical(load, numerator, denominator))
    return np.array(found)


def _estimate_directly(
    heard: Heard, learning: EstimatorSettings, noises: list[Array]
) -> list[Array]:
    """The same by least squares on the samples themselves."""
    ticks = heard.case.settings.rates.ticks_per_period
    clean = heard.output[::ticks]
    outputs = [clean, *(clean + noise[::ticks] for noise in noises)]
    return [_follow_directly(heard, learning, one.tolist()) for one in outputs]


def _follow_directly(heard: Heard, learning: EstimatorSettings, outputs: list[float]) -> Array:
    load, period_s = heard.case.experiment.nominal(), heard.case.experiment.period_s
    state = est.new_estimator(methods.METHODS[learning.method], learning, load, load.paper_taps)
    past_outputs = [outputs[0]] * load.order
    past_inputs = [float(heard.load_input[0])] * load.paper_taps
    found = []
    for target, applied in zip(outputs, heard.held_input, strict=True):
        methods.fill_direct_regressor(
            state.sample.regressor, learning, load, past_outputs, past_inputs
        )
        est.update_estimate(state, learning, load, target, usable=True)
        a, b = methods.direct_model(state.estimate.theta, learning, load)
        found.append(_physical(load, *methods.continuous_model(a, b, period_s)))
        shift_in(past_outputs, target)
        shift_in(past_inputs, applied)
    return np.array(found)


def _physical(load: Load, numerator: Vector, denominator: Vector) -> Vector:
    if not denominator[-1]:
        return [math.nan] * len(load.names)
    return load.physical(numerator, denominator)


class _Chain:
    """A λ chain whose values are wanted at the slow instants alone."""

    def __init__(self, order: int, tick_s: float, tau_s: float, ticks: int) -> None:
        decay = chain_decay(order, tick_s, tau_s)
        rise = np.array(ramp_gains(order, tick_s, tau_s))
        fall = np.array(step_gains(order, tick_s, tau_s)) - rise
        once = sum(decay[j] * np.eye(order, k=-j) for j in range(order))
        self._ticks = ticks
        self._weights = np.zeros((order, ticks + 1))
        self._over = np.eye(order)
        for tick in range(ticks - 1, -1, -1):
            self._weights[:, tick] += self._over @ fall
            self._weights[:, tick + 1] += self._over @ rise
            self._over = self._over @ once

    def sampled(self, signal: Array) -> Array:
        """The chain at the ticks 0, Q, 2Q, ..., having seen the first value for ever."""
        windows = sliding_window_view(signal, self._ticks + 1)[:: self._ticks]
        gained = windows @ self._weights.T
        values = np.full((len(gained) + 1, len(self._weights)), signal[0])
        for k in range(len(gained)):
            values[k + 1] = self._over @ values[k] + gained[k]
        return values


def _speed(experiment: Experiment, estimates: Array) -> float | None:
    found = [cycles_until_right(experiment, estimates, one) for one in experiment.changes]
    known = [one for one in found if one is not None]
    return max(known, default=0.0) if len(known) == len(found) else None


def _spread(heard: Heard, quiet: Array, noisy: list[Array]) -> float:
    experiment = heard.case.experiment
    periods = round(experiment.reference.period_s / experiment.period_s)
    chosen = np.concatenate(
        [np.arange(-periods, 0) + round(end / experiment.period_s) for end in experiment.ends_s]
    )
    relative = np.array([(one[chosen] - quiet[chosen]) / quiet[chosen] for one in noisy])
    return float(np.sqrt(np.mean(relative * relative)))


def _transient(experiment: Experiment, estimates: Array) -> float:
    cycle = round(experiment.reference.period_s / experiment.period_s)
    firsts = [round(change.time_s / experiment.period_s) for change in experiment.changes]
    found = (distances(experiment, estimates, first, first + cycle) for first in firsts)
    return max((float(np.nanmax(one)) for one in found), default=0.0)
