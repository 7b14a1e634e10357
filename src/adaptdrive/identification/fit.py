"""Fit of a load to blocks of a record by prediction errors: its starts, and its dead time.

The model of the measured output is

    y = N(s)/D(s) e^(-θs) u + free response + constant + v,        A(q) v = e

with white e. Numerator, free responses and constant enter linearly, and are solved for each
denominator and dead time θ by least squares (Golub and Pereyra, doi:10.1137/0710036). The noise
model makes the estimate consistent also where a controller feeds the noise back to the input
(Ljung, System Identification, section 13.4).
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np
from scipy.optimize import least_squares, minimize_scalar
from scipy.signal import lfilter

from adaptdrive.identification.excerpt import Array, Blocks, moment_responses, responses
from adaptdrive.util.errors import IdentificationError

# Fit of a load to blocks of a record by prediction errors.

CHARGE_DEGREE = 4
"""Degree of the polynomial by which a battery's own voltage follows its charge: its curve bends."""

_STEP = 1e-5
"""Step of the logarithms in a difference quotient."""

_DELAY_STEP = 0.25
"""Step of the dead time in a difference quotient, in samples."""

_WORST_CONDITION = 1e9
"""Condition of the columns, brought to one length, above which they are not distinguished."""


@dataclass(frozen=True, slots=True)
class Problem:
    """Data and structure of a fit.

    Attributes:
        parts: The data.
        order: m.
        powers: The i of the numerator's terms b_i s^(m-i).
        drift: The numerator with which the charge ∫y dt of a battery and its powers act on its
            current; their factors are fitted, its shape is not, as s ∫y dt would explain any y.
            Empty for none.
        noise: 1, A_1 ... A_n of the noise model; 1 alone fits the simulation to the output.
        delay: Dead time from input to output, in samples.
    """

    parts: Sequence[Blocks]
    order: int
    powers: tuple[int, ...]
    drift: tuple[float, ...]
    noise: Array
    delay: float = 0.0

    @property
    def shared(self) -> int:
        """Number of columns that all parts share: the numerator's, the charges', the constant."""
        return len(self.powers) + (CHARGE_DEGREE if self.drift else 0) + 1

    @property
    def targets(self) -> Array:
        """The outputs of all parts."""
        return np.concatenate([part.outputs for part in self.parts])


@dataclass(frozen=True, slots=True)
class Solution:
    """Result of a fit.

    Attributes:
        problem: Data, structure and dead time.
        logarithms: Of a_1 ... a_m.
        weights: Factors of the columns.
        simulated: Output of the load without noise.
        errors: e.
        condition: Condition number of the columns, brought to one length.
    """

    problem: Problem
    logarithms: Array
    weights: Array
    simulated: Array
    errors: Array
    condition: float

    @property
    def values(self) -> Array:
        """All fitted values: the logarithms, then the weights."""
        return np.concatenate((self.logarithms, self.weights))

    @property
    def loss(self) -> float:
        """Sum of e²."""
        return float(self.errors @ self.errors)


def columns(problem: Problem, logarithms: Array) -> Array:
    """Return what the linear parameters weigh: a row for each block.

    Args:
        problem: Data and structure.
        logarithms: Of a_1 ... a_m.
    """
    denominator = np.concatenate(([1.0], np.exp(logarithms)))
    block_s, delay = problem.parts[0].period_s, problem.delay
    if problem.parts[0].moments:
        filters = moment_responses(denominator, block_s, delay % 1.0)
        delay -= delay % 1.0
    else:
        filters = responses(denominator, block_s)
    shared, order = problem.shared, problem.order
    count = sum(len(part.outputs) for part in problem.parts)
    made = np.zeros((count, shared + order * sum(not part.at_rest for part in problem.parts)))
    row, first = 0, shared
    for part in problem.parts:
        rows = slice(row, row + len(part.outputs))
        inputs = part.inputs(delay), part.inputs(delay + 1.0)
        made[rows, : len(problem.powers)] = filters.of(inputs, problem.powers, part.rest)
        if problem.drift:
            for degree in range(1, CHARGE_DEGREE + 1):
                acting = filters.of((part.charge**degree,), problem.powers) @ problem.drift
                made[rows, len(problem.powers) + degree - 1] = acting
        made[rows, shared - 1] = 1.0
        if not part.at_rest:
            made[rows, first : first + order] = filters.free(len(part.outputs))
            first += order
        row = rows.stop
    return made


