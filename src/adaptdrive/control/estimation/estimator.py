"""The on-line estimator: recursive least squares with a gate, and a bank of branches.

What is learnt, from which signals and by which update is in the file of the method (`methods`); the
arithmetic of the update is in `rls`, and what an abrupt change does in `change` and `bank`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from adaptdrive.control import thresholds, vectors
from adaptdrive.control.estimation import change, regression, rls
from adaptdrive.control.estimation.bank import (
    Bank,
    IncrementalModel,
    charge_disturbance,
    learn_branches,
    new_bank,
    restart,
)
from adaptdrive.control.estimation.branch import (
    Branch,
    Observation,
    new_branch,
    predict,
    squared_error,
    teaches,
)
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import EstimatorSettings
from adaptdrive.control.vectors import Vector

_LARGEST = 1.0e20
"""Largest scaled entry of a sample, for which 1 is usual: the squares of larger ones overflow P."""

_EMF_NOISE = 0.2
"""Random walk of an EMF in each slow period, in σ of a sample: its charge is no more exact."""

_EMF_BEND = 0.1
"""Random walk of its rise, in σ, for a charge of τ_λ times the output's scale."""


class Method(Protocol):
    """One way to learn the load: parameters θ, regressor r, target, update and model.

    A method has no state, so that the same object serves every controller.
    """

    @property
    def physical(self) -> bool:
        """True if θ follows from the physical parameters of the load.

        Only then can an estimate start from these, be compared with the nominal model, and be
        kept for the next run.
        """

    def parameter_count(self, learning: EstimatorSettings, load: Load, taps: int) -> int:
        """Return the length of θ; `taps` is the number of past inputs of the discrete model."""

    def theta_of(
        self, learning: EstimatorSettings, load: Load, numerator: Vector, denominator: Vector
    ) -> Vector:
        """Return the first entries of θ for a model in s, scaled; empty if not `physical`."""

    def begin(self, state: EstimatorState, learning: EstimatorSettings, load: Load) -> None:
        """Adjust P of a new estimator to what is known of the start."""

    def fill_regressor(
        self,
        state: EstimatorState,
        learning: EstimatorSettings,
        load: Load,
        sample: regression.SlowSample,
        past: tuple[Vector, Vector],
    ) -> None:
        """Overwrite r by that of a slow sample; `past` are y and u of the periods before it."""

    def take_in(self, state: EstimatorState, learning: EstimatorSettings, load: Load) -> None:
        """Update θ and P by the last sample, which the estimate has predicted."""

    def model(
        self, state: EstimatorState, learning: EstimatorSettings, load: Load
    ) -> tuple[Vector, Vector]:
        """Return numerator and denominator of the estimate: in s if `physical`, else in q^-1."""

    def root(
        self, state: EstimatorState, learning: EstimatorSettings, load: Load, values: Vector
    ) -> Vector:
        """Return L, flat, of the covariance L Lᵀ of the physical parameters; NaN where unknown."""

    def shown_deviations(
        self, state: EstimatorState, learning: EstimatorSettings, load: Load, values: Vector
    ) -> Vector:
        """Return their standard deviations for operators: the load may have changed since."""

    def input_offset(self, state: EstimatorState, learning: EstimatorSettings, load: Load) -> float:
        """Return the constant input with the effect of what is no dynamics; NaN without a bias."""


