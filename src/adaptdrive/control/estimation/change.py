"""Abrupt changes: how they are detected, and what may have moved in one.

The normalised innovation z² = ε² ρ / ((ρ + rᵀPr) σ²) of a settled estimate is about 1. A one-sided
cumulative sum (E. S. Page, Biometrika 41, 1954, doi:10.1093/biomet/41.1-2.100)

    S <- max(0, S + z² - drift)          alarm when S > threshold, S = 0 after it

stays at 0 then, and reaches the threshold within a few samples of a change. σ² follows the median
of z² σ², which is 0.455 of the mean for Gaussian noise: a change moves it hardly, however large it
is. It has a floor against rounding and model error.

While an estimate is new, its innovations are a poor measure of σ². The noise of a sample shows in
their second differences, (ε[k] - 2 ε[k-1] + ε[k-2])² / 6 on average, whatever slow error is
under it.

Let θ jump by Δ at t0. The regression with the new θ then has the error e = y - rᵀθ = -r(t0)ᵀΔ at
t0, and (τ_λ p + 1)^m e = 0 from there on, because every term of it has passed the λ filters:

    e(t) = Σ c_i h^i e^-h      h = (t - t0)/τ_λ     c_i = -(1/i!) ((τ_λ p + 1)^i r)(t0)ᵀ Δ

These are the functions of the initial state, counted from t0. Their weights γ are therefore not
free: with a direction of Δ goes a direction of γ. (τ_λ p + 1) λ^j y is λ^(j-1) y, so that
(τ_λ p + 1) r is the regressor with every power of λ lowered by one.

A disturbance of the input moves the bias. A load that changes keeps its dc gain, and the offset of
its input: inertia, volume. Either may come with the other, and with another gain.
"""

import math

from adaptdrive.control import thresholds, vectors
from adaptdrive.control.estimation.regression import Observation, Regression
from adaptdrive.control.estimation.rls import Estimate
from adaptdrive.control.vectors import Vector

# Detection of an abrupt change from the innovations of the estimate.

DRIFT = 3.0
"""Subtracted from each z²: the sum rises only while z² is larger than three times its mean."""

THRESHOLD = 2.0 * thresholds.RARE
"""One z² above 13, or several smaller ones in a row: as rare with noise alone as a disturbance."""

_FAST_RATE = 0.3
"""Rate of the median after a start: within a factor of 2 after about 3 samples."""

_SLOW_RATE = 2.0 / thresholds.MEMORY
"""Rate of the median later: a factor of 2 takes 20 samples, longer than a comparison."""

_MEDIAN = 0.455
"""Median over mean of the square of Gaussian noise (χ² with one degree of freedom)."""

LEAST_NOISE = 1e-2 * thresholds.NOISE_FLOOR
"""Least mean square of noise that is followed: a tenth of the deviation that the bank counts."""


class ChangeDetector:
    """Detector of abrupt changes.

    Attributes:
        power: σ², of the innovations in units of the scaled output.
        sum: S.
        samples: Samples seen.
        alarms: Alarms so far.
        noise: Mean square of the noise of a sample, from second differences.
    """

    def __init__(self) -> None:
        """Begin with the least noise."""
        self.power = 0.0
        self.sum = 0.0
        self.samples = 0
        self.alarms = 0
        self.noise = thresholds.NOISE_FLOOR
        self._last = 0.0
        self._slope = 0.0

    def noise_power(self, rounding: float) -> float:
        """Return σ², at least the variance of the rounding error of a sample."""
        return max(thresholds.NOISE_FLOOR, self.power, rounding * rounding)

    def is_change(self, squared: float, power: float) -> bool:
        """Take in an innovation; return whether the load has just changed.

        Args:
            squared: ε² ρ / (ρ + rᵀPr), scaled.
            power: σ² of this sample, from `noise_power`.
        """
        self.samples += 1
        if self.samples <= thresholds.WINDOW:
            self.power = max(thresholds.NOISE_FLOOR, self.noise)
            return False
        ratio = squared / power
        self.power = max(thresholds.NOISE_FLOOR, move_median(self.power, squared, _SLOW_RATE))
        self.sum = max(0.0, self.sum + ratio - DRIFT)
        if self.sum <= THRESHOLD:
            return False
        self.sum = 0.0
        self.alarms += 1
        return True

    def track_noise(self, innovation: float) -> None:
        """Follow the noise of a sample, which no slow error hides.

        Args:
            innovation: ε, scaled.
        """
        slope = innovation - self._last
        bend = slope - self._slope
        squared = bend * bend / 6.0  # a power would raise where it overflows
        self._last, self._slope = innovation, slope
        rate = _FAST_RATE if self.samples <= thresholds.WINDOW else _SLOW_RATE
        self.noise = max(LEAST_NOISE, move_median(self.noise, squared, rate))


def move_median(power: float, squared: float, rate: float) -> float:
    """Move a mean square so that its median is that of Gaussian noise."""
    return power * (1.0 + (rate if squared > _MEDIAN * power else -rate))


# What may have moved, as directions in which θ becomes uncertain.

DISTURBANCE = 1
LOAD = 2
ANEW = 3

WORDS = {0: "", DISTURBANCE: "disturbance", LOAD: "load", ANEW: "load and disturbance"}

ODDS_AGAINST = {
    DISTURBANCE: thresholds.RARE,
    LOAD: thresholds.RARE + thresholds.RARER,
    ANEW: thresholds.RARE + 2.0 * thresholds.RARER,
}
"""Log odds against each at an alarm."""