def whitened(problem: Problem, values: Array) -> Array:
    """Return A(q) of values, without the blocks at the start of each part that it needs."""
    lost = len(problem.noise) - 1
    if lost == 0:
        return values
    rows = split(problem, values)
    return np.concatenate([lfilter(problem.noise, [1.0], one, axis=0)[lost:] for one in rows])


def split(problem: Problem, values: Array, lost: int = 0) -> list[Array]:
    """Return values of all blocks as one array for each part.

    Args:
        problem: Data and structure.
        values: A row for each block.
        lost: Blocks without a row at the start of each part.
    """
    lengths = [max(0, len(part.outputs) - lost) for part in problem.parts]
    return np.split(values, np.cumsum(lengths)[:-1])


def solve(problem: Problem, logarithms: Array) -> Solution:
    """Return the best linear parameters for a denominator."""
    matrix = columns(problem, logarithms)
    rows, targets = whitened(problem, matrix), whitened(problem, problem.targets)
    weights, condition = weighed(rows, targets)
    errors = targets - rows @ weights
    return Solution(problem, logarithms, weights, matrix @ weights, errors, condition)


def weighed(rows: Array, targets: Array) -> tuple[Array, float]:
    """Return the factors of columns by least squares, and the condition of the columns.

    Args:
        rows: A column for each factor; they are brought to one length.
        targets: What the columns explain together.
    """
    if not rows.shape[1]:
        return np.zeros(0), 1.0
    lengths = np.linalg.norm(rows, axis=0)
    lengths[lengths == 0.0] = 1.0
    scaled, _, _, values = np.linalg.lstsq(rows / lengths, targets, rcond=1e-14)
    condition = float(values[0] / values[-1]) if values[-1] > 0.0 else np.inf
    return scaled / lengths, condition


def limits(problem: Problem) -> tuple[Array, Array]:
    """Logarithms of a_i for time constants from a twentieth of a block to twenty records."""
    block_s = problem.parts[0].period_s
    fastest_s, slowest_s = 0.05 * block_s, 20.0 * block_s * len(problem.targets)
    powers = np.arange(1.0, problem.order + 1.0)
    low: Array = -powers * math.log(slowest_s)
    high: Array = math.log(2.0) - powers * math.log(fastest_s)
    return low, high


def refine(problem: Problem, start: Array) -> Solution:
    """Return the best fit near a start.

    Args:
        problem: Data and structure.
        start: Logarithms of a_1 ... a_m.
    """
    low, high = limits(problem)
    found = least_squares(
        lambda logarithms: solve(problem, logarithms).errors,
        np.clip(start, low + _STEP, high - _STEP),
        jac=lambda logarithms: _error_slopes(problem, logarithms),
        bounds=(low, high),
        max_nfev=50,
    )
    return solve(problem, found.x)


def _error_slopes(problem: Problem, logarithms: Array) -> Array:
    """Return the derivatives of e to log a_1 ... log a_m, with the best linear parameters.

    The step is the same at log a = 0, where scipy's own, a fraction of the value, vanishes.
    """
    here = solve(problem, logarithms).errors
    steps = _STEP * np.eye(problem.order)
    slopes = [(solve(problem, logarithms + step).errors - here) / _STEP for step in steps]
    return np.column_stack(slopes)


def jacobian(solution: Solution) -> Array:
    """Return the derivatives of the predicted output.

    Returns:
        A column for each of log a_1 ... log a_m, the linear parameters, the dead time in samples
        where there may be one, and A_1 ... A_n.
    """
    problem = solution.problem
    matrix = columns(problem, solution.logarithms)
    slopes = []
    for step in _STEP * np.eye(problem.order):
        ahead, behind = (
            columns(problem, solution.logarithms + way * step) @ solution.weights
            for way in (1.0, -1.0)
        )
        slopes.append((ahead - behind) / (2.0 * _STEP))
    delayed = _delay_slope(solution)
    inner = whitened(problem, np.column_stack((*slopes, matrix, delayed)))
    return np.hstack((inner, -lagged(problem, problem.targets - solution.simulated)))


