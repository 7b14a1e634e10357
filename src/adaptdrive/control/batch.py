"""Batch least squares (2), and the identification of a recorded series with it.

The textbook solution θ = (ΦᵀΦ)⁻¹ Φᵀy squares the condition number of Φ: at 1e8 nothing is left of
it in double precision. Here Φ is factored instead, Φ = Q R by Householder's reflections with its
columns brought to one length first, and R = U Σ Vᵀ shows what the data do not determine.

`identify` is the batch form of the λ-method: the same filters and the same transform as on line,
for a record of any order, with the direct term and the constant that the load may need. A record
need not begin at rest: whatever the load and the filters remember from before it adds to y a sum of

    t^j e^(-t/τ_λ)        j = 0 ... m-1

which are m known signals with unknown factors: they are estimated along, and left out of the
result.

Between two samples y is taken as linear. Where the input acts at once, y jumps by b_0 Δu at a
sample instead, and the filters must not see a ramp there. What they see too much is

    b_0 (λ^i u, linear between its samples - λ^i u, held)

With b_0 of the last fit this is subtracted and the fit is repeated: each pass takes most of the
error of b_0 away, about the period over the load's shortest time constants of it remain.

For records and benches, not for the daemon, which must start without the array library it needs
(`pip install adaptdrive[analysis]`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.lambda_filter import advance, chain_decay, ramp_gains, step_gains
from adaptdrive.control.lambda_transform import from_lambda

Array = NDArray[np.float64]

_PASSES = 4
"""Fits after the first one where the input acts at once: b_0 no longer changes visibly."""


@dataclass(frozen=True, slots=True)
class Fit:
    """Result of a least-squares fit.

    Attributes:
        theta: θ; the shortest one of all where the data leave a choice.
        covariance: σ² (ΦᵀΦ + P[0]⁻¹)⁻¹; NaNs where the data leave a choice.
        condition: Condition number of the regressors, P[0]⁻¹ included, columns of equal length.
        sigma: Standard deviation of the residuals; NaN without more samples than parameters.
        rank: Parameters, or combinations of them, that the data determine.
    """

    theta: Array
    covariance: Array
    condition: float
    sigma: float
    rank: int

    @property
    def deviations(self) -> Array:
        """Standard deviation of each parameter."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True, slots=True)
class Record:
    """A recorded series at a constant rate.

    Attributes:
        outputs: y, linear between two samples but for what the input does at once; taken right
            after the input of the same sample.
        inputs: u, each held until the next.
        period_s: Time between two samples.
    """

    outputs: Sequence[float]
    inputs: Sequence[float]
    period_s: float


@dataclass(frozen=True, slots=True)
class Structure:
    """Structure of the model to fit to a record.

    Attributes:
        order: m.
        direct: Whether the input acts on the output at once (β_0).
        bias: Whether a constant is added to the output.
        at_rest: True for a record that begins at rest, with nothing left from before.
    """

    order: int
    direct: bool = False
    bias: bool = False
    at_rest: bool = False


@dataclass(frozen=True, slots=True)
class Identified:
    """A load as a record shows it.

    Attributes:
        numerator: b_0 ... b_m, highest power of s first; b_0 is 0 without a direct term.
        denominator: 1, a_1 ... a_m.
        covariance: Of b_0 ... b_m, a_1 ... a_m in this order.
        bias: The constant in the λ-transformed model; 0 where none was asked for.
        fit: The least squares behind it.
    """

    numerator: Array
    denominator: Array
    covariance: Array
    bias: float
    fit: Fit


def least_squares(
    regressors: Array,
    targets: Array,
    *,
    initial_covariance: Array | None = None,
    initial_theta: Array | None = None,
) -> Fit:
    """Solve (2): the θ with the least Σ (y - rᵀθ)².

    Args:
        regressors: Φ, one row for each sample.
        targets: y.
        initial_covariance: P[0], positive definite: adds (θ - θ[0])ᵀ P[0]⁻¹ (θ - θ[0]) to the sum,
            which makes the result that of recursive least squares without forgetting.
        initial_theta: θ[0]; 0 if not given.

    Returns:
        θ and its uncertainty.

    Raises:
        ValueError: A number is missing, or the shapes do not fit.
    """
    rows, rest = np.asarray(regressors, dtype=float), np.asarray(targets, dtype=float)
    if not (np.isfinite(rows).all() and np.isfinite(rest).all()):
        raise ValueError("regressors and targets must be finite")
    count = rows.shape[1]
    if initial_covariance is not None:
        start = np.zeros(count) if initial_theta is None else np.asarray(initial_theta)
        weights = np.linalg.inv(np.linalg.cholesky(initial_covariance))
        rows, rest = np.vstack([rows, weights]), np.concatenate([rest, weights @ start])
    theta, spread, condition, rank = _solve(rows, rest)
    sigma = _residual_sigma(np.asarray(regressors), np.asarray(targets), theta)
    return Fit(theta, sigma * sigma * spread, condition, sigma, rank)


