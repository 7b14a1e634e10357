"""The supervisor: estimates are judged before they reach the gains.

An estimate that fails leaves the law to the fixed controller. With little
excitation a wrong estimate can look sure of itself: a slow sine determines the gain and one more
number, not three. So an estimate must also be one that such a load can have. Masses, baths and
cells only store and lose: their poles are real, the damping of a second-order pair

    ζ = d_1 / (2 √d_0)                                  of s² + d_1 s + d_0

is at least 1, and what noise takes from that is little.
"""

import math
from enum import IntEnum

from adaptdrive.control import thresholds, vectors
from adaptdrive.control.design.pole_placement import is_stable
from adaptdrive.control.loads.load import is_damped
from adaptdrive.control.settings import SupervisionLimits
from adaptdrive.control.vectors import Vector

_TINY = 1e-12
"""Below this a coefficient counts as zero: the model has no dc gain."""

_RESIDUAL_RATE = 1.0 / thresholds.WINDOW
"""Rate of the mean residuals: a mean over about 20 slow periods."""

_RESIDUAL_FLOOR = 100.0 * thresholds.NOISE_FLOOR
"""Ten times the least deviation, squared, a thousandth of the scale: at rest, less is noise."""


class Verdict(IntEnum):
    """Result of the supervisor's checks of an estimate."""

    TRUSTED = 0
    WARMING_UP = 1
    NOT_FINITE = 2
    UNSTABLE_LOAD = 3
    OUT_OF_BOUNDS = 4
    UNSTABLE_LOOP = 5
    UNCERTAIN = 6
    WORSE_THAN_FIXED = 7
    SETTLING = 8
    UNDERDAMPED = 9


class Supervisor:
    """Judge of the estimates of one run.

    Attributes:
        nominal: Nominal physical parameters.
        verdict: The last verdict.
        trusted: True while the adaptive gains may be in force.
        good_periods: Accepted estimates in a row.
        own_power: Slow mean square of the estimate's own innovations, scaled.
        fixed_power: The same of the nominal model.
        fixed_mean: Slow mean of the nominal model's innovations, scaled.
    """

    def __init__(self, limits: SupervisionLimits, nominal: Vector) -> None:
        """Begin without an estimate.

        Args:
            limits: Bounds, margins and times.
            nominal: Nominal physical parameters.
        """
        self._limits = limits
        self.nominal = nominal
        self.verdict: int = Verdict.WARMING_UP
        self.trusted = False
        self.good_periods = 0
        self.own_power = 0.0
        self.fixed_power = 0.0
        self.fixed_mean = 0.0

    def compare_residuals(self, own: float, fixed: float) -> None:
        """Remember how well the estimate and the nominal model predicted this sample.

        Args:
            own: Squared innovation of the estimate, its own uncertainty taken out, scaled.
            fixed: Innovation of the nominal model, scaled.
        """
        self.own_power += _RESIDUAL_RATE * (own - self.own_power)
        self.fixed_power += _RESIDUAL_RATE * (fixed * fixed - self.fixed_power)
        self.fixed_mean += _RESIDUAL_RATE * (fixed - self.fixed_mean)

    def out_of_bounds(self, values: Vector) -> int:
        """Return the first parameter that is out of its bounds around the nominal one; -1 for none.

        Args:
            values: Physical parameters.
        """
        limits = self._limits
        for i in range(len(values)):
            if not limits.ratio_min <= values[i] / self.nominal[i] <= limits.ratio_max:
                return i
        return -1

    def judge_parameters(self, values: Vector, denominator: Vector) -> int:
        """Check whether a load can have a model: within its bounds, and damped as with losses.

        Args:
            values: Physical parameters of the model.
            denominator: Of the model in s, highest power first.
        """
        least = self._limits.damping_min
        if self.out_of_bounds(values) >= 0:
            return Verdict.OUT_OF_BOUNDS
        if least > 0.0 and not is_damped(denominator, least):
            return Verdict.UNDERDAMPED
        return Verdict.TRUSTED

    def judge_residual(self) -> int:
        """Check whether the estimate predicts no worse than the nominal model does."""
        margin = self._limits.residual_margin * self._limits.residual_margin
        if margin > 0.0 and self.own_power > margin * self.fixed_power + _RESIDUAL_FLOOR:
            return Verdict.WORSE_THAN_FIXED
        return Verdict.TRUSTED

    def better_than_nominal(self) -> float:
        """Return rms errors of the nominal model over those of the estimate; 1 for small ones."""
        return self._over_own_errors(self.fixed_power)

    def moves_better_than_nominal(self) -> float:
        """Return the ratio of `better_than_nominal` without the mean error of the nominal model.

        The integrator of the fixed controller removes a constant error, which a wrong gain or a
        load torque causes; wrong dynamics remain.
        """
        return self._over_own_errors(self.fixed_power - self.fixed_mean * self.fixed_mean)

    def _over_own_errors(self, power: float) -> float:
        """Return an rms error over that of the estimate from its square; 1 where it is small."""
        if vectors.lacks(power, _RESIDUAL_FLOOR):
            return 1.0
        return math.sqrt(power / max(self.own_power, _RESIDUAL_FLOOR))

    def take_verdict(self, verdict: int, periods: int, *, in_force: bool) -> bool:
        """Remember a verdict; return whether the new gains may take effect.

        Doubt that comes up while the trusted gains are in force counts as much as error: their own
        samples contradict the estimate, and gains for a heavier load than the present one
        oscillate before the new load is known. Doubt for lack of excitation, while they wait,
        leaves them as they are.

        Args:
            verdict: Of the estimate of this period.
            periods: Slow periods since start.
            in_force: Whether the trusted gains are what holds the load.
        """
        self.verdict = verdict
        if verdict != Verdict.TRUSTED:
            contradicted = in_force and self.good_periods > 0
            if self._limits.revokes and (contradicted or not is_uncertain(verdict)):
                self.trusted = False
            self.good_periods = 0
            return False
        self.good_periods += 1
        if periods <= self._limits.warm_up_periods:
            self.verdict = Verdict.WARMING_UP
            return False
        if self.good_periods < self._limits.dwell_periods:
            self.verdict = Verdict.SETTLING
            return False
        self.trusted = True
        return True


def judge_model(numerator: Vector, denominator: Vector) -> int:
    """Check whether a continuous model can be used at all: finite, and with a dc gain."""
    finite = vectors.all_finite(numerator) and vectors.all_finite(denominator)
    if not finite or abs(denominator[len(denominator) - 1]) < _TINY:
        return Verdict.NOT_FINITE
    return Verdict.TRUSTED


def judge_poles(polynomial: Vector, refusal: int) -> int:
    """Check whether a polynomial in z is finite and stable.

    Args:
        polynomial: A of the discrete model, or A_c of the designed loop.
        refusal: Verdict on one that is not stable.
    """
    if is_stable(polynomial):
        return Verdict.TRUSTED
    return refusal if vectors.all_finite(polynomial) else Verdict.NOT_FINITE


def is_uncertain(verdict: int) -> bool:
    """Check whether the estimate is not wrong, but not known well enough."""
    return verdict in {Verdict.UNCERTAIN, Verdict.UNDERDAMPED}
