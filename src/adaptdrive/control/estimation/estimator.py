"""The on-line estimator: recursive least squares with a gate, and a bank of branches.

θ and r are in `regression`, the arithmetic of the update in `rls`, and what an abrupt change does
in `change` and `bank`. θ is a model in s, so that the physical parameters of the load follow.

P shows how well the samples have determined a load that stays as it is. That load may have changed
since: at rest any dynamics predict the same output, and an alarm takes samples to be explained.
While that is so, the standard deviations shown are those of P opened up for another load: the load
is known as it was, and the loop keeps the gains that it has.
"""

import math
from typing import ClassVar

from adaptdrive.control import thresholds, vectors
from adaptdrive.control.estimation import change
from adaptdrive.control.estimation.bank import Bank, IncrementalModel
from adaptdrive.control.estimation.change import Branch, ChangeDetector
from adaptdrive.control.estimation.regression import Observation, Regression
from adaptdrive.control.estimation.rls import Estimate, Residuals, normalised
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import EstimatorSettings
from adaptdrive.control.signals import SlowSample
from adaptdrive.control.vectors import Vector

_LARGEST = 1.0e20
"""Largest scaled entry of a sample, for which 1 is usual: the squares of larger ones overflow P."""

_EMF_NOISE = 0.2
"""Random walk of an EMF in each slow period, in σ of a sample: its charge is no more exact."""

_EMF_BEND = 0.5 * _EMF_NOISE
"""Random walk of its rise, in σ, for a charge of τ_λ times the output's scale."""

_SHOWN = 30.0
"""Movement of a sample, in σ, by an α that is larger by 1: 3 σ for a quarter of a second disk."""


class Estimator:
    """What every method to learn the load has in common.

    Attributes:
        physical: True if θ follows from the physical parameters of the load. Only then can an
            estimate start from these, be compared with the nominal model, and be kept for the next
            run.
        sample: The last sample.
        detector: Detector of abrupt changes, and the noise.
        residuals: Innovations of the estimate whose bias rests.
        innovation: ε of the last sample, in the unit of the output.
        excitation: rᵀPr of the last sample.
        periods: Slow periods since start.
        unseen_periods: Slow periods since a sample that would have shown another load.
        decided: Kind of change that explains the last sample, decided at it; 0 for none.
    """

    physical: ClassVar[bool] = False

    def __init__(self, learning: EstimatorSettings, load: Load, count: int) -> None:
        """Begin without data.

        Args:
            learning: What is learnt, gates and scales.
            load: The nominal load.
            count: Length of θ.
        """
        self.learning = learning
        self.load = load
        self.sample = Observation(count)
        self.detector = ChangeDetector()
        self.residuals = Residuals()
        self.innovation = math.nan
        self.excitation = 0.0
        self.periods = 0
        self.unseen_periods = 0
        self.decided = 0

    @property
    def estimate(self) -> Estimate:
        """θ and P."""
        raise NotImplementedError

    def observe(self, sample: SlowSample, outputs: Vector, inputs: Vector) -> None:
        """Overwrite r by that of a slow sample.

        Args:
            sample: The sample.
            outputs: y of the periods before it, the last one first.
            inputs: u of the periods before it.
        """
        raise NotImplementedError

    def learn(self) -> None:
        """Update θ and P by the last sample, which the estimate has predicted."""
        raise NotImplementedError

    def model(self) -> tuple[Vector, Vector]:
        """Return numerator and denominator of the estimate: in s if `physical`, else in q^-1."""
        raise NotImplementedError

    def root(self, values: Vector) -> Vector:
        """Return L, flat, of the covariance L Lᵀ of the physical parameters; NaN where unknown."""
        return [math.nan] * (len(values) * len(values))

    def shown_deviations(self, values: Vector) -> Vector:
        """Return their standard deviations for operators: the load may have changed since."""
        return [math.nan] * len(values)

    def input_offset(self) -> float:
        """Return the constant input with the effect of what is no dynamics; NaN without a bias."""
        raise NotImplementedError

    def offset_deviation(self) -> float:
        """Return its standard deviation, of the deviations shown last; NaN while unknown."""
        return math.nan

    def is_contested(self) -> bool:
        """Return whether the latest samples speak for another load than the estimate."""
        return self.detector.sum > 0.0

    def open_up(self) -> None:
        """Know nothing, and expect an offset of the size of a disturbance.

        The latter only where it rests and the nominal gain is known.

        Without this the first step of torque, which comes before the load is known, is learnt as
        dynamics with an offset that nothing can cause.
        """
        learning, own = self.learning, self.estimate
        vectors.copy_into(own.theta, [0.0] * len(own.theta))
        own.open_up(learning.initial_covariance)
        if learning.bias and learning.start_at_nominal and not (learning.charge or learning.drifts):
            last = len(own.diagonal) - 1
            expected = change.DISTURBANCE_SHARE * change.DISTURBANCE_SHARE / thresholds.NOISE_FLOOR
            own.diagonal[last] = min(own.diagonal[last], expected)

    def take_sample(
        self, sample: SlowSample, outputs: Vector, inputs: Vector, *, usable: bool
    ) -> None:
        """Take in one slow sample.

        Args:
            sample: The sample.
            outputs: y of the periods before it, the last one first.
            inputs: u of the periods before it.
            usable: False for a sample that must not teach: its innovation is still computed.
        """
        self.sample.time_s += sample.period_s
        self.sample.rounding = sample.rounding / self.learning.output_scale
        self.observe(sample, outputs, inputs)
        self.take_output(sample.output, usable=usable)

    def take_output(self, output: float, *, usable: bool) -> None:
        """Predict an output from r, and learn from it.

        Args:
            output: y[k].
            usable: As in `take_sample`.
        """
        own, sample = self.estimate, self.sample
        sample.target = output / self.learning.output_scale
        self.periods += 1
        self.decided = 0
        own.predict(sample.regressor, sample.target)
        self.show(own)
        usual = all(abs(one) < _LARGEST for one in (own.innovation, *sample.regressor))
        if not (usable and usual and math.isfinite(own.excitation)):
            return
        self.detector.track_noise(own.innovation)
        if self.periods > self.learning.settle_periods:
            self.learn()

    def learn_plainly(self) -> None:
        """Update θ and P by exponential forgetting (3), if the sample can teach anything."""
        own, sample, rho = self.estimate, self.sample, self.learning.forgetting
        if own.teaches(rho, self.learning.gate):
            own.update(sample.regressor, sample.target, rho)
            self.residuals.remember(own, rho)

    def show(self, estimate: Estimate) -> None:
        """Publish innovation and excitation of an estimate."""
        self.innovation = estimate.innovation * self.learning.output_scale
        self.excitation = estimate.excitation


