"""Parameters θ and regressor r of the λ-method, and the λ transform of a model.

With p = (1 - λ)/(λ τ_λ) the model (4)

    H(s) = (b_0 s^m + b_1 s^(m-1) + ... + b_m) / (s^m + a_1 s^(m-1) + ... + a_m)

becomes (7)

    y + α_1 λy + ... + α_m λ^m y = β_0 u + β_1 λu + ... + β_m λ^m u

    α_j = Σ_(i<=j) a_i τ_λ^i C(m-i, j-i) (-1)^(j-i)          a_0 = 1, and β from b in the same way
    a_i = τ_λ^-i Σ_(j<=i) α_j C(m-j, i-j)                    α_0 = 1, and b from β in the same way

(multiply the model by λ^m and collect powers of λ; back: put λ = 1/(τ_λ s + 1) and collect powers
of s). For the motor this is (30), with a direct term β_0 and any order besides.

The regressor is [-λy ... -λ^m y, λ^i u ...] with the powers i that the load's structure leaves; θ
holds α and the free β (29). Where a bias is wanted, the last regressor is a constant 1: a load
torque, the EMF of a battery or the offset of a sensor would otherwise be mistaken for dynamics.

A lag that is shorter than a slow period, such as that of an encoder's electronics, cannot be told
from a dead time in samples of that period: learnt with the other parameters it takes any value,
and takes the gain along. It does not matter for the loop either, and counts as known. With
D = D' (s + 1/τ_f) the output obeys D' y = τ_f N v, of order m-1, where v is u behind that lag. To
first order in τ_f/τ_λ

    λv = (1 + τ_f/τ_λ) λu - (τ_f/τ_λ) u

so that the regressor has m-1 powers of λ of y, and λ^(i-1) v in place of λ^i u.

The state of the load at the start is unknown: a motor may still turn. D y = N u holds up to a
polynomial in s of lower degree than D, and the λ filters make of that, whatever the load is,

    Σ γ_i (t/τ_λ)^i e^(-t/τ_λ)        i = 0 ... m-1, t since the start

Where the initial state is to be learnt, these functions of time join the regressor, and γ joins θ
(before the bias). Otherwise the rest of an earlier movement is mistaken for dynamics: with a motor
that was off for five seconds, gain and time constants come out four times too large, and sure.

The EMF of a battery rises with its charge q = ∫ y dt, E = E_0 + s q. That is s q at the input, and
behind the filters β_0 q + β_1 λq = (β_0 + β_1) q - β_1 τ_λ λy. The last term changes α_1 by a
thousandth or less, so that one more regressor q/τ_λ (before the bias) holds the rise. Without it
the rise is mistaken for dynamics: a dc admittance of a third of the true one, then a negative one.
"""

import math
from dataclasses import dataclass, field

from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import EstimatorSettings
from adaptdrive.control.vectors import Vector, multiply, total

# Between a continuous-time model and its λ-transformed parameters, for any order.


@dataclass(slots=True)
class SlowSample:
    """Input of the slow half in each period.

    Attributes:
        period_s: T_k.
        output: y[k].
        output_filtered: λy ... λ^m y.
        input_filtered: u, λu ... λ^m u.
        applied: Input applied over the elapsed period, NaN while unknown.
        followed: False where a limit kept the drive from following.
        held_share: Share of the elapsed ticks without a fresh measurement.
        reference: r[k].
        adaptive: True when the operator asks for the adaptive controller.
        pole: Pole asked for.
        low: Lowest input.
        high: Highest input.
        manual: True when the operator sets the input.
        held: Input in force that the operator has set in the elapsed period, NaN for none.
        steady: Whether r is a constant set-point.
        lowest: Lowest output that V_c can hold, NaN while unknown.
        highest: Highest output that V_c can hold, NaN while unknown.
        rounding: Standard deviation of the rounding error of the output.
        upcoming: r[k+1] and the following ones that preview knows, empty for none.
    """

    period_s: float
    output: float
    output_filtered: Vector
    input_filtered: Vector
    applied: float
    followed: bool
    held_share: float
    reference: float
    adaptive: bool
    pole: float
    low: float
    high: float
    manual: bool = False
    held: float = math.nan
    steady: bool = False
    lowest: float = -math.inf
    highest: float = math.inf
    rounding: float = 0.0
    upcoming: Vector = field(default_factory=list)