def _solve(rows: Array, targets: Array) -> tuple[Array, Array, float, int]:
    """θ, (ΦᵀΦ)⁻¹, condition number and rank, by QR and the singular values of R."""
    lengths = np.linalg.norm(rows, axis=0)
    lengths[lengths == 0.0] = 1.0
    orthogonal, triangle = np.linalg.qr(rows / lengths)
    left, values, right = np.linalg.svd(triangle, full_matrices=False)
    limit = max(rows.shape) * np.finfo(float).eps * values[0]
    rank = int(np.count_nonzero(values > limit))
    inverse = right[:rank].T / values[:rank]
    theta = inverse @ (left[:, :rank].T @ (orthogonal.T @ targets)) / lengths
    condition = float(values[0] / values[-1]) if values[-1] > 0.0 else math.inf
    count = rows.shape[1]
    if rank < count:
        return theta, np.full((count, count), math.nan), condition, rank
    return theta, inverse @ inverse.T / np.outer(lengths, lengths), condition, rank


def _residual_sigma(rows: Array, targets: Array, theta: Array) -> float:
    freedom = len(targets) - len(theta)
    if freedom <= 0:
        return math.nan
    return float(np.linalg.norm(targets - rows @ theta) / math.sqrt(freedom))


def identify(record: Record, structure: Structure, tau_lambda_s: float) -> Identified:
    """The continuous-time load behind a record, by the λ-method.

    Args:
        record: Outputs and inputs.
        structure: What to look for.
        tau_lambda_s: Time constant of the λ filters.

    Returns:
        H(s) with its covariance.

    Raises:
        ValueError: The record has not one input for each output.
    """
    if len(record.outputs) != len(record.inputs):
        raise ValueError(f"{len(record.outputs)} outputs, but {len(record.inputs)} inputs")
    regressors, targets = _regression(record, structure, tau_lambda_s)
    found = _found(least_squares(regressors, targets), structure, tau_lambda_s)
    if not structure.direct:
        return found
    smeared = _smeared(record, structure, tau_lambda_s)
    for _ in range(_PASSES):
        mended = regressors.copy()
        mended[:, : structure.order] += found.numerator[0] * smeared
        fit = least_squares(mended, targets)
        found = _found(fit, structure, tau_lambda_s)
    return found


def _found(fit: Fit, structure: Structure, tau_lambda_s: float) -> Identified:
    """The load of a fit, out of the λ-domain."""
    order, first = structure.order, 0 if structure.direct else 1
    inputs = order + 1 - first
    alpha, beta = np.zeros(order + 1), np.zeros(order + 1)
    alpha[0], alpha[1:] = 1.0, fit.theta[:order]
    beta[first:] = fit.theta[order : order + inputs]
    back = _recovery(order, first, tau_lambda_s, len(fit.theta))
    return Identified(
        numerator=np.array(from_lambda(beta.tolist(), tau_lambda_s)),
        denominator=np.array(from_lambda(alpha.tolist(), tau_lambda_s)),
        covariance=back @ fit.covariance @ back.T,
        bias=float(fit.theta[order + inputs]) if structure.bias else 0.0,
        fit=fit,
    )


def _smeared(record: Record, structure: Structure, tau_lambda_s: float) -> Array:
    """Return the excess in λ ... λ^m of an output that jumps with the input, for jumps of Δu."""
    inputs = np.asarray(record.inputs, float)
    linear, steps = (
        _chains(inputs, structure.order, record.period_s, tau_lambda_s, held=held)
        for held in (False, True)
    )
    return linear - steps


def _regression(record: Record, structure: Structure, tau_lambda_s: float) -> tuple[Array, Array]:
    """Regressors [-λy ... -λ^m y, (u,) λu ... λ^m u, 1, transients] and targets y."""
    order, period_s = structure.order, record.period_s
    outputs, inputs = np.asarray(record.outputs, float), np.asarray(record.inputs, float)
    past_outputs = _chains(outputs, order, period_s, tau_lambda_s, held=False)
    past_inputs = _chains(inputs, order, period_s, tau_lambda_s, held=True)
    columns = [-past_outputs]
    if structure.direct:
        columns.append(inputs[:, None])
    columns.append(past_inputs)
    if structure.bias:
        columns.append(np.ones((len(outputs), 1)))
    if not structure.at_rest:
        age = np.arange(len(outputs))[:, None] * period_s / tau_lambda_s
        columns.append(age ** np.arange(order) * np.exp(-age))
    return np.hstack(columns), outputs


def _chains(
    signal: Array, order: int, period_s: float, tau_lambda_s: float, *, held: bool
) -> Array:
    """λw ... λ^m w at each sample; the first sample has been there for ever."""
    decay = chain_decay(order, period_s, tau_lambda_s)
    step, ramp = (
        step_gains(order, period_s, tau_lambda_s),
        ramp_gains(order, period_s, tau_lambda_s),
    )
    values = signal.tolist()
    chain = [values[0]] * order
    rows = [list(chain)]
    for n in range(1, len(values)):
        end = values[n - 1] if held else values[n]
        advance(chain, decay, step, ramp, values[n - 1], end)
        rows.append(list(chain))
    return np.array(rows)


def _recovery(order: int, first: int, tau_lambda_s: float, count: int) -> Array:
    """The matrix that takes θ to b_0 ... b_m, a_1 ... a_m, without the leading 1's share."""
    matrix = np.zeros((2 * order + 1, count))
    for power in range(1, order + 1):
        unit = [1.0 if i == power else 0.0 for i in range(order + 1)]
        matrix[order + 1 :, power - 1] = from_lambda(unit, tau_lambda_s)[1:]
    for power in range(first, order + 1):
        unit = [1.0 if i == power else 0.0 for i in range(order + 1)]
        matrix[: order + 1, order + power - first] = from_lambda(unit, tau_lambda_s)
    return matrix
