"""Interface of an estimation method: what is learnt, from which signals, and what follows from it.

`methods` lists the methods by the names of the configuration. A method has no state:
θ and P are in `EstimatorState`, so that the same object serves every controller.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from adaptdrive.control.estimation.estimator import EstimatorState
    from adaptdrive.control.loads.load import Load
    from adaptdrive.control.settings import ControllerSettings, Learning
    from adaptdrive.control.slow_state import SlowSample, SlowState
    from adaptdrive.control.vectors import Vector


class Method(Protocol):
    """One way to learn the load: parameters θ, regressor r, target, update and model."""

    @property
    def physical(self) -> bool:
        """True if θ follows from the physical parameters of the load.

        Only then can an estimate start from these, be compared with the nominal model, and be
        kept for the next run.
        """

    def parameter_count(self, learning: Learning, load: Load, taps: int) -> int:
        """Return the length of θ; `taps` is the number of past inputs of the discrete model."""

    def theta_of(
        self, learning: Learning, load: Load, numerator: Vector, denominator: Vector
    ) -> Vector:
        """Return the first entries of θ for a model in s, scaled; empty if not `physical`."""

    def begin(self, state: EstimatorState, learning: Learning, load: Load) -> None:
        """Adjust P of a new estimator to what is known of the start."""

    def fill_regressor(
        self, state: SlowState, learning: Learning, load: Load, sample: SlowSample
    ) -> None:
        """Overwrite r by that of a slow sample; `state` holds the samples before it."""

    def target(self, learning: Learning, sample: SlowSample) -> float:
        """Return the value that r predicts, in the unit of the output."""

    def take_in(self, state: EstimatorState, learning: Learning, load: Load) -> None:
        """Update θ and P by the last sample, which the estimate has predicted."""

    def model(
        self, settings: ControllerSettings, load: Load, state: SlowState, period_s: float
    ) -> tuple[Vector, Vector, int]:
        """Return A and B of the estimate, and the verdict on its parameters."""

    def root(self, state: EstimatorState, learning: Learning, load: Load, values: Vector) -> Vector:
        """Return L, flat, of the covariance L Lᵀ of the physical parameters; NaN where unknown."""

    def shown_deviations(
        self, state: EstimatorState, learning: Learning, load: Load, values: Vector
    ) -> Vector:
        """Return their standard deviations for operators: the load may have changed since."""

    def input_offset(self, state: EstimatorState, learning: Learning, load: Load) -> float:
        """Return the constant input with the effect of what is no dynamics; NaN without a bias."""