def to_lambda(coefficients: Vector, tau_lambda_s: float) -> Vector:
    """α (or β) of a polynomial in s.

    Args:
        coefficients: c_0 ... c_m, highest power of s first.
        tau_lambda_s: Time constant of the λ filters.

    Returns:
        The m + 1 coefficients of λ^0 ... λ^m.
    """
    order = len(coefficients) - 1
    result = [0.0] * (order + 1)
    for j in range(order + 1):
        for i in range(j + 1):
            sign = -1.0 if (j - i) % 2 else 1.0
            result[j] += sign * binomial(order - i, j - i) * tau_lambda_s**i * coefficients[i]
    return result


def from_lambda(coefficients: Vector, tau_lambda_s: float) -> Vector:
    """The polynomial in s whose λ transform is given: the inverse of `to_lambda`."""
    order = len(coefficients) - 1
    result = [0.0] * (order + 1)
    for i in range(order + 1):
        for j in range(i + 1):
            result[i] += binomial(order - j, i - j) * coefficients[j]
        result[i] /= tau_lambda_s**i
    return result


def binomial(n: int, k: int) -> float:
    """Number of ways to choose k out of n, as a float."""
    result = 1.0
    for i in range(1, k + 1):
        result = result * (n - k + i) / i
    return result


# Parameters θ and regressor r of the λ-method.

_TINY = 1e-12
"""Below this a divisor counts as zero."""


def filtered_count(learning: EstimatorSettings, load: Load) -> int:
    """Return the length of θ of the λ-method."""
    first = fitted_order(learning, load) + len(load.input_powers)
    first += initial_state_count(learning, load)
    return first + (1 if learning.charge else 0) + (1 if learning.bias else 0)


def charge_index(learning: EstimatorSettings, size: int) -> int:
    """Return the place of the charge in θ of a length; only where a charge is learnt."""
    return size - 2 if learning.bias else size - 1


def has_short_lag(learning: EstimatorSettings) -> bool:
    """Return whether the output passes a lag that is too short to be learnt."""
    return learning.short_lag_s > 0.0


def fitted_order(learning: EstimatorSettings, load: Load) -> int:
    """Return the number of estimated coefficients of the denominator."""
    return load.order - 1 if has_short_lag(learning) else load.order


def theta_of(
    learning: EstimatorSettings, load: Load, numerator: Vector, denominator: Vector
) -> Vector:
    """θ of a model in s for the λ-method, scaled, without a bias.

    Args:
        learning: Scales and what is known.
        load: Order and structure.
        numerator: Of the model, highest power first.
        denominator: Of the model, highest power first; with the short lag in it, where one is.
    """
    order, scale = fitted_order(learning, load), learning.input_scale / learning.output_scale
    rest = denominator
    if has_short_lag(learning):
        scale *= learning.short_lag_s / learning.tau_lambda_s
        rest = _without_factor(denominator, 1.0 / learning.short_lag_s)
    alpha = to_lambda(rest, learning.tau_lambda_s)
    beta = to_lambda(numerator, learning.tau_lambda_s)
    gains = [beta[power] * scale for power in load.input_powers]
    return [*alpha[1 : order + 1], *gains]


def _without_factor(polynomial: Vector, constant: float) -> Vector:
    """A polynomial divided by (s + constant); the remainder goes."""
    quotient = [0.0] * (len(polynomial) - 1)
    carried = 0.0
    for i in range(len(quotient)):
        carried = polynomial[i] - constant * carried
        quotient[i] = carried
    return quotient


def fill_filtered_regressor(
    regressor: Vector,
    learning: EstimatorSettings,
    load: Load,
    output_filtered: Vector,
    input_filtered: Vector,
) -> None:
    """r of the λ-method (29).

    Args:
        regressor: r, overwritten.
        learning: Scales.
        load: Order and structure.
        output_filtered: λy ... λ^m y.
        input_filtered: u, λu ... λ^m u.
    """
    order = fitted_order(learning, load)
    for i in range(order):
        regressor[i] = -output_filtered[i] / learning.output_scale
    for i in range(len(load.input_powers)):
        value = _input_behind_lag(learning, input_filtered, load.input_powers[i])
        regressor[order + i] = value / learning.input_scale
    if learning.bias:
        regressor[len(regressor) - 1] = 1.0


