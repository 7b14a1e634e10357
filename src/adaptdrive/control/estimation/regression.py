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

from adaptdrive.control.estimation.rls import Estimate
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import EstimatorSettings
from adaptdrive.control.signals import SlowSample
from adaptdrive.control.vectors import Vector, copy_into, lacks, multiply, total, unit

# Between a continuous-time model and its λ-transformed parameters, for any order.


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


class Observation:
    """One slow sample, as an estimator sees it.

    Attributes:
        regressor: r, scaled; the functions of the initial state in it belong to the branch that
            has predicted it last.
        lowered: r with every power of λ lowered by one.
        target: What r predicts, scaled.
        time_s: Time since start.
        rounding: Standard deviation of the rounding error of the output, scaled.
    """

    def __init__(self, count: int) -> None:
        """Begin with zeros.

        Args:
            count: Length of r.
        """
        self.regressor = [0.0] * count
        self.lowered = [0.0] * count
        self.target = 0.0
        self.time_s = 0.0
        self.rounding = 0.0

    def assign(self, other: "Observation") -> None:
        """Overwrite this sample by another one."""
        copy_into(self.regressor, other.regressor)
        copy_into(self.lowered, other.lowered)
        self.target, self.time_s, self.rounding = other.target, other.time_s, other.rounding


