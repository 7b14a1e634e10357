"""Parameters, deviations and checks of a fitted load: its noise and its residuals."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter
from scipy.stats import chi2

from adaptdrive.control.loads.load import Load
from adaptdrive.control.signals import Estimate
from adaptdrive.identification import fit
from adaptdrive.identification.excerpt import Array
from adaptdrive.identification.fit import Problem, Solution

# An autoregressive model of what the load does not explain: A(q) v = e.

_SAMPLES_PER_TERM = 10
"""Samples of the longest part for each term that is tried."""


def autoregression(parts: Sequence[Array], most: int = 8) -> Array:
    """Return 1, A_1 ... A_n with the n of least Bayesian information criterion.

    Args:
        parts: v of each uninterrupted part.
        most: Order up to which a model is tried.
    """
    longest = min(most, max(map(len, parts)) // _SAMPLES_PER_TERM)
    usable = [part for part in parts if len(part) > 2 * longest]
    count = sum(len(part) - longest for part in usable)
    lags = [np.lib.stride_tricks.sliding_window_view(part, longest + 1) for part in usable]
    rows = np.concatenate(lags)[:, ::-1]
    scores = [_score(rows, order, count) for order in range(longest + 1)]
    return min(scores, key=operator.itemgetter(0))[1]


def _score(rows: Array, order: int, count: int) -> tuple[float, Array]:
    """Return criterion and coefficients of one order."""
    targets, past = rows[:, 0], rows[:, 1 : order + 1]
    factors = np.linalg.lstsq(past, targets)[0]
    rest = targets - past @ factors
    power = max(float(rest @ rest), 1e-300)
    return count * math.log(power) + order * math.log(count), np.concatenate(([1.0], -factors))


# Test of residuals for whiteness.

LAGS = 20
"""Lags tested (Ljung and Box, doi:10.1093/biomet/65.2.297)."""


def ljung_box(parts: Sequence[Array], fitted: int) -> float:
    """Return the probability that white noise has autocorrelations as large as these.

    Args:
        parts: Residuals of each uninterrupted part.
        fitted: Parameters of the noise model that was fitted to them.
    """
    count = sum(map(len, parts))
    lags = max(fitted + 1, min(LAGS, count // 5))
    power = sum(float(part @ part) for part in parts)
    if power == 0.0:
        return 1.0
    statistic = 0.0
    for lag in range(1, lags + 1):
        product = sum(float(part[lag:] @ part[:-lag]) for part in parts if len(part) > lag)
        statistic += (product / power) ** 2 / max(1, count - lag)
    return float(chi2.sf(count * (count + 2) * statistic, lags - fitted))


# Parameters, deviations and checks of a fitted load.

_TRAINING_SHARE = 0.7
"""Share of the data that the cross-check fits."""

_DISPUTED = 2.0
"""Distance of both fits, in its standard deviation, above which a parameter is disputed."""

_STEP = 1e-6
_LEAST_LOSS = 1e-300
"""Loss of a record without noise: nothing is divided by 0."""


@dataclass(frozen=True, slots=True)
class IdentifiedLoad:
    """A load as records show it.

    Attributes:
        parameters: Physical parameters of the load, in SI, by the names of `Load.names`.
        covariance: Of these parameters, in their order.
        numerator: b_0 ... b_m, highest power of s first.
        denominator: 1, a_1 ... a_m.
        input_offset: Constant at the input, in its unit, that acts with the measured input.
        delay_s: Dead time from input to output.
        delay_std_s: Its standard deviation.
        simulated_parameters: The parameters whose simulation fits the output best.
        noise: 1, A_1 ... A_n of the autoregressive noise of the output; 1 for white noise.
        noise_std: Standard deviation of the white noise behind it, for a mean over a block.
        whiteness: Probability of such residuals by chance (Ljung and Box); below 0.01 they are not
            white, and the deviations of the parameters are wider for it.
        fit: 1 - |y - ŷ| / |y - mean y| of the simulation of all data.
        cross_fit: The same of the last 30 % of the data after a fit to the first 70 %; NaN where
            the output does not move there.
        simulated: Simulated output of each block, one array for each excerpt.
        residuals: Measured minus simulated output, as above.
        errors: White part of the residuals, as above; shorter by the order of the noise model.
        block_s: Length of a block.
        used: Places of the excerpts that the fit used; the others have too few samples.
    """

    parameters: dict[str, Estimate]
    covariance: Array
    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    input_offset: Estimate
    delay_s: float
    delay_std_s: float
    simulated_parameters: dict[str, Estimate]
    noise: tuple[float, ...]
    noise_std: float
    whiteness: float
    fit: float
    cross_fit: float
    simulated: tuple[Array, ...]
    residuals: tuple[Array, ...]
    errors: tuple[Array, ...]
    block_s: float
    used: tuple[int, ...] = (0,)

    @property
    def disputed(self) -> tuple[str, ...]:
        """Parameters of which prediction errors and simulation differ by more than chance.

        The record then contains what the model has not: a slower movement than that of the load,
        which the noise model takes for noise, or a controller that feeds the noise back.
        """
        pairs = {n: (one, self.simulated_parameters[n]) for n, one in self.parameters.items()}
        return tuple(name for name, (one, other) in pairs.items() if _differ(one, other))


def _differ(one: Estimate, other: Estimate) -> bool:
    """Return whether two estimates of a parameter differ by more than chance.

    Those of one sign are compared by their logarithms: data determine a parameter to a share of
    itself, so that the deviation of an estimate that is too large is too large by the same factor.
    """
    if one.value * other.value <= 0.0:
        return abs(one.value - other.value) > _DISPUTED * math.hypot(one.std, other.std)
    deviation = math.hypot(one.std / one.value, other.std / other.value)
    return abs(math.log(one.value / other.value)) > _DISPUTED * deviation


def result_of(
    load: Load, fitted: Solution, simulation: Solution, sample_s: float
) -> IdentifiedLoad:
    """Return the load of a fit.

    Args:
        load: Its structure.
        fitted: The fit by prediction errors.
        simulation: The fit of the simulation to the output.
        sample_s: Time between two samples, the unit of the dead time.
    """
    problem, effects = fitted.problem, _effects(fitted)
    parameters, spread = _parameters(load, fitted, effects)
    offset, offset_spread = _mapped(lambda values: _input_offset(problem, values), fitted, effects)
    numerator, denominator = _model(problem, fitted.values)
    errors = fit.split(problem, fitted.errors, lost=len(problem.noise) - 1)
    simulated = _simulated(problem, fitted.logarithms, fitted.weights[: problem.shared])
    residuals = problem.targets - simulated
    return IdentifiedLoad(
        parameters=parameters,
        covariance=spread,
        numerator=tuple(numerator.tolist()),
        denominator=tuple(denominator.tolist()),
        input_offset=Estimate(float(offset[0]), math.sqrt(offset_spread[0, 0])),
        delay_s=problem.delay * sample_s,
        delay_std_s=float(np.linalg.norm(effects[-1])) * sample_s if problem.parts[0].lead else 0.0,
        simulated_parameters=_parameters(load, simulation, _effects(simulation))[0],
        noise=tuple(problem.noise.tolist()),
        noise_std=math.sqrt(_variance(fitted)),
        whiteness=ljung_box(errors, len(problem.noise) - 1),
        fit=_fit(problem.targets, residuals),
        cross_fit=_cross_fit(fitted),
        simulated=tuple(fit.split(problem, simulated)),
        residuals=tuple(fit.split(problem, residuals)),
        errors=tuple(errors),
        block_s=problem.parts[0].period_s,
    )


def _parameters(load: Load, fitted: Solution, effects: Array) -> tuple[dict[str, Estimate], Array]:
    """Return the physical parameters of a fit, and their covariance."""

    def physical(found: Array) -> Array:
        numerator, denominator = _model(fitted.problem, found)
        return np.array(load.physical(numerator.tolist(), denominator.tolist()))

    values, spread = _mapped(physical, fitted, effects)
    pairs = zip(load.names, values.tolist(), np.sqrt(np.diag(spread)).tolist(), strict=True)
    return {name: Estimate(value, std) for name, value, std in pairs}, spread


def _variance(solution: Solution) -> float:
    """Return the variance of e."""
    problem = solution.problem
    known = problem.order + len(solution.weights) + len(problem.noise) - 1
    return max(solution.loss, _LEAST_LOSS) / max(1, len(solution.errors) - known)


def _effects(fitted: Solution) -> Array:
    """Return how errors of variance 1 act on log a_1 ..., the linear parameters, and any dead time.

    The product with its transpose is their covariance: that of least squares whose errors have the
    colour that is found in e, and at least that of white errors. Without the record the dead time
    lies anywhere within its limits.
    """
    problem = fitted.problem
    slopes, variance = fit.jacobian(fitted), _variance(fitted)
    lead, delay = problem.parts[0].lead, problem.order + len(fitted.weights)
    if lead:
        prior = math.sqrt(12.0 * variance) / lead
        slopes = np.vstack((slopes, prior * np.eye(1, slopes.shape[1], delay)))
    lengths = np.linalg.norm(slopes, axis=0)
    lengths[lengths == 0.0] = 1.0
    factors = np.linalg.pinv(slopes / lengths, rcond=1e-14) / lengths[:, None]
    factors = factors[: delay + (1 if lead else 0)]
    coloured = _coloured(fitted, factors)
    white, spread = (np.linalg.norm(one, axis=1) for one in (factors, coloured))
    wider = np.maximum(1.0, white / np.maximum(spread, 1e-300))
    return np.asarray(math.sqrt(variance) * wider[:, None] * coloured)


def _coloured(fitted: Solution, factors: Array) -> Array:
    """Return the factors with which white errors have the effect of errors of the colour of e.

    Args:
        fitted: The fit.
        factors: A column for each e, and what else is weighed, which is taken to be white.
    """
    lost, count = len(fitted.problem.noise) - 1, len(fitted.errors)
    parts = fit.split(fitted.problem, fitted.errors, lost=lost)
    colour = autoregression(parts, LAGS)
    white = np.concatenate([lfilter(colour, [1.0], part)[len(colour) - 1 :] for part in parts])
    scale = math.sqrt(np.mean(white**2) / max(np.mean(fitted.errors**2), _LEAST_LOSS))
    rows = fit.split(fitted.problem, factors[:, :count].T, lost=lost)
    filtered = [scale * lfilter([1.0], colour, one[::-1], axis=0)[::-1] for one in rows]
    return np.hstack((np.concatenate(filtered).T, factors[:, count:]))


def _mapped(
    function: Callable[[Array], Array], solution: Solution, effects: Array
) -> tuple[Array, Array]:
    """Return a function of the fitted parameters, and its covariance to first order."""
    values = solution.values
    logarithms, weights = np.ones(len(solution.logarithms)), np.abs(solution.weights)
    steps = np.concatenate((logarithms, np.where(weights == 0.0, 1.0, weights)))
    acting = slopes_of(function, values, steps) @ effects[: len(values)]
    return function(values), acting @ acting.T


def slopes_of(function: Callable[[Array], Array], values: Array, scales: Array) -> Array:
    """Return the derivatives of a function by central differences, a column for each value.

    Args:
        function: The function.
        values: Where it is differentiated.
        scales: Size of each value, of which a step is a millionth.
    """
    columns = [
        (function(values + step) - function(values - step)) / (2.0 * step.sum())
        for step in np.diag(_STEP * scales)
    ]
    return np.column_stack(columns)


def _model(problem: Problem, fitted: Array) -> tuple[Array, Array]:
    """Return numerator and denominator of H(s)."""
    order = problem.order
    numerator = np.zeros(order + 1)
    numerator[list(problem.powers)] = fitted[order : order + len(problem.powers)]
    return numerator, np.concatenate(([1.0], np.exp(fitted[:order])))


def _input_offset(problem: Problem, fitted: Array) -> Array:
    """Return the constant input that has the effect of the constant at the output."""
    numerator, denominator = _model(problem, fitted)
    constant = fitted[problem.order + problem.shared - 1]
    return np.array([constant * denominator[-1] / numerator[-1]])


def _fit(targets: Array, residuals: Array) -> float:
    spread = float(np.linalg.norm(targets - targets.mean()))
    return 1.0 - float(np.linalg.norm(residuals)) / spread if spread else math.nan


def _cross_fit(solution: Solution) -> float:
    """Return how well a fit to the first part of the data simulates the rest.

    A battery's own voltage at another charge is not predicted: it is fitted to the rest.
    """
    problem = solution.problem
    trained, tested = _halves(problem)
    fitted = fit.refine(trained, solution.logarithms)
    kept = len(problem.powers) if problem.drift else problem.shared
    simulated = _simulated(tested, fitted.logarithms, fitted.weights[:kept])
    return _fit(tested.targets, tested.targets - simulated)


def _simulated(problem: Problem, logarithms: Array, weights: Array) -> Array:
    """Return the output of a load without noise, with the free responses that it shows.

    The prediction errors hardly determine how a part of the data begins: where the noise is as
    slow as the load, its model removes nearly all of a free response.

    Args:
        problem: Data and structure.
        logarithms: Of a_1 ... a_m.
        weights: Factors of the first columns; those of the others are fitted to the output.
    """
    matrix = fit.columns(problem, logarithms)
    driven, free = np.split(matrix, [len(weights)], axis=1)
    forced = driven @ weights
    initial, _ = fit.weighed(free, problem.targets - forced)
    simulated: Array = forced + free @ initial
    return simulated


def _halves(problem: Problem) -> tuple[Problem, Problem]:
    """Divide the data into those that train a model and those that test it."""
    left = math.floor(_TRAINING_SHARE * len(problem.targets))
    trained, tested = [], []
    for part in problem.parts:
        count = min(left, len(part.outputs))
        left -= count
        trained += [part.cut(slice(count))] if count else []
        tested += [part.cut(slice(count, None))] if count < len(part.outputs) else []
    return replace(problem, parts=trained), replace(problem, parts=tested)