DISTURBANCE_SHARE = 0.1
"""Deviation of a disturbance, of the input's scale: 30 V of 300 V."""

OFFSET_WALK = 1.0 / thresholds.WINDOW
"""Random walk of an offset that drifts, in σ for each slow period: it is a mean over a window."""


class Branch(Estimate):
    """An estimate that assumes a change, and how probable it is.

    Attributes:
        kind: Kind of change that it assumes, 0 for none.
        origin_s: Since when the functions of the initial state are counted.
        score: Logarithm of its probability over that of the most probable branch.
        age: Samples since it was split off.
    """

    def __init__(self, regression: Regression) -> None:
        """Begin with zeros, and sure of them.

        Args:
            regression: What is learnt.
        """
        super().__init__(regression.size)
        self._regression = regression
        self.kind = 0
        self.origin_s = 0.0
        self.score = 0.0
        self.age = 0

    def assign(self, other: "Branch") -> None:
        """Overwrite θ, P, origin and the last prediction by those of another branch."""
        vectors.copy_into(self.theta, other.theta)
        vectors.copy_into(self.upper, other.upper)
        vectors.copy_into(self.diagonal, other.diagonal)
        self.origin_s = other.origin_s
        self.innovation, self.excitation = other.innovation, other.excitation

    def predict_sample(self, sample: Observation) -> None:
        """Predict a sample whose functions of the initial state are counted from the origin.

        Args:
            sample: The functions of the initial state in it are overwritten.
        """
        self._regression.fill_state(sample.regressor, sample.time_s - self.origin_s)
        self.predict(sample.regressor, sample.target)

    def learn_sample(self, sample: Observation) -> None:
        """Take in one sample, with directional forgetting of what does not walk.

        An offset that drifts, the inflow temperature of a bath, follows a random walk, which
        widens P (Ljung, System Identification, section 11.2), and that is all that is forgotten of
        it. The walk of a charge is in `estimator`.

        Args:
            sample: The functions of the initial state in it are overwritten.
        """
        regression, learning = self._regression, self._regression.learning
        regression.fill_state(sample.regressor, sample.time_s - self.origin_s)
        rho, gate = learning.forgetting, learning.gate
        self.update_beside(sample.regressor, sample.target, rho, gate, regression.walks)
        if regression.walks == 1:
            self.widen_entry(regression.size - 1, OFFSET_WALK * OFFSET_WALK)

    def restart_past(self, time_s: float) -> None:
        """Count the functions of the initial state from another time; θ and P follow.

        Args:
            time_s: The new origin, not before the old one.
        """
        regression = self._regression
        size, first, count = regression.size, regression.first, regression.states
        shift = (time_s - self.origin_s) / regression.learning.tau_lambda_s
        weights, matrix = _shifted_functions(count, shift), vectors.identity(size)
        for i in range(count):
            for j in range(count):
                matrix[(first + i) * size + first + j] = weights[i * count + j]
        self.transform(matrix)
        self.origin_s = time_s

    def open_for(self, kind: int, point: Observation, power: float, gap_s: float) -> None:
        """Open the estimate up for what a kind of change may have moved.

        Args:
            kind: DISTURBANCE, LOAD, or ANEW for both, another gain and the state of the load.
            point: The last sample before the change.
            power: σ² of the innovations.
            gap_s: From there to the first sample after the change.
        """
        regression, learning = self._regression, self._regression.learning
        spread = DISTURBANCE_SHARE * abs(regression.gain(self.theta))
        if kind != LOAD and learning.bias:
            self._open(vectors.unit(regression.size, regression.size - 1), spread, point, power)
        if kind != DISTURBANCE:  # other dynamics with the same dc gain and offset of the input
            for i in range(regression.first - 1):
                direction = regression.load_direction(self.theta, i)
                self._open(direction, thresholds.PRIOR_SHARE, point, power)
        if kind == ANEW:
            direction = regression.gain_direction(self.theta)
            self._open(direction, thresholds.PRIOR_SHARE, point, power)
        share = min(1.0, gap_s / learning.tau_lambda_s)  # the moment of the change is in doubt
        self._widen_state(share * share * spread * spread / power)
        if kind == ANEW:  # a disk that lands at rest takes half the speed away
            self._widen_state(thresholds.PRIOR_SHARE * thresholds.PRIOR_SHARE / power)

    def _open(self, direction: Vector, spread: float, point: Observation, power: float) -> None:
        """Widen P by a spread along a direction of θ and along what goes with it in γ."""
        first, count = self._regression.first, self._regression.states
        plain = vectors.dot(point.regressor, direction)
        if count > 1:
            direction[first + 1] = -vectors.dot(point.lowered, direction)
        direction[first] = -plain
        self.widen(direction, spread * spread / power)

    def _widen_state(self, variance: float) -> None:
        """Widen γ, what is left of the state at the change, by itself."""
        for i in range(self._regression.states):
            self.widen_entry(self._regression.first + i, variance)


def _shifted_functions(count: int, shift: float) -> Vector:
    """Weights of h^i e^-h that make of Σ γ_j (h + s)^j e^-(h + s) the same course."""
    weights = [0.0] * (count * count)
    for j in range(count):
        factor = math.exp(-shift)  # C(j, i) s^(j - i) e^-s, from i = j down
        for i in range(j, -1, -1):
            weights[i * count + j] = factor
            factor *= shift * i / (j - i + 1)
    return weights