class Regression:
    """θ and r of the λ-method for a load: α, β, then γ of the initial state, charge and bias.

    Attributes:
        learning: What is learnt, and scales.
        load: The nominal load.
        order: Number of estimated coefficients of the denominator.
        first: Place of γ, behind α and β.
        states: Length of γ: of the state at the start, and of that at each change.
        size: Length of θ; the bias is the last entry, and the charge is in front of it.
        walks: How many entries of θ, the last ones, follow a random walk.
    """

    def __init__(self, learning: EstimatorSettings, load: Load) -> None:
        """Lay out θ.

        Args:
            learning: What is learnt, and scales.
            load: The nominal load.
        """
        self.learning = learning
        self.load = load
        self._lag = learning.short_lag_s / learning.tau_lambda_s
        self.order = load.order - 1 if self._lag > 0.0 else load.order
        self.first = self.order + len(load.input_powers)
        self.states = self.order if learning.initial_state or learning.alert else 0
        self._charge = self.first + self.states
        self.size = self._charge + (1 if learning.charge else 0) + (1 if learning.bias else 0)
        self.walks = 0
        if learning.bias:
            self.walks = 2 if learning.charge else 1 if learning.drifts else 0

    def theta_of(self, numerator: Vector, denominator: Vector) -> Vector:
        """Return α and β of a model in s, scaled.

        Args:
            numerator: Of the model, highest power first.
            denominator: Of the model, highest power first; with the short lag in it, where one is.
        """
        learning, rest = self.learning, denominator
        scale = learning.input_scale / learning.output_scale
        if self._lag > 0.0:
            scale *= self._lag
            rest = _without_factor(denominator, 1.0 / learning.short_lag_s)
        alpha = to_lambda(rest, learning.tau_lambda_s)
        beta = to_lambda(numerator, learning.tau_lambda_s)
        gains = [beta[power] * scale for power in self.load.input_powers]
        return [*alpha[1 : self.order + 1], *gains]

    def model(self, theta: Vector) -> tuple[Vector, Vector]:
        """Return H(s) of an estimate: numerator and denominator."""
        learning, powers = self.learning, self.load.input_powers
        scale = learning.output_scale / learning.input_scale
        if self._lag > 0.0:
            scale /= self._lag
        beta = [0.0] * (self.load.order + 1)
        for i in range(len(powers)):
            beta[powers[i]] = theta[self.order + i] * scale
        numerator = from_lambda(beta, learning.tau_lambda_s)
        denominator = from_lambda([1.0, *theta[: self.order]], learning.tau_lambda_s)
        if self._lag > 0.0:
            denominator = multiply(denominator, [1.0, 1.0 / learning.short_lag_s])
        return numerator, denominator

    def observe(
        self, observation: Observation, sample: SlowSample, charge: float, elapsed_s: float
    ) -> None:
        """Overwrite r and the lowered r by those of a slow sample.

        Every term of r is λ-filtered, so that (τ_λ p + 1) r has each power of λ lowered by one.

        Args:
            observation: Its two regressors are overwritten.
            sample: The signals.
            charge: q/τ_λ, scaled.
            elapsed_s: Time since the origin of the functions of the initial state.
        """
        y, u = sample.output_filtered, sample.input_filtered
        self.fill_signals(observation.regressor, y, u)
        self.fill_state(observation.regressor, elapsed_s)
        self.fill_charge(observation.regressor, charge)
        # a direct term is left as it is: no load of second order has one
        y, u = [sample.output, *y[: len(y) - 1]], [u[0], *u[: len(u) - 1]]
        self.fill_signals(observation.lowered, y, u)
        self.fill_charge(observation.lowered, charge + sample.output / self.learning.output_scale)

    def fill_signals(self, regressor: Vector, outputs: Vector, inputs: Vector) -> None:
        """Overwrite what r (29) takes from the signals, and the 1 of a bias.

        Args:
            regressor: r, overwritten.
            outputs: λy ... λ^m y.
            inputs: u, λu ... λ^m u.
        """
        learning, powers, lag = self.learning, self.load.input_powers, self._lag
        for i in range(self.order):
            regressor[i] = -outputs[i] / learning.output_scale
        for i in range(len(powers)):
            value = inputs[powers[i]]
            if lag > 0.0:  # λ^(i-1) v
                value = (1.0 + lag) * inputs[powers[i] - 1] - lag * inputs[powers[i] - 2]
            regressor[self.order + i] = value / learning.input_scale
        if learning.bias:
            regressor[self.size - 1] = 1.0

    def fill_state(self, regressor: Vector, elapsed_s: float) -> None:
        """Overwrite what stands for the state at the start, h^i e^-h.

        Args:
            regressor: r, overwritten.
            elapsed_s: Time since the start.
        """
        ratio = elapsed_s / self.learning.tau_lambda_s
        value = math.exp(-ratio)
        for i in range(self.first, self.first + self.states):
            regressor[i] = value
            value *= ratio

    def fill_charge(self, regressor: Vector, charge: float) -> None:
        """Overwrite what stands for the charge q/τ_λ, scaled, where one is learnt."""
        if self.learning.charge:
            regressor[self._charge] = charge

    def gain(self, theta: Vector) -> float:
        """Σβ, scaled."""
        return total(theta[self.order : self.first])

    def input_offset(self, theta: Vector, charge: float) -> float:
        """Return the constant input with the effect of bias and charge; NaN without a bias.

        Args:
            theta: θ.
            charge: q/τ_λ, scaled.
        """
        if not self.learning.bias:
            return math.nan
        shift, gain = theta[self.size - 1], self.gain(theta)
        if self.learning.charge:
            shift += theta[self._charge] * charge
        return shift / gain * self.learning.input_scale if gain else math.nan

    def load_direction(self, theta: Vector, index: int) -> Vector:
        """Return a direction of θ that leaves the dc gain and the offset of the input as they are.

        Args:
            theta: θ.
            index: Of the coefficient that changes by 1: one of α, or of β but the last.
        """
        direction, last = unit(self.size, index), self.first - 1
        if index >= self.order:
            direction[last] = -1.0
            return direction
        below = total([1.0, *theta[: self.order]])
        if abs(below) > _TINY:
            direction[last] = self.gain(theta) / below
            self.carry_offset(direction, theta, below)
        return direction

    def gain_direction(self, theta: Vector) -> Vector:
        """Return the direction of θ along which the dc gain alone grows, by its own size for 1."""
        direction = [0.0] * self.size
        direction[self.order : self.first] = theta[self.order : self.first]
        self.carry_offset(direction, theta, 1.0)
        return direction

    def carry_offset(self, direction: Vector, theta: Vector, divisor: float) -> None:
        """Let what acts with the input move with the gain: bias and charge, over a divisor."""
        for i in range(self._charge, self.size):
            direction[i] = theta[i] / divisor

    def deviations(self, estimate: Estimate, noise: float, values: Vector) -> Vector:
        """Return standard deviations of the physical parameters, to first order.

        Args:
            estimate: θ and P.
            noise: σ of the innovations, scaled.
            values: The parameters at θ.
        """
        size, root = len(values), self.root(estimate, noise, values)
        return [math.hypot(*root[i * size : (i + 1) * size]) for i in range(size)]

    def offset_deviation(self, estimate: Estimate, noise: float, charge: float) -> float:
        """Return the standard deviation of the input offset, to first order; NaN without a bias.

        Args:
            estimate: θ and P.
            noise: σ of the innovations, scaled.
            charge: q/τ_λ, scaled.
        """
        gain, known, power = self.gain(estimate.theta), estimate.covariance(), 0.0
        if not self.learning.bias or gain == 0.0:
            return math.nan
        slope = [0.0] * self.size
        offset = self.input_offset(estimate.theta, charge) / self.learning.input_scale
        for i in range(self.order, self.first):
            slope[i] = -offset / gain
        slope[self.size - 1] = 1.0 / gain
        if self.learning.charge:
            slope[self._charge] = charge / gain
        for i in range(self.size):
            for j in range(self.size):
                power += slope[i] * known[i * self.size + j] * slope[j]
        return noise * self.learning.input_scale * math.sqrt(max(0.0, power))

    def root(self, estimate: Estimate, noise: float, values: Vector) -> Vector:
        """Return L, lower triangular, flat, of their covariance L Lᵀ, to first order.

        Args:
            estimate: θ and P.
            noise: σ of the innovations, scaled.
            values: The parameters at θ.
        """
        size, count, known = len(values), self.size, estimate.covariance()
        rows, root = self._jacobian(estimate.theta, values), [0.0] * (size * size)
        for i in range(size):
            for j in range(i + 1):
                rest = 0.0
                for m in range(count):
                    for n in range(count):
                        rest += rows[i * count + m] * known[m * count + n] * rows[j * count + n]
                rest *= noise * noise
                whole = rest
                for m in range(j):
                    rest -= root[i * size + m] * root[j * size + m]
                if i == j:
                    root[i * size + i] = math.sqrt(rest) if not rest < _TINY * whole else 0.0
                elif root[j * size + j] > 0.0:
                    root[i * size + j] = rest / root[j * size + j]
        return root

    def _jacobian(self, theta: Vector, values: Vector) -> Vector:
        """Derivatives of the physical parameters by θ, a row for each; NaN without a dc gain."""
        count, load = self.size, self.load
        rows = [0.0] * (len(values) * count)
        for j in range(self.first):
            step = 1e-6 * max(1.0, abs(theta[j]))
            moved = list(theta)
            moved[j] += step
            numerator, denominator = self.model(moved)
            if lacks(abs(denominator[load.order]), _TINY):
                return [math.nan] * len(rows)
            shifted = load.physical(numerator, denominator)
            for i in range(len(values)):
                rows[i * count + j] = (shifted[i] - values[i]) / step
        return rows


def _without_factor(polynomial: Vector, constant: float) -> Vector:
    """A polynomial divided by (s + constant); the remainder goes."""
    quotient = [0.0] * (len(polynomial) - 1)
    carried = 0.0
    for i in range(len(quotient)):
        carried = polynomial[i] - constant * carried
        quotient[i] = carried
    return quotient