class LambdaEstimator(Estimator):
    """The λ-method (LM-RLS): least squares on λ-filtered signals (29).

    Attributes:
        regression: θ and r.
        bank: The branches, of a bias that rests.
        incremental: A second estimate, whose bias walks.
        charge: Integral of the output since start over τ_λ, scaled.
        lost_periods: Slow periods in a row in which no load can be as `estimate` has it.
    """

    physical: ClassVar[bool] = True

    def __init__(self, learning: EstimatorSettings, load: Load, _taps: int) -> None:
        """Begin at zero, or at the nominal model.

        Args:
            learning: What is learnt, gates and scales.
            load: The nominal load.
            _taps: Not used: θ does not depend on past inputs.
        """
        regression = Regression(learning, load)
        super().__init__(learning, load, regression.size)
        self.regression = regression
        self.bank = Bank(regression)
        self.incremental = IncrementalModel(regression)
        self.charge = 0.0
        self.lost_periods = 0
        self._opened, self._opened_noise = Branch(regression), math.nan
        self._nominal = [0.0] * regression.size
        nominal = regression.theta_of(list(load.numerator), list(load.denominator))
        vectors.copy_into(self._nominal, nominal)
        self.open_up()
        if not learning.initial_state:  # γ = 0 is known: the load is at rest
            for i in range(regression.first, regression.first + regression.states):
                known = thresholds.NOISE_FLOOR * learning.initial_covariance
                self.bank.estimate.diagonal[i] = known
        if learning.start_at_nominal:
            vectors.copy_into(self.bank.estimate.theta, self._nominal)

    @property
    def estimate(self) -> Branch:
        """θ and P of a bias that rests: the branch of the bank that is believed."""
        return self.bank.estimate

    @property
    def in_force(self) -> Branch:
        """The estimate in force: the one whose bias rests, or the one whose bias walks."""
        return self.incremental.branch if self.incremental.in_force else self.bank.estimate

    def begin_anew(self) -> None:
        """Start from the nominal model again: an estimate that no load can have has lost its way.

        It learnt a disturbance as dynamics before the load was known, and what surprises it is
        explained by other disturbances ever since. An incremental model that is in force goes on.
        """
        own = self.bank.estimate
        self.open_up()
        vectors.copy_into(own.theta, self._nominal)
        own.origin_s, own.score = self.sample.time_s, 0.0
        self.bank.branches = [own]
        self.detector.sum = 0.0
        if not self.incremental.in_force:
            self.incremental.restart()

    def start_from(self, values: Vector) -> None:
        """Start from a load that an earlier run has learnt, no surer of it than of the nominal one.

        The load may have changed while the drive was off: only samples of this run say how exact
        its parameters are.

        Args:
            values: Its physical parameters.
        """
        theta = self.regression.theta_of(*self.load.realise(values))
        vectors.copy_into(self.bank.estimate.theta, theta)

    def observe(self, sample: SlowSample, _outputs: Vector, _inputs: Vector) -> None:
        """Overwrite r, and the lowered r for a change; the past is in the filters."""
        learning, own = self.learning, self.sample
        charged = sample.output / learning.output_scale * sample.period_s
        self.charge += charged / learning.tau_lambda_s
        elapsed_s = own.time_s - self.bank.estimate.origin_s
        self.regression.observe(own, sample, self.charge, elapsed_s)
        if learning.charge:
            self._widen_emf()

    def _widen_emf(self) -> None:
        """Let a slow period pass for an EMF that rises with the charge, at a rate that changes.

        At a constant current only the EMF moves: without this, what a straight line misses of its
        course would be mistaken for dynamics.
        """
        size = self.regression.size
        for one in self.bank.branches:
            for rise, bias in ((0.0, _EMF_NOISE), (_EMF_BEND, -_EMF_BEND * self.charge)):
                direction = [0.0] * size
                direction[size - 2], direction[size - 1] = rise, bias
                one.widen(direction, 1.0)

    def learn(self) -> None:
        """Update θ and P; branches explain an abrupt change where `alert` is set."""
        learning, own, rho = self.learning, self.bank.estimate, self.learning.forgetting
        if not learning.alert:
            self.learn_plainly()
            return
        if learning.bias and not learning.charge:  # the EMF of a battery walks already
            self.incremental.follow(self.sample, own)
        another = self.bank.learn(self.detector, self.sample)
        own = self.bank.estimate
        if another:
            self.decided = own.kind
            self.incremental.charge_disturbance(own)
            # what the one before could not explain is no noise
            usual = self.detector.noise_power(self.sample.rounding) * self.residuals.weight
            self.residuals.power = min(self.residuals.power, usual)
        if own.teaches(rho, learning.gate):
            self.residuals.remember(own, rho)
        self._count_unseen()
        self.show(self.in_force)

    def _count_unseen(self) -> None:
        """Count the slow periods since a sample that would have shown another load."""
        self.unseen_periods += 1
        noise = math.sqrt(self.detector.power)
        for i in range(self.regression.order):
            direction = self.regression.load_direction(self.bank.estimate.theta, i)
            if abs(vectors.dot(direction, self.sample.regressor)) > _SHOWN * noise:
                self.unseen_periods = 0

    def residual(self) -> float:
        """Squared innovation of the last sample, the estimate's own uncertainty taken out, scaled.

        A sample that teaches nothing is predicted too, and not by each branch.
        """
        innovation = self.innovation / self.learning.output_scale
        return normalised(innovation, self.excitation, self.learning.forgetting)

    def nominal_innovation(self) -> float:
        """Return the innovation that the nominal model has for the last sample, scaled."""
        return self.sample.target - vectors.dot(self._nominal, self.sample.regressor)

    def model(self) -> tuple[Vector, Vector]:
        """Return numerator and denominator of the estimated model in s."""
        return self.regression.model(self.in_force.theta)

    def noise(self) -> float:
        """Return σ of the innovations of the estimate in force, scaled; NaN while unknown."""
        swings = self.incremental.in_force
        residuals = self.incremental.residuals if swings else self.residuals
        return residuals.noise(self.regression.size)

    def root(self, values: Vector) -> Vector:
        """Return L, flat, of the covariance L Lᵀ of the physical parameters, to first order."""
        return self.regression.root(self.in_force, self.noise(), values)

    def is_contested(self) -> bool:
        """Return whether the latest samples speak for another load than the estimate."""
        return self.detector.sum > 0.0 or self.bank.is_contested

    def is_doubtful(self) -> bool:
        """Return whether the load may be another than the estimate."""
        return self.unseen_periods > thresholds.FEWEST or self.is_contested()

    def shown_deviations(self, values: Vector) -> Vector:
        """Return the standard deviations to be shown: wider while the load may be another.

        A bias that walks follows a disturbance, and its innovations are independent.

        Args:
            values: The physical parameters at θ.
        """
        opened, noise = self._opened, self.noise()
        opened.assign(self.in_force)
        rounding = thresholds.MEMORY * self.sample.rounding * self.sample.rounding
        noise = math.sqrt(noise * noise + thresholds.NOISE_FLOOR + rounding)
        if not self.incremental.in_force:
            noise *= self.residuals.correlation_factor()
        if self.learning.alert and noise > 0.0 and self.is_doubtful():
            spread = thresholds.UNKNOWN / noise
            for i in range(self.regression.order):
                direction = self.regression.load_direction(opened.theta, i)
                opened.widen(direction, spread * spread)
        self._opened_noise = noise
        return self.regression.deviations(opened, noise, values)

    def input_offset(self) -> float:
        """Return the constant input with the effect of bias and charge; NaN without a bias."""
        return self.regression.input_offset(self.in_force.theta, self.charge)

    def offset_deviation(self) -> float:
        """Return its standard deviation, of the deviations shown last; NaN while unknown."""
        return self.regression.offset_deviation(self._opened, self._opened_noise, self.charge)