def fill_initial_state(
    regressor: Vector, learning: EstimatorSettings, load: Load, elapsed_s: float
) -> None:
    """The part of r that stands for the state at the start.

    Args:
        regressor: r of the λ-method, overwritten.
        learning: Whether that state is learnt.
        load: Order and structure.
        elapsed_s: t.
    """
    first = fitted_order(learning, load) + len(load.input_powers)
    ratio = elapsed_s / learning.tau_lambda_s
    value = math.exp(-ratio)
    for i in range(initial_state_count(learning, load)):
        regressor[first + i] = value
        value *= ratio


def fill_charge(regressor: Vector, learning: EstimatorSettings, charge: float) -> None:
    """The part of r that stands for the charge, where one is learnt.

    Args:
        regressor: r of the λ-method, overwritten.
        learning: Whether it is learnt.
        charge: q/τ_λ, scaled as the output.
    """
    if learning.charge:
        regressor[charge_index(learning, len(regressor))] = charge


def fill_lowered_regressor(
    lowered: Vector,
    learning: EstimatorSettings,
    load: Load,
    output: float,
    output_filtered: Vector,
    input_filtered: Vector,
) -> None:
    """(τ_λ p + 1) r: r of the λ-method with every power of λ lowered by one.

    Args:
        lowered: Overwritten; without the functions of the initial state.
        learning: Scales.
        load: Order and structure; a direct term is left as it is, no load of second order has one.
        output: y.
        output_filtered: λy ... λ^m y.
        input_filtered: u, λu ... λ^m u.
    """
    outputs = [output, *output_filtered[: len(output_filtered) - 1]]
    inputs = [input_filtered[0], *input_filtered[: len(input_filtered) - 1]]
    fill_filtered_regressor(lowered, learning, load, outputs, inputs)


def _input_behind_lag(learning: EstimatorSettings, input_filtered: Vector, power: int) -> float:
    """Return λ^i u, or λ^(i-1) v where a short lag is known."""
    if not has_short_lag(learning):
        return input_filtered[power]
    share = learning.short_lag_s / learning.tau_lambda_s
    return (1.0 + share) * input_filtered[power - 1] - share * input_filtered[power - 2]


def initial_state_count(learning: EstimatorSettings, load: Load) -> int:
    """Length of γ: of the state at the start, and of that at each change."""
    return fitted_order(learning, load) if learning.initial_state or learning.alert else 0


def dc_gain(theta: Vector, learning: EstimatorSettings, load: Load) -> float:
    """Σβ / (1 + Σα), scaled; 0 where there is none."""
    below, order = 1.0, fitted_order(learning, load)
    for i in range(order):
        below += theta[i]
    above = total(theta[order : order + len(load.input_powers)])
    return above / below if abs(below) > _TINY else 0.0


def filtered_model(theta: Vector, learning: EstimatorSettings, load: Load) -> tuple[Vector, Vector]:
    """H(s) of an estimate of the λ-method: numerator and denominator."""
    order, scale = fitted_order(learning, load), learning.output_scale / learning.input_scale
    if has_short_lag(learning):
        scale *= learning.tau_lambda_s / learning.short_lag_s
    alpha = [1.0, *theta[:order]]
    beta = [0.0] * (load.order + 1)
    for i in range(len(load.input_powers)):
        beta[load.input_powers[i]] = theta[order + i] * scale
    numerator = from_lambda(beta, learning.tau_lambda_s)
    denominator = from_lambda(alpha, learning.tau_lambda_s)
    if has_short_lag(learning):
        denominator = multiply(denominator, [1.0, 1.0 / learning.short_lag_s])
    return numerator, denominator


def input_offset(theta: Vector, learning: EstimatorSettings, load: Load, charge: float) -> float:
    """The constant input with the effect of the estimated bias and charge; NaN without a bias.

    Args:
        theta: θ.
        learning: What is learnt, and scales.
        load: Order and structure.
        charge: q/τ_λ, scaled.
    """
    if not learning.bias:
        return math.nan
    shift = theta[len(theta) - 1]
    if learning.charge:
        shift += theta[charge_index(learning, len(theta))] * charge
    order = fitted_order(learning, load)
    gain = total(theta[order : order + len(load.input_powers)])
    return shift / gain * learning.input_scale if gain else math.nan
