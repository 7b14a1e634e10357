"""The λ-method (LM-RLS): recursive least squares on signals behind λ filters.

θ and r are in `regression`. θ is a model in s, so that the physical parameters of the load follow.
"""

from __future__ import annotations

from dataclasses import dataclass

from adaptdrive.control import regression as reg
from adaptdrive.control.doubt import doubted_deviations, note_age
from adaptdrive.control.estimator import EstimatorState, let_emf_wander, take_in
from adaptdrive.control.evidence import NOISE_FLOOR
from adaptdrive.control.explanation import learn_and_explain
from adaptdrive.control.in_force import in_force, parameter_root, show
from adaptdrive.control.integrated import follow
from adaptdrive.control.load import Load
from adaptdrive.control.redesign import judge_physical
from adaptdrive.control.settings import ControllerSettings, Learning
from adaptdrive.control.slow_state import SlowSample, SlowState
from adaptdrive.control.vectors import Vector


@dataclass(frozen=True, slots=True)
class LambdaMethod:
    """Least squares on λ-filtered signals (29); the functions are described in `Method`."""

    @property
    def physical(self) -> bool:
        """True: θ is a model in s."""
        return True

    def parameter_count(self, learning: Learning, load: Load, taps: int) -> int:
        """Return the length of θ, which does not depend on the past inputs."""
        return reg.filtered_count(learning, load)

    def theta_of(
        self, learning: Learning, load: Load, numerator: Vector, denominator: Vector
    ) -> Vector:
        """Return α and β of a model in s, scaled."""
        return reg.theta_of(learning, load, numerator, denominator)

    def begin(self, state: EstimatorState, learning: Learning, load: Load) -> None:
        """Take γ = 0 as known where the initial state is not learnt: the load is at rest."""
        if learning.initial_state:
            return
        first = reg.fitted_order(learning, load) + len(load.input_powers)
        for i in range(reg.initial_state_count(learning, load)):
            state.estimate.diagonal[first + i] = NOISE_FLOOR * learning.initial_covariance

    def fill_regressor(
        self, state: SlowState, learning: Learning, load: Load, sample: SlowSample
    ) -> None:
        """Overwrite r, and r with every power of λ lowered by one for the explanations."""
        estimator, y, u = state.estimator, sample.output_filtered, sample.input_filtered
        regressor = estimator.sample.regressor
        elapsed_s = estimator.sample.time_s - estimator.estimate.origin_s
        reg.fill_filtered_regressor(regressor, learning, load, y, u)
        reg.fill_initial_state(regressor, learning, load, elapsed_s)
        reg.fill_charge(regressor, learning, estimator.charge)
        let_emf_wander(estimator, learning)
        lowered, output = estimator.rivals.lowered, sample.output
        reg.fill_lowered_regressor(lowered, learning, load, output, y, u)
        reg.fill_charge(lowered, learning, estimator.charge + output / learning.output_scale)

    def target(self, learning: Learning, sample: SlowSample) -> float:
        """Return y[k]."""
        return sample.output

    def take_in(self, state: EstimatorState, learning: Learning, load: Load) -> None:
        """Update θ and P; an abrupt change is explained where `alert` is set."""
        own, sample = state.estimate, state.sample
        if not learning.alert:
            take_in(state, learning, directional=False)
            return
        follow(state.integrated, learning, load, sample, own)
        reg.fill_initial_state(sample.regressor, learning, load, sample.time_s - own.origin_s)
        learn_and_explain(state, learning, load)
        note_age(state, learning, load)
        show(state, learning)

    def model(
        self, settings: ControllerSettings, load: Load, state: SlowState, period_s: float
    ) -> tuple[Vector, Vector, int]:
        """Return A and B of the estimated model in s, and the verdict on its parameters."""
        learning, theta = settings.learning, in_force(state.estimator).theta
        numerator, denominator = reg.filtered_model(theta, learning, load)
        return judge_physical(settings, load, state, numerator, denominator, period_s)

    def root(self, state: EstimatorState, learning: Learning, load: Load, values: Vector) -> Vector:
        """Return L of the covariance of the physical parameters, to first order."""
        return parameter_root(state, learning, load, values)

    def shown_deviations(
        self, state: EstimatorState, learning: Learning, load: Load, values: Vector
    ) -> Vector:
        """Return their deviations, with what the load may be since the samples showed it."""
        return doubted_deviations(state, learning, load, values)

    def input_offset(self, state: EstimatorState, learning: Learning, load: Load) -> float:
        """Return the constant input with the effect of bias and charge; NaN without a bias."""
        return reg.input_offset(in_force(state).theta, learning, load, state.charge)