@dataclass(slots=True)
class EstimatorState:
    """State of the estimator.

    Attributes:
        method: What is learnt, and from which signals.
        opened: The estimate in force, with what the load may have become.
        sample: The last sample.
        residual_power: Forgetting sum of squared normalised innovations.
        residual_weight: Forgetting count of them.
        residual_lag: Forgetting sum of the products of each and the one before.
        residual_last: The last of them.
        innovation: ε of the last sample, in the unit of the output.
        excitation: rᵀPr of the last sample.
        periods: Slow periods since start.
        lost_periods: Slow periods in a row in which no load can be as `estimate` has it.
        charge: Integral of the output since start over τ_λ, scaled.
        detector: Detector of abrupt changes.
        bank: The branches, of a bias that rests.
        unseen_periods: Slow periods since a sample that would have shown another load.
        incremental: A second estimate, whose bias walks.
    """

    method: Method
    opened: Branch
    sample: Observation
    detector: change.ChangeDetector
    bank: Bank
    incremental: IncrementalModel
    residual_power: float = 0.0
    residual_weight: float = 0.0
    residual_lag: float = 0.0
    residual_last: float = 0.0
    innovation: float = math.nan
    excitation: float = 0.0
    periods: int = 0
    lost_periods: int = 0
    charge: float = 0.0
    unseen_periods: int = 0

    @property
    def estimate(self) -> Branch:
        """Return θ and P of a bias that rests: the branch of the bank that is believed."""
        return self.bank.estimate


def new_estimator(
    method: Method, learning: EstimatorSettings, load: Load, taps: int
) -> EstimatorState:
    """Return an estimator without data, which starts from zero or from the nominal model."""
    count = method.parameter_count(learning, load, taps)
    state = EstimatorState(
        method,
        new_branch(count),
        Observation([0.0] * count, [0.0] * count),
        change.ChangeDetector(),
        new_bank(count),
        IncrementalModel(new_branch(count)),
    )
    _open(state.estimate, learning)
    method.begin(state, learning, load)
    if learning.start_at_nominal:
        vectors.copy_into(state.estimate.theta, nominal_theta(method, learning, load, taps))
    return state


def nominal_theta(method: Method, learning: EstimatorSettings, load: Load, taps: int) -> Vector:
    """Return θ of the nominal model, scaled; zeros where the method cannot express it."""
    theta = [0.0] * method.parameter_count(learning, load, taps)
    numerator, denominator = list(load.numerator), list(load.denominator)
    vectors.copy_into(theta, method.theta_of(learning, load, numerator, denominator))
    return theta


def _open(estimate: Branch, learning: EstimatorSettings) -> None:
    """Know nothing, and expect an offset of the size of a disturbance.

    The latter only where it rests and the nominal gain is known.

    Without this the first step of torque, which comes before the load is known, is learnt as
    dynamics with an offset that nothing can cause.
    """
    diagonal = estimate.diagonal
    rls.reset(estimate.theta, estimate.upper, diagonal, learning.initial_covariance)
    if learning.bias and learning.start_at_nominal and not (learning.charge or learning.drifts):
        expected = change.DISTURBANCE_SHARE * change.DISTURBANCE_SHARE / thresholds.NOISE_FLOOR
        diagonal[len(diagonal) - 1] = min(diagonal[len(diagonal) - 1], expected)


def begin_anew(state: EstimatorState, learning: EstimatorSettings, load: Load) -> None:
    """Start from the nominal model again: an estimate that no load can have has lost its way.

    It learnt a disturbance as dynamics before the load was known, and what surprises it is
    explained by other disturbances ever since.

    Args:
        state: Overwritten; an incremental model that is in force goes on.
        learning: Scales.
        load: The nominal model.
    """
    own, numerator, denominator = state.estimate, list(load.numerator), list(load.denominator)
    _open(own, learning)
    vectors.copy_into(own.theta, state.method.theta_of(learning, load, numerator, denominator))
    own.origin_s, own.score = state.sample.time_s, 0.0
    state.bank.branches = [own]
    state.detector.sum = 0.0
    if not state.incremental.in_force:
        restart(state.incremental)


def start_from(
    state: EstimatorState, learning: EstimatorSettings, load: Load, values: Vector
) -> None:
    """Start from a load that an earlier run has learnt, no surer of it than of the nominal model.

    The load may have changed while the drive was off: only samples of this run say how exact its
    parameters are.

    Args:
        state: A new estimator of a method with physical parameters, overwritten.
        learning: Scales.
        load: The load.
        values: Its physical parameters.
    """
    numerator, denominator = load.realise(values)
    theta = state.method.theta_of(learning, load, numerator, denominator)
    vectors.copy_into(state.estimate.theta, theta)


