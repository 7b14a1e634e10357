"""A bank of models: what has changed, decided by how well each explanation predicts.

An alarm (`change`) shows that something has changed, and not what. The most probable branch then
splits: it goes on as if nothing had changed, and children assume that since the last sample a
disturbance of the input has begun, that the load is another, or both with another gain and state.
Every branch predicts each sample before it learns it, and the logarithm of its probability moves by

    -1/2 (ln(1 + rᵀPr/ρ) + min(z², outlier))        z² = ε² ρ / ((ρ + rᵀPr) σ²)

less, for a child, the odds against such a change. The first term is the price of an explanation
that fits anything. The most probable branch is the estimate; improbable ones end. Adaptive
forgetting through multiple models: P. Andersson, Int. J. Control 42, 1985,
doi:10.1080/00207178508933420; F. Gustafsson, Adaptive Filtering and Change Detection, 2000,
chapter 7.

Least squares take what acts with the input as a constant that jumps now and then. A torque that
swings is neither: its residuals are coloured, and dynamics that fit them come out. With

    y = rᵀθ + e       bias[k + 1] = bias[k] + w       σ_w = 30 σ_e

the noise of the model is incremental noise (Clarke, Mohtadi and Tuffs, Automatica 23, 1987,
doi:10.1016/0005-1098(87)90087-2), and only changes from sample to sample teach the dynamics. Such
an estimate withstands any slow disturbance, and learns less from each sample than one whose bias
rests. Which of the two describes the drive is seen from how well they predict:

    Λ <- (1 - 1/60) Λ + l - l_w      l = 1/2 (ln s² + min(ε²/s², 13))

with s² = σ² (1 + rᵀPr/ρ) and σ² from the median of ε² ρ/(ρ + rᵀPr), so that a sudden change, which
the bank deals with, counts little. A bias that rests pays the odds against each disturbance that
the bank has to assume. The incremental model is in force from Λ > 20 to Λ < 0.
"""

import math

from adaptdrive.control import thresholds
from adaptdrive.control.estimation import change
from adaptdrive.control.estimation.change import Branch, ChangeDetector
from adaptdrive.control.estimation.regression import Observation, Regression
from adaptdrive.control.estimation.rls import Residuals

# The bank: branches that split at an alarm.

_ROOM = 3 * (1 + len(change.ODDS_AGAINST))
"""Most branches that are followed: those of three alarms in a row, none of them decided yet."""

_OUTLIER = 2.0 * (thresholds.RARE + thresholds.CLEAR)
"""Largest z² that counts: one sample alone, 5.5 σ off, speaks clearly for a disturbance."""


class Bank:
    """The branches, and the sample at which they may split.

    Attributes:
        branches: All that are followed, the estimate among them.
        estimate: The one that is believed.
        point: The last sample.
    """

    def __init__(self, regression: Regression) -> None:
        """Begin with one branch.

        Args:
            regression: What is learnt.
        """
        self._regression = regression
        self.estimate = Branch(regression)
        self.branches = [self.estimate]
        self.point = Observation(regression.size)

    def learn(self, detector: ChangeDetector, sample: Observation) -> bool:
        """Let every branch predict and learn a sample.

        Args:
            detector: Overwritten.
            sample: What the estimate has predicted; the functions of the initial state in it are
                those of the estimate afterwards.

        Returns:
            Whether another branch has become the estimate.
        """
        learning, power = self._regression.learning, detector.noise_power(sample.rounding)
        rho = learning.forgetting
        for one in self.branches:
            if one is not self.estimate:
                one.predict_sample(sample)
            one.score += _likelihood(one, power, rho)
            one.age += 1
        best = self._most_probable()
        if detector.is_change(best.squared_error(rho), power):
            self._split(best, sample, power)
        for one in self.branches:
            if one.teaches(rho, learning.gate):
                one.learn_sample(sample)
        another = self._choose()
        self._regression.fill_state(sample.regressor, sample.time_s - self.estimate.origin_s)
        self.point.assign(sample)
        return another

    @property
    def is_contested(self) -> bool:
        """Whether another branch than the estimate may be right: a young or a probable one."""
        return any(
            one.age < thresholds.EARLIEST or one.score > -thresholds.RARE
            for one in self.branches
            if one is not self.estimate
        )

    def _most_probable(self) -> Branch:
        best = self.estimate
        for one in self.branches:
            if one.score > best.score:
                best = one
        return best

    def _split(self, parent: Branch, sample: Observation, power: float) -> None:
        """Add a child of a branch for each kind of change; each predicts the sample too."""
        rho, point = self._regression.learning.forgetting, self.point
        before = parent.score - _likelihood(parent, power, rho)
        for kind, odds in change.ODDS_AGAINST.items():
            child = Branch(self._regression)
            child.assign(parent)
            child.kind = kind
            child.restart_past(point.time_s)
            child.open_for(kind, point, power, sample.time_s - point.time_s)
            child.predict_sample(sample)
            child.score = before - odds + _likelihood(child, power, rho)
            self.branches.append(child)

    def _choose(self) -> bool:
        """Make the most probable branch the estimate if it is clearly ahead; end improbable ones.

        Returns:
            Whether another branch has become the estimate.
        """
        best, believed = self._most_probable(), self.estimate
        if best.score - believed.score > thresholds.RARE:
            self.estimate = best
            believed.age = 0  # only clear odds end what was the estimate
        top = best.score
        for one in self.branches:
            one.score -= top
        kept = [one for one in self.branches if one is self.estimate or _is_possible(one)]
        while len(kept) > _ROOM:
            worst = min((one for one in kept if one is not self.estimate), key=_score)
            kept = [one for one in kept if one is not worst]
        self.branches = kept
        return self.estimate is not believed


