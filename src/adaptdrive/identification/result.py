"""Parameters, deviations and checks of a fitted load."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.load import Load
from adaptdrive.control.signals import Estimate
from adaptdrive.identification.excerpt import Blocks
from adaptdrive.identification.fit import (
    Problem,
    Solution,
    columns,
    jacobian,
    refine,
    split,
    weighed,
)
from adaptdrive.identification.whiteness import ljung_box

Array = NDArray[np.float64]

_TRAINING_SHARE = 0.7
"""Share of the data that the cross-check fits."""

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
        input_offset: Constant at the input, in its unit, that acts beside the measured input.
        delay_s: Dead time from input to output.
        noise: 1, A_1 ... A_n of the autoregressive noise of the output; 1 for white noise.
        noise_std: Standard deviation of the white noise behind it, for a mean over a block.
        whiteness: Probability of such residuals by chance (Ljung and Box); below 0.01 they are not
            white, and the deviations are too small.
        fit: 1 - |y - ŷ| / |y - mean y| of the simulation of all data.
        cross_fit: The same of the last 30 % of the data after a fit to the first 70 %; NaN where
            the output does not move there.
        simulated: Simulated output of each block, one array for each excerpt.
        residuals: Measured minus simulated output, likewise.
        errors: White part of the residuals, likewise; shorter by the order of the noise model.
        block_s: Length of a block.
    """

    parameters: dict[str, Estimate]
    covariance: Array
    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    input_offset: Estimate
    delay_s: float
    noise: tuple[float, ...]
    noise_std: float
    whiteness: float
    fit: float
    cross_fit: float
    simulated: tuple[Array, ...]
    residuals: tuple[Array, ...]
    errors: tuple[Array, ...]
    block_s: float


@dataclass(frozen=True, slots=True)
class Choice:
    """The fits with all dead times.

    Attributes:
        problems: Data for each dead time in samples.
        solutions: Fit for each of them.
    """

    problems: dict[int, Problem]
    solutions: dict[int, Solution]

    @property
    def delay(self) -> int:
        """The dead time with the least loss, in samples."""
        return min(self.solutions, key=lambda delay: self.solutions[delay].loss)

    @property
    def problem(self) -> Problem:
        """Data with that dead time."""
        return self.problems[self.delay]

    @property
    def solution(self) -> Solution:
        """Fit with that dead time."""
        return self.solutions[self.delay]


def result_of(load: Load, choice: Choice, sample_s: float) -> IdentifiedLoad:
    """Return the load of a fit.

    Args:
        load: Its structure.
        choice: The fit.
        sample_s: Time between two samples, the unit of the dead time.
    """
    problem, solution = choice.problem, choice.solution
    covariance, variance = _covariance(problem, solution)
    odds = _odds(choice, variance)
    values, spread = _mapped(
        lambda fitted: _physical(problem, load, fitted), solution, covariance, odds
    )
    offset, offset_spread = _mapped(
        lambda fitted: _input_offset(problem, fitted), solution, covariance, odds
    )
    numerator, denominator = _model(problem, _fitted(solution))
    errors = split(problem, solution.errors, lost=len(problem.noise) - 1)
    simulated = _simulated(problem, solution.logarithms, solution.weights[: problem.shared])
    residuals = problem.targets - simulated
    return IdentifiedLoad(
        parameters={
            name: Estimate(value, std)
            for name, value, std in zip(
                load.names, values.tolist(), np.sqrt(np.diag(spread)).tolist(), strict=True
            )
        },
        covariance=spread,
        numerator=tuple(numerator.tolist()),
        denominator=tuple(denominator.tolist()),
        input_offset=Estimate(float(offset[0]), math.sqrt(offset_spread[0, 0])),
        delay_s=choice.delay * sample_s,
        noise=tuple(problem.noise.tolist()),
        noise_std=math.sqrt(variance),
        whiteness=ljung_box(errors, len(problem.noise) - 1),
        fit=_fit(problem.targets, residuals),
        cross_fit=_cross_fit(problem, solution),
        simulated=tuple(split(problem, simulated)),
        residuals=tuple(split(problem, residuals)),
        errors=tuple(errors),
        block_s=problem.parts[0].period_s,
    )


