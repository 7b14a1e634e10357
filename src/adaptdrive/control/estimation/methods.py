"""The estimation methods: the λ-method, and direct least squares on the samples.

θ and r are in `regression`. θ is a model in s, so that the physical parameters of the load follow.

The poles z_i of A give those of the load, s_i = ln(z_i)/T; the gain follows from that at rest,
B(1)/A(1). The parameters that direct least squares publishes follow from it. Written in sums and
products of logarithms, so that a complex pair needs no complex numbers.

The regressor is [-y[k-1] ... -y[k-m], u[k-1] ... u[k-n]], and 1 where a bias is wanted; θ holds a
and b of the discrete model (17).
"""

import math
from dataclasses import dataclass

from adaptdrive.control import thresholds, vectors
from adaptdrive.control.estimation import bank, branch, change, regression, rls, uncertainty
from adaptdrive.control.estimation.estimator import (
    EstimatorState,
    Method,
    learn_in_bank,
    take_in,
    widen_emf,
)
from adaptdrive.control.estimation.regression import SlowSample
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import EstimatorSettings
from adaptdrive.control.vectors import Vector

# The λ-method (LM-RLS): recursive least squares on signals behind λ filters.


@dataclass(frozen=True, slots=True)
class LambdaMethod:
    """Least squares on λ-filtered signals (29); the functions are described in `Method`."""

    @property
    def physical(self) -> bool:
        """True: θ is a model in s."""
        return True

    def parameter_count(self, learning: EstimatorSettings, load: Load, taps: int) -> int:
        """Return the length of θ, which does not depend on the past inputs."""
        return regression.filtered_count(learning, load)

    def theta_of(
        self, learning: EstimatorSettings, load: Load, numerator: Vector, denominator: Vector
    ) -> Vector:
        """Return α and β of a model in s, scaled."""
        return regression.theta_of(learning, load, numerator, denominator)

    def begin(self, state: EstimatorState, learning: EstimatorSettings, load: Load) -> None:
        """Take γ = 0 as known where the initial state is not learnt: the load is at rest."""
        if learning.initial_state:
            return
        first = regression.fitted_order(learning, load) + len(load.input_powers)
        for i in range(regression.initial_state_count(learning, load)):
            state.estimate.diagonal[first + i] = (
                thresholds.NOISE_FLOOR * learning.initial_covariance
            )

    def fill_regressor(
        self,
        state: EstimatorState,
        learning: EstimatorSettings,
        load: Load,
        sample: SlowSample,
        past: tuple[Vector, Vector],
    ) -> None:
        """Overwrite r, and r with every power of λ lowered by one for a change."""
        y, u = sample.output_filtered, sample.input_filtered
        regressor = state.sample.regressor
        elapsed_s = state.sample.time_s - state.estimate.origin_s
        regression.fill_filtered_regressor(regressor, learning, load, y, u)
        regression.fill_initial_state(regressor, learning, load, elapsed_s)
        regression.fill_charge(regressor, learning, state.charge)
        widen_emf(state, learning)
        lowered, output = state.sample.lowered, sample.output
        regression.fill_lowered_regressor(lowered, learning, load, output, y, u)
        regression.fill_charge(lowered, learning, state.charge + output / learning.output_scale)

    def take_in(self, state: EstimatorState, learning: EstimatorSettings, load: Load) -> None:
        """Update θ and P; branches explain an abrupt change where `alert` is set."""
        own, sample = state.estimate, state.sample
        if not learning.alert:
            take_in(state, learning)
            return
        bank.follow_incremental(state.incremental, learning, load, sample, own)
        learn_in_bank(state, learning, load)
        uncertainty.count_unseen(state, learning, load)
        uncertainty.show(state, learning)

    def model(
        self, state: EstimatorState, learning: EstimatorSettings, load: Load
    ) -> tuple[Vector, Vector]:
        """Return numerator and denominator of the estimated model in s."""
        return regression.filtered_model(uncertainty.in_force(state).theta, learning, load)

    def root(
        self, state: EstimatorState, learning: EstimatorSettings, load: Load, values: Vector
    ) -> Vector:
        """Return L of the covariance of the physical parameters, to first order."""
        return uncertainty.parameter_root(state, learning, load, values)

    def shown_deviations(
        self, state: EstimatorState, learning: EstimatorSettings, load: Load, values: Vector
    ) -> Vector:
        """Return their deviations, with what the load may be since the samples showed it."""
        return uncertainty.inflated_deviations(state, learning, load, values)

    def input_offset(self, state: EstimatorState, learning: EstimatorSettings, load: Load) -> float:
        """Return the constant input with the effect of bias and charge; NaN without a bias."""
        return regression.input_offset(
            uncertainty.in_force(state).theta, learning, load, state.charge
        )


# From a discrete model back to the continuous-time load, for orders 1 and 2.


def continuous_model(a: Vector, b: Vector, period_s: float) -> tuple[Vector, Vector]:
    """The load without zeros that has the poles and the gain of a discrete model.

    Args:
        a: A in q^-1, first entry 1.
        b: B in q^-1.
        period_s: T.

    Returns:
        Numerator and denominator in s, highest power first; NaNs where there is no such load
        (a negative real pole, a pole at 0, an order above 2) or it has no gain.
    """
    order = len(a) - 1
    denominator = _denominator(a, period_s)
    numerator = [0.0] * (order + 1)
    rest = vectors.total(a)
    numerator[order] = denominator[order] * vectors.total(b) / rest if rest else math.nan
    return numerator, denominator