def _likelihood(branch: Branch, power: float, forgetting: float) -> float:
    """Return the logarithm of the likelihood of the last prediction, up to a constant."""
    squared = branch.squared_error(forgetting) / power
    return -0.5 * (math.log(1.0 + branch.excitation / forgetting) + min(squared, _OUTLIER))


def _is_possible(branch: Branch) -> bool:
    """Return whether a branch may still become the estimate."""
    if branch.age <= thresholds.EARLIEST:
        return True
    return branch.score > -thresholds.CLEAR and branch.age <= thresholds.LIFE


def _score(branch: Branch) -> float:
    return branch.score


# The incremental model: its bias is a random walk, for a disturbance that never rests.

_WALK = 30.0
"""Random walk of the bias in σ for each slow period: the last sample says nearly all of it."""

_RATE = 1.0 / thresholds.FEWEST
"""Rate of the medians, a factor of 2 in 4 samples: a start with another load is soon forgotten."""

_SWINGING = 2.0 * thresholds.CLEAR
"""Λ from which it is in force: a swing has 90 to 110, noise of 5 % after a change up to 40."""


class IncrementalModel:
    """The second estimate, and how well both have predicted.

    Attributes:
        branch: θ, P and origin.
        lead: Λ.
        in_force: Whether it is the estimate.
        residuals: Its innovations.
    """

    def __init__(self, regression: Regression) -> None:
        """Begin where the other estimate is.

        Args:
            regression: What is learnt.
        """
        self._regression = regression
        self.branch = Branch(regression)
        self._power = thresholds.NOISE_FLOOR  # σ² of its innovations, scaled
        self._other = thresholds.NOISE_FLOOR  # σ² of those of the estimate whose bias rests
        self.restart()

    def restart(self) -> None:
        """Begin at the estimate whose bias rests, and compare anew."""
        self._samples = 0
        self.lead = 0.0
        self.in_force = False
        self.residuals = Residuals()

    def follow(self, sample: Observation, estimate: Branch) -> None:
        """Predict and learn a sample, and compare.

        Args:
            sample: The functions of the initial state in it are overwritten.
            estimate: The estimate whose bias rests, which has predicted the sample.
        """
        learning, branch = self._regression.learning, self.branch
        rho, bias = learning.forgetting, self._regression.size - 1
        if self._samples == 0:
            branch.assign(estimate)
        squared = estimate.squared_error(rho)
        branch.predict_sample(sample)
        own = branch.squared_error(rho)
        # below it better predictions show nothing
        least = max(thresholds.NOISE_FLOOR, sample.rounding**2)
        self._samples += 1
        if self._samples > thresholds.WINDOW:
            gain = _loss(squared, estimate.excitation / rho, self._other, least)
            gain -= _loss(own, branch.excitation / rho, self._power, least)
            self.lead += gain - self.lead / thresholds.MEMORY
        self._follow_noise(own, squared)
        if own > (change.DRIFT + change.THRESHOLD) * self._power:
            branch.widen_entry(bias, branch.innovation * branch.innovation / self._power)
        branch.update_beside(sample.regressor, sample.target, rho, learning.gate, 1)
        branch.widen_entry(bias, _WALK * _WALK)
        self.residuals.remember(branch, rho)

    def charge_disturbance(self, estimate: Branch) -> None:
        """Charge a bias that rests for a disturbance that it had to assume: it is rare.

        Args:
            estimate: The branch that has just become the estimate.
        """
        if estimate.kind == change.DISTURBANCE:
            self.lead += thresholds.RARE

    def _follow_noise(self, own: float, squared: float) -> None:
        """Let the medians follow a sample, and choose the estimate in force."""
        if self._samples == 1:
            self._power, self._other = own, squared
        least = thresholds.NOISE_FLOOR / (_WALK * _WALK)
        self._power = max(least, change.move_median(self._power, own, _RATE))
        self._other = max(least, change.move_median(self._other, squared, _RATE))
        self.in_force = self.lead > (0.0 if self.in_force else _SWINGING)


def _loss(squared: float, excitation: float, power: float, least: float) -> float:
    """Return l: minus the logarithm of the likelihood of a sample, up to a constant."""
    spread = 1.0 + excitation
    variance = max(least, power * spread)
    ratio = min(squared * spread / variance, change.DRIFT + change.THRESHOLD)
    return 0.5 * (math.log(variance) + ratio)