def _covariance(problem: Problem, solution: Solution) -> tuple[Array, float]:
    """Return the covariance of log a_1 ... log a_m and the linear parameters, and that of e."""
    slopes = jacobian(problem, solution)
    kept = problem.order + len(solution.weights)
    freedom = max(1, len(solution.errors) - slopes.shape[1])
    variance = max(solution.loss, _LEAST_LOSS) / freedom
    lengths = np.linalg.norm(slopes, axis=0)
    lengths[lengths == 0.0] = 1.0
    inverse = np.linalg.pinv(slopes / lengths, rcond=1e-14)
    covariance = variance * (inverse @ inverse.T / np.outer(lengths, lengths))[:kept, :kept]
    return covariance, variance


def _odds(choice: Choice, variance: float) -> list[tuple[float, Solution]]:
    """Return the probability of each other dead time by its likelihood, and its fit."""
    others = [one for one in choice.solutions.values() if one is not choice.solution]
    odds = [math.exp(-0.5 * (one.loss - choice.solution.loss) / variance) for one in others]
    return [(each / (1.0 + sum(odds)), one) for each, one in zip(odds, others, strict=True)]


def _fitted(solution: Solution) -> Array:
    return np.concatenate((solution.logarithms, solution.weights))


def _mapped(
    function: Callable[[Array], Array],
    solution: Solution,
    covariance: Array,
    odds: Sequence[tuple[float, Solution]],
) -> tuple[Array, Array]:
    """Return a function of the fitted parameters, and its covariance.

    That of the fit is to first order. The other dead times count with the values that they give:
    where a lag is shorter than a block, their denominators lie too far apart for a first order.
    """
    fitted = _fitted(solution)
    logarithms, weights = np.ones(len(solution.logarithms)), np.abs(solution.weights)
    steps = _STEP * np.concatenate((logarithms, np.where(weights == 0.0, 1.0, weights)))
    slopes = np.column_stack(
        [
            (function(fitted + step) - function(fitted - step)) / (2.0 * step.sum())
            for step in np.diag(steps)
        ]
    )
    here, spread = function(fitted), slopes @ covariance @ slopes.T
    for probability, other in odds:
        way = function(_fitted(other)) - here
        spread = spread + probability * np.outer(way, way)
    return here, spread


def _model(problem: Problem, fitted: Array) -> tuple[Array, Array]:
    """Return numerator and denominator of H(s)."""
    order = problem.order
    numerator = np.zeros(order + 1)
    numerator[list(problem.powers)] = fitted[order : order + len(problem.powers)]
    return numerator, np.concatenate(([1.0], np.exp(fitted[:order])))


def _physical(problem: Problem, load: Load, fitted: Array) -> Array:
    numerator, denominator = _model(problem, fitted)
    return np.array(load.physical(numerator.tolist(), denominator.tolist()))


def _input_offset(problem: Problem, fitted: Array) -> Array:
    """Return the constant input that has the effect of the constant at the output."""
    numerator, denominator = _model(problem, fitted)
    constant = fitted[problem.order + problem.shared - 1]
    return np.array([constant * denominator[-1] / numerator[-1]])


def _fit(targets: Array, residuals: Array) -> float:
    spread = float(np.linalg.norm(targets - targets.mean()))
    return 1.0 - float(np.linalg.norm(residuals)) / spread if spread else math.nan


def _cross_fit(problem: Problem, solution: Solution) -> float:
    """Return how well a fit to the first part of the data simulates the rest.

    A battery's own voltage at another charge is not predicted: it is fitted to the rest.
    """
    trained, tested = _halves(problem)
    fitted = refine(trained, solution.logarithms)
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
    matrix = columns(problem, logarithms)
    driven, free = np.split(matrix, [len(weights)], axis=1)
    forced = driven @ weights
    initial, _ = weighed(free, problem.targets - forced)
    simulated: Array = forced + free @ initial
    return simulated


def _halves(problem: Problem) -> tuple[Problem, Problem]:
    """Divide the data into those that train a model and those that test it."""
    left = math.floor(_TRAINING_SHARE * len(problem.targets))
    trained, tested = [], []
    for part in problem.parts:
        count = min(left, len(part.outputs))
        left -= count
        trained += [_cut(part, slice(count))] if count else []
        tested += [_cut(part, slice(count, None))] if count < len(part.outputs) else []
    return replace(problem, parts=trained), replace(problem, parts=tested)


def _cut(part: Blocks, rows: slice) -> Blocks:
    return Blocks(part.inputs[rows], part.outputs[rows], part.charge[rows], part.period_s)
