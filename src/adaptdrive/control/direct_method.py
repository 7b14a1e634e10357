"""Direct least squares: recursive least squares on the samples themselves.

The regressor is [-y[k-1] ... -y[k-m], u[k-1] ... u[k-n]], and 1 where a bias is wanted; θ holds a
and b of the discrete model (17).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from adaptdrive.control import rls
from adaptdrive.control import supervisor as sup
from adaptdrive.control import ud_factors as ud
from adaptdrive.control.branch import predict
from adaptdrive.control.continuous import continuous_model
from adaptdrive.control.estimator import EstimatorState, take_in
from adaptdrive.control.load import Load
from adaptdrive.control.settings import ControllerSettings, Learning
from adaptdrive.control.slow_state import SlowSample, SlowState
from adaptdrive.control.surprise import is_surprising
from adaptdrive.control.vectors import Vector, copy_into, total


@dataclass(frozen=True, slots=True)
class DirectMethod:
    """Least squares on sampled signals (17); the functions are described in `Method`."""

    @property
    def physical(self) -> bool:
        """False: θ is a discrete model."""
        return False

    def parameter_count(self, learning: Learning, load: Load, taps: int) -> int:
        """Return the length of θ."""
        return load.order + taps + (1 if learning.bias else 0)

    def theta_of(
        self, learning: Learning, load: Load, numerator: Vector, denominator: Vector
    ) -> Vector:
        """Return nothing: the discrete model of a nominal one depends on the period."""
        return [0.0] * 0

    def begin(self, state: EstimatorState, learning: Learning, load: Load) -> None:
        """Leave P as it is."""

    def fill_regressor(
        self, state: SlowState, learning: Learning, load: Load, sample: SlowSample
    ) -> None:
        """Overwrite r by the past outputs and inputs."""
        regressor = state.estimator.sample.regressor
        fill_direct_regressor(regressor, learning, load, state.outputs, state.inputs)

    def target(self, learning: Learning, sample: SlowSample) -> float:
        """Return y[k]."""
        return sample.output

    def take_in(self, state: EstimatorState, learning: Learning, load: Load) -> None:
        """Update θ and P; an abrupt change opens P where `alert` is set."""
        if learning.alert:
            _open_up(state, learning)
        take_in(state, learning, directional=False)

    def model(
        self, settings: ControllerSettings, load: Load, state: SlowState, period_s: float
    ) -> tuple[Vector, Vector, int]:
        """Return A and B as estimated, and the verdict on A; the gains need no more."""
        a, b = direct_model(state.estimator.estimate.theta, settings.learning, load)
        _show(load, state, a, b, period_s)
        return a, b, sup.judge_load(a)

    def root(self, state: EstimatorState, learning: Learning, load: Load, values: Vector) -> Vector:
        """Return NaN: nothing is known of the physical parameters."""
        return [math.nan] * (len(values) * len(values))

    def shown_deviations(
        self, state: EstimatorState, learning: Learning, load: Load, values: Vector
    ) -> Vector:
        """Return NaN for each physical parameter."""
        return [math.nan] * len(values)

    def input_offset(self, state: EstimatorState, learning: Learning, load: Load) -> float:
        """Return the constant input with the effect of the estimated bias; NaN without one."""
        if not learning.bias:
            return math.nan
        theta = state.estimate.theta
        last = len(theta) - 1
        gain = total(theta[load.order : last])
        return theta[last] / gain * learning.input_scale if gain else math.nan


def fill_direct_regressor(
    regressor: Vector, learning: Learning, load: Load, outputs: Vector, inputs: Vector
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


def direct_model(theta: Vector, learning: Learning, load: Load) -> tuple[Vector, Vector]:
    """Return A, B in q^-1 of a direct estimate."""
    order = load.order
    b = [0.0] * (_input_count(theta, learning, load) + 1)
    for i in range(1, len(b)):
        b[i] = theta[order + i - 1] * learning.output_scale / learning.input_scale
    return [1.0, *theta[:order]], b


def _input_count(parameters: Vector, learning: Learning, load: Load) -> int:
    return len(parameters) - load.order - (1 if learning.bias else 0)


def _open_up(state: EstimatorState, learning: Learning) -> None:
    """After an abrupt change of a load that is learnt directly: forget how sure θ is."""
    own = state.estimate
    squared = rls.normalised(own.excitation, own.innovation, learning.forgetting)
    if not is_surprising(state.surprise, squared):
        return
    ud.open_up(own.upper, own.diagonal, learning.initial_covariance)
    predict(own, state.sample)
    state.excitation = own.excitation
    state.residual_power = state.surprise.power * state.residual_weight


def _show(load: Load, state: SlowState, a: Vector, b: Vector, period_s: float) -> None:
    """Make the physical parameters that are published; NaN where the model has none."""
    numerator, denominator = continuous_model(a, b, period_s)
    if sup.judge_model(numerator, denominator) == sup.Verdict.TRUSTED:
        copy_into(state.values, load.physical(numerator, denominator))
    else:
        copy_into(state.values, [math.nan] * len(state.values))
