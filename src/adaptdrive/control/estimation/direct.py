"""Direct least squares: recursive least squares on the samples themselves, as the paper compares.

The regressor is [-y[k-1] ... -y[k-m], u[k-1] ... u[k-n]], and 1 where a bias is wanted; θ holds a
and b of the discrete model (17).

The poles z_i of A give those of the load, s_i = ln(z_i)/T; the gain follows from that at rest,
B(1)/A(1). The parameters that direct least squares publishes follow from it. Written in sums and
products of logarithms, so that a complex pair needs no complex numbers.
"""

import math

from adaptdrive.control import vectors
from adaptdrive.control.estimation.estimator import Estimator, LambdaEstimator
from adaptdrive.control.estimation.rls import Estimate
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import EstimatorSettings
from adaptdrive.control.signals import SlowSample
from adaptdrive.control.vectors import Vector


class DirectEstimator(Estimator):
    """Least squares on sampled signals (17); θ is a discrete model."""

    def __init__(self, learning: EstimatorSettings, load: Load, taps: int) -> None:
        """Begin at zero: the discrete model of a nominal one depends on the period.

        Args:
            learning: Forgetting, gates and scales.
            load: Its order.
            taps: Number of past inputs of the discrete model.
        """
        super().__init__(learning, load, load.order + taps + (1 if learning.bias else 0))
        self._own = Estimate(len(self.sample.regressor))
        self._taps = taps
        self.open_up()

    @property
    def estimate(self) -> Estimate:
        """θ and P."""
        return self._own

    def observe(self, _sample: SlowSample, outputs: Vector, inputs: Vector) -> None:
        """Overwrite r by the past outputs and inputs."""
        self.fill(outputs, inputs)

    def fill(self, outputs: Vector, inputs: Vector) -> None:
        """Overwrite r (17).

        Args:
            outputs: y[k-1] ... y[k-m].
            inputs: u[k-1] ... u[k-n].
        """
        regressor, learning, order = self.sample.regressor, self.learning, self.load.order
        for i in range(order):
            regressor[i] = -outputs[i] / learning.output_scale
        for i in range(self._taps):
            regressor[order + i] = inputs[i] / learning.input_scale
        if learning.bias:
            regressor[len(regressor) - 1] = 1.0

    def learn(self) -> None:
        """Update θ and P; an abrupt change opens P where `alert` is set."""
        own, sample, detector = self._own, self.sample, self.detector
        if self.learning.alert:
            squared = own.squared_error(self.learning.forgetting)
            if detector.is_change(squared, detector.noise_power(sample.rounding)):
                own.open_up(self.learning.initial_covariance)
                own.predict(sample.regressor, sample.target)
                self.excitation = own.excitation
                self.residuals.power = detector.power * self.residuals.weight
        self.learn_plainly()

    def model(self) -> tuple[Vector, Vector]:
        """Return B and A in q^-1 as estimated; the gains need no more."""
        theta, order, learning = self._own.theta, self.load.order, self.learning
        scale = learning.output_scale / learning.input_scale
        b = [one * scale for one in theta[order : order + self._taps]]
        return [0.0, *b], [1.0, *theta[:order]]

    def input_offset(self) -> float:
        """Return the constant input with the effect of the estimated bias; NaN without one."""
        if not self.learning.bias:
            return math.nan
        theta, order = self._own.theta, self.load.order
        gain = vectors.total(theta[order : order + self._taps])
        return theta[len(theta) - 1] / gain * self.learning.input_scale if gain else math.nan


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


# The estimation methods, by their names in the configuration (`estimator.method`).

METHODS: dict[str, type[Estimator]] = {"lm-rls": LambdaEstimator, "rls": DirectEstimator}


def new_estimator(learning: EstimatorSettings, load: Load, taps: int) -> Estimator:
    """Return an estimator without data by the method that its settings name.

    Args:
        learning: Method, what is learnt, gates and scales.
        load: The nominal load.
        taps: Number of past inputs of the discrete model.
    """
    return METHODS[learning.method](learning, load, taps)