def _delay_slope(solution: Solution) -> Array:
    """Return the derivative to the dead time over the way that it may still take."""
    problem, lead = solution.problem, solution.problem.parts[0].lead
    if lead == 0:
        return np.empty((len(solution.simulated), 0))
    low, high = (min(max(problem.delay + way, 0.0), lead) for way in (-_DELAY_STEP, _DELAY_STEP))
    early, late = (
        columns(replace(problem, delay=delay), solution.logarithms) @ solution.weights
        for delay in (low, high)
    )
    slope: Array = (late - early)[:, None] / (high - low)
    return slope


def lagged(problem: Problem, values: Array) -> Array:
    """Return v[k-1] ... v[k-n], in the rows that `whitened` leaves."""
    count = len(problem.noise) - 1
    if count == 0:
        return np.empty((len(values), 0))
    parts = [part for part in split(problem, values) if len(part) > count]
    windows = [np.lib.stride_tricks.sliding_window_view(part[:-1], count) for part in parts]
    return np.concatenate(windows)[:, ::-1]


def require_excitation(solution: Solution) -> None:
    """Make sure that the data determine the model.

    Raises:
        IdentificationError: They do not.
    """
    problem = solution.problem
    inputs = np.concatenate([part.inputs(problem.delay) + part.rest for part in problem.parts])
    if solution.condition > _WORST_CONDITION or np.ptp(inputs) <= 1e-9 * np.abs(inputs).max():
        span = f"{inputs.min():.6g}…{inputs.max():.6g}"
        raise IdentificationError(f"the input moves too little to show the load: u = {span}")


# Denominators from which a fit starts.

_TRIED = 6
"""Time constants that are tried, from half a block to half the record."""


def start(problem: Problem, *near: Array) -> Array:
    """Return logarithms of a_1 ... a_m that fit best among some and those of real time constants.

    Args:
        problem: Data and structure.
        near: Logarithms that are tried too.
    """
    block_s = problem.parts[0].period_s
    taus_s = np.geomspace(0.5 * block_s, 0.5 * block_s * len(problem.targets), _TRIED)
    groups = itertools.combinations_with_replacement(taus_s.tolist(), problem.order)
    plain = [np.log(np.poly([-1.0 / tau_s for tau_s in group])[1:]) for group in groups]
    low, high = limits(problem)
    tried = [np.clip(one, low, high) for one in (*near, *plain)]
    return min(tried, key=lambda logarithms: solve(problem, logarithms).loss)


# The dead time of a load: the one with which a fit leaves the least.

_FINEST = 0.01
"""Distance in blocks at which the search ends."""


def scan(problem: Problem, *near: Array) -> Solution:
    """Return the best fit with a dead time of whole blocks.

    Args:
        problem: Data and structure.
        near: Logarithms of a_1 ... a_m from which a fit may start.
    """
    lead, samples = problem.parts[0].lead, problem.parts[0].samples
    delays = np.linspace(0.0, lead, 1 + math.ceil(lead / samples)).tolist()
    delayed = [replace(problem, delay=delay) for delay in delays]
    return min((refine(one, start(one, *near)) for one in delayed), key=attrgetter("loss"))


def settle(problem: Problem, logarithms: Array) -> Solution:
    """Return the best fit with a dead time within a block of that of a problem.

    Args:
        problem: Data, structure, and the dead time near which it is searched.
        logarithms: Of a_1 ... a_m from which each fit starts.
    """
    lead, samples = problem.parts[0].lead, problem.parts[0].samples
    near = _fitted(problem, problem.delay, logarithms)
    if lead == 0:
        return near
    found = minimize_scalar(
        lambda delay: _fitted(problem, delay, near.logarithms).loss,
        bounds=(max(0.0, problem.delay - samples), min(lead, problem.delay + samples)),
        method="bounded",
        options={"xatol": _FINEST * samples},
    )
    delays = (float(found.x), float(round(found.x)))
    others = [_fitted(problem, delay, near.logarithms) for delay in delays]
    return min((near, *others), key=attrgetter("loss"))


def _fitted(problem: Problem, delay: float, logarithms: Array) -> Solution:
    return refine(replace(problem, delay=delay), logarithms)