def update_estimate(
    state: EstimatorState, learning: EstimatorSettings, load: Load, output: float, usable: bool
) -> None:
    """Take in one slow sample whose regressor has been filled in.

    Args:
        state: Overwritten.
        learning: Forgetting and gates.
        load: What an abrupt change leaves as it was.
        output: y[k], which r predicts.
        usable: False for a sample that must not teach: its innovation is still computed.
    """
    own, sample = state.estimate, state.sample
    sample.target = output / learning.output_scale
    state.periods += 1
    predict(own, sample)
    state.excitation = own.excitation
    state.innovation = own.innovation * learning.output_scale
    usual = abs(own.innovation) < _LARGEST and all(abs(one) < _LARGEST for one in sample.regressor)
    if not (usual and math.isfinite(own.excitation)):
        return
    if not usable:
        return
    change.track_noise(state.detector, own.innovation)
    if state.periods > learning.settle_periods:
        state.method.take_in(state, learning, load)


def take_in(state: EstimatorState, learning: EstimatorSettings) -> None:
    """Update θ and P by forgetting, if the sample can teach anything.

    Args:
        state: Its estimate has predicted the sample; overwritten.
        learning: Forgetting and gates.
    """
    own, sample, rho = state.estimate, state.sample, learning.forgetting
    if not teaches(own, learning):
        return
    theta, upper, diagonal = own.theta, own.upper, own.diagonal
    rls.update(theta, upper, diagonal, sample.regressor, sample.target, rho)
    remember_residual(state, own, rho)


def learn_in_bank(state: EstimatorState, learning: EstimatorSettings, load: Load) -> None:
    """Let the bank take in a sample; its most probable branch is the estimate.

    Args:
        state: Overwritten.
        learning: Forgetting and gates.
        load: Order and structure.
    """
    detector, rho = state.detector, learning.forgetting
    another = learn_branches(state.bank, detector, learning, load, state.sample)
    own = state.estimate
    state.excitation = own.excitation
    state.innovation = own.innovation * learning.output_scale
    if another:
        charge_disturbance(state.incremental, own)
        # what the one before could not explain is no noise
        usual = change.noise_power(detector, state.sample.rounding) * state.residual_weight
        state.residual_power = min(state.residual_power, usual)
    if teaches(own, learning):
        remember_residual(state, own, rho)


def widen_emf(state: EstimatorState, learning: EstimatorSettings) -> None:
    """Let a slow period pass for an EMF that rises with the charge, at a rate that changes slowly.

    At a constant current only the EMF moves: without this, what a straight line misses of its
    course would be mistaken for dynamics.

    Args:
        state: P of every branch is overwritten.
        learning: Whether a charge is learnt.
    """
    if not learning.charge:
        return
    for one in state.bank.branches:
        _wander(one, 0.0, _EMF_NOISE)
        _wander(one, _EMF_BEND, -_EMF_BEND * state.charge)


def _wander(branch: Branch, rise: float, bias: float) -> None:
    """Widen P along a change of the rise with the charge and of the bias."""
    direction = [0.0] * len(branch.theta)
    direction[len(direction) - 2], direction[len(direction) - 1] = rise, bias
    rls.widen(branch.upper, branch.diagonal, direction, 1.0)


def remember_residual(state: EstimatorState, branch: Branch, forgetting: float) -> None:
    """Add the innovation of a branch to the forgetting sums from which σ follows."""
    power = squared_error(branch, forgetting)
    state.residual_power = forgetting * state.residual_power + power
    state.residual_weight = forgetting * state.residual_weight + 1.0
    own = math.copysign(math.sqrt(max(0.0, power)), branch.innovation)
    state.residual_lag = forgetting * state.residual_lag + own * state.residual_last
    state.residual_last = own