def _denominator(a: Vector, period_s: float) -> Vector:
    unknown = [1.0] + [math.nan] * (len(a) - 1)
    if len(a) == 2:
        return [1.0, -math.log(-a[1]) / period_s] if a[1] < 0.0 else unknown
    if len(a) != 3 or a[2] <= 0.0:
        return unknown
    middle, square = -0.5 * a[1], 0.25 * a[1] * a[1] - a[2]
    if square >= 0.0:
        split = math.sqrt(square)
        if middle - split <= 0.0:
            return unknown
        product = math.log(middle + split) * math.log(middle - split)
    else:
        angle = math.atan2(math.sqrt(-square), middle)
        product = 0.25 * math.log(a[2]) ** 2 + angle * angle
    return [1.0, -math.log(a[2]) / period_s, product / period_s**2]


# Direct least squares: recursive least squares on the samples themselves.


@dataclass(frozen=True, slots=True)
class DirectMethod:
    """Least squares on sampled signals (17); the functions are described in `Method`."""

    @property
    def physical(self) -> bool:
        """False: θ is a discrete model."""
        return False

    def parameter_count(self, learning: EstimatorSettings, load: Load, taps: int) -> int:
        """Return the length of θ."""
        return load.order + taps + (1 if learning.bias else 0)

    def theta_of(
        self, learning: EstimatorSettings, load: Load, numerator: Vector, denominator: Vector
    ) -> Vector:
        """Return nothing: the discrete model of a nominal one depends on the period."""
        return [0.0] * 0

    def begin(self, state: EstimatorState, learning: EstimatorSettings, load: Load) -> None:
        """Leave P as it is."""

    def fill_regressor(
        self,
        state: EstimatorState,
        learning: EstimatorSettings,
        load: Load,
        sample: SlowSample,
        past: tuple[Vector, Vector],
    ) -> None:
        """Overwrite r by the past outputs and inputs."""
        outputs, inputs = past
        fill_direct_regressor(state.sample.regressor, learning, load, outputs, inputs)

    def take_in(self, state: EstimatorState, learning: EstimatorSettings, load: Load) -> None:
        """Update θ and P; an abrupt change opens P where `alert` is set."""
        if learning.alert:
            _open_up(state, learning)
        take_in(state, learning)

    def model(
        self, state: EstimatorState, learning: EstimatorSettings, load: Load
    ) -> tuple[Vector, Vector]:
        """Return B and A as estimated; the gains need no more."""
        a, b = direct_model(state.estimate.theta, learning, load)
        return b, a

    def root(
        self, state: EstimatorState, learning: EstimatorSettings, load: Load, values: Vector
    ) -> Vector:
        """Return NaN: nothing is known of the physical parameters."""
        return [math.nan] * (len(values) * len(values))

    def shown_deviations(
        self, state: EstimatorState, learning: EstimatorSettings, load: Load, values: Vector
    ) -> Vector:
        """Return NaN for each physical parameter."""
        return [math.nan] * len(values)

    def input_offset(self, state: EstimatorState, learning: EstimatorSettings, load: Load) -> float:
        """Return the constant input with the effect of the estimated bias; NaN without one."""
        if not learning.bias:
            return math.nan
        theta = state.estimate.theta
        last = len(theta) - 1
        gain = vectors.total(theta[load.order : last])
        return theta[last] / gain * learning.input_scale if gain else math.nan


def fill_direct_regressor(
    regressor: Vector, learning: EstimatorSettings, load: Load, outputs: Vector, inputs: Vector
) -> None:
    """r of direct least squares (17).

    Args:
        regressor: r, overwritten.
        learning: Scales.
        load: Order.
        outputs: y[k-1] ... y[k-m].
        inputs: u[k-1] ... u[k-n].
    """
    for i in range(load.order):
        regressor[i] = -outputs[i] / learning.output_scale
    for i in range(_input_count(regressor, learning, load)):
        regressor[load.order + i] = inputs[i] / learning.input_scale
    if learning.bias:
        regressor[len(regressor) - 1] = 1.0


def direct_model(theta: Vector, learning: EstimatorSettings, load: Load) -> tuple[Vector, Vector]:
    """Return A, B in q^-1 of a direct estimate."""
    order = load.order
    b = [0.0] * (_input_count(theta, learning, load) + 1)
    for i in range(1, len(b)):
        b[i] = theta[order + i - 1] * learning.output_scale / learning.input_scale
    return [1.0, *theta[:order]], b


def _input_count(parameters: Vector, learning: EstimatorSettings, load: Load) -> int:
    return len(parameters) - load.order - (1 if learning.bias else 0)


def _open_up(state: EstimatorState, learning: EstimatorSettings) -> None:
    """After an abrupt change of a load that is learnt directly: forget how sure θ is."""
    own = state.estimate
    squared = branch.squared_error(own, learning.forgetting)
    power = change.noise_power(state.detector, state.sample.rounding)
    if not change.is_change(state.detector, squared, power):
        return
    rls.open_up(own.upper, own.diagonal, learning.initial_covariance)
    branch.predict(own, state.sample)
    state.excitation = own.excitation
    state.residual_power = state.detector.power * state.residual_weight


# The estimation methods, by their names in the configuration (`estimator.method`).

METHODS: dict[str, Method] = {"lm-rls": LambdaMethod(), "rls": DirectMethod()}
