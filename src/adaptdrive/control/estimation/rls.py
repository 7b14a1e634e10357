"""Recursive least squares with forgetting, and its covariance P as U D Uᵀ.

U is unit upper triangular, D diagonal and positive: G. J. Bierman, Factorization Methods for
Discrete Sequential Estimation, 1977, chapter V. In this form P cannot lose its symmetry or become
indefinite by rounding, however long or poorly excited the run.

The algorithm (3),

    ε = y - rᵀθ        g = P r / (ρ + rᵀ P r)        θ <- θ + g ε        P <- (P - g rᵀ P) / ρ

with P kept as U D Uᵀ. Forgetting stops to inflate D at a ceiling, so that P stays
finite without excitation. P is in units of the variance of the innovations, which follows from
their sums (`Residuals`), and takes these for independent. Under a disturbance that moves each
resembles the one before, and what that costs widens the deviations shown.
"""

import math

from adaptdrive.control.vectors import Vector, copy_into, dot, identity, lacks, unit

_SMALLEST = 1.0e-12
"""Least entry of D after a transformation: 0 would end learning in its direction."""

COVARIANCE_CEILING = 1.0e12
"""Largest variance that P may grow to: above it few digits of a double would be left."""


class Estimate:
    """An estimate, its covariance, and its last prediction.

    Attributes:
        theta: θ.
        upper: U of P = U D Uᵀ, flat.
        diagonal: D.
        innovation: ε of the last sample.
        excitation: rᵀPr of the last sample: what it can teach, against the ρ of its noise.
    """

    def __init__(self, count: int) -> None:
        """Begin with zeros, and sure of them.

        Args:
            count: Length of θ.
        """
        self.theta = [0.0] * count
        self.upper = identity(count)
        self.diagonal = [0.0] * count
        self.innovation = 0.0
        self.excitation = 0.0

    def open_up(self, covariance: float) -> None:
        """Forget how sure θ is, and keep θ: P <- covariance · I."""
        copy_into(self.diagonal, [covariance] * len(self.diagonal))
        copy_into(self.upper, identity(len(self.diagonal)))

    def predict(self, regressor: Vector, target: float) -> None:
        """Predict a sample before it is learnt: innovation and excitation are overwritten."""
        size, diagonal, upper = len(regressor), self.diagonal, self.upper
        total = 0.0
        for j in range(size):
            f = regressor[j]
            for i in range(j):
                f += upper[i * size + j] * regressor[i]
            total += diagonal[j] * f * f
        self.excitation = total
        self.innovation = target - dot(self.theta, regressor)

    def squared_error(self, forgetting: float) -> float:
        """Return ε² of the last prediction less what the uncertainty of θ adds."""
        return normalised(self.innovation, self.excitation, forgetting)

    def teaches(self, forgetting: float, gate: float) -> bool:
        """Return whether the last predicted sample shows more than what is forgotten with it."""
        return self.excitation > gate * (1.0 - forgetting)

    def widen(self, direction: Vector, variance: float) -> None:
        """P <- P + variance · v vᵀ, in factored form (Agee and Turner; Bierman 1977, III.3).

        Args:
            direction: v, overwritten.
            variance: How much less sure θ becomes along v.
        """
        size, upper, diagonal = len(self.diagonal), self.upper, self.diagonal
        rest = variance
        for j in range(size - 1, -1, -1):
            share = direction[j]
            grown = diagonal[j] + rest * share * share
            gain = rest * share / grown
            rest *= diagonal[j] / grown
            diagonal[j] = grown
            for i in range(j):
                direction[i] -= share * upper[i * size + j]
                upper[i * size + j] += gain * direction[i]

    def widen_entry(self, index: int, variance: float) -> None:
        """Widen P along one entry of θ."""
        self.widen(unit(len(self.theta), index), variance)

    def transform(self, matrix: Vector) -> None:
        """θ <- M θ and P <- M P Mᵀ, by Thornton's weighted Gram-Schmidt (Bierman 1977, VI.4).

        A row without any weight gets the smallest variance that is left.

        Args:
            matrix: M, flat, n by n.
        """
        size, old = len(self.theta), list(self.theta)
        columns = [0.0] * (size * size)
        for i in range(size):
            self.theta[i] = dot(matrix[i * size : (i + 1) * size], old)
            for j in range(size):
                for m in range(j + 1):
                    columns[i * size + j] += matrix[i * size + m] * self.upper[m * size + j]
        self._factor(columns, list(self.diagonal))

    def _factor(self, columns: Vector, weights: Vector) -> None:
        """Bring W diag(w) Wᵀ into the form U D Uᵀ; W is overwritten."""
        size, upper, diagonal = len(self.diagonal), self.upper, self.diagonal
        for j in range(size - 1, -1, -1):
            total = 0.0
            for m in range(size):
                total += weights[m] * columns[j * size + m] * columns[j * size + m]
            diagonal[j] = max(total, _SMALLEST)
            for i in range(j):
                shared = 0.0
                for m in range(size):
                    shared += weights[m] * columns[i * size + m] * columns[j * size + m]
                ratio = shared / diagonal[j]
                upper[i * size + j] = ratio
                for m in range(size):
                    columns[i * size + m] -= ratio * columns[j * size + m]

    def covariance(self) -> Vector:
        """P = U D Uᵀ, flat, n by n."""
        size, upper = len(self.diagonal), self.upper
        result = [0.0] * (size * size)
        for i in range(size):
            for j in range(size):
                for m in range(max(i, j), size):
                    shared = upper[i * size + m] * self.diagonal[m] * upper[j * size + m]
                    result[i * size + j] += shared
        return result

    def update(self, regressor: Vector, target: float, forgetting: float) -> None:
        """Take in one sample, with exponential forgetting.

        Args:
            regressor: r, n entries.
            target: y.
            forgetting: ρ.
        """
        innovation, gain = target - dot(self.theta, regressor), [0.0] * len(self.theta)
        share = innovation / self._absorb(regressor, forgetting, gain)
        for i in range(len(gain)):
            grown = self.diagonal[i] / forgetting
            if grown > COVARIANCE_CEILING:
                grown = max(self.diagonal[i], COVARIANCE_CEILING)
            self.diagonal[i] = grown
            self.theta[i] += gain[i] * share

    def update_beside(
        self, regressor: Vector, target: float, forgetting: float, gate: float, walks: int
    ) -> None:
        """Take in one sample, and forget along it what does not walk by itself.

        Forgetting is directional (R. Kulhavy, Automatica 23, 1987): P is widened along P r so that
        rᵀPr becomes rᵀPr/ρ, then updated without forgetting, and what this sample carries no
        information about keeps its variance.

        The last entries of θ, w, may follow a random walk that widens P elsewhere: forgetting is
        for the others, d. What the sample says of d is forgotten in the density of d alone, and
        that of w for a given d stays: with C the covariance of w for a given d and c = r_wᵀ C r_w,
        P is widened along P r - C r_w so that x = rᵀPr - c becomes x/ρ. A sample with
        x ≤ min(1/2, gate · (1 - ρ)) (1 + c), which hardly shows d, moves w alone.

        Args:
            regressor: r, n entries.
            target: y.
            forgetting: ρ.
            gate: Share of the steady x below which d is not learnt.
            walks: How many entries of θ walk, 0 for none.
        """
        size = len(self.theta)
        own, direction, gain = self._given(regressor, walks), [0.0] * size, [0.0] * size
        noise, innovation = 1.0 + dot(own, regressor), target - dot(self.theta, regressor)
        shown = self._project(regressor, direction) - (noise - 1.0)
        for i in range(size):
            direction[i] -= own[i]
        teaches = shown > min(0.5, gate * (1.0 - forgetting)) * noise
        if shown > 0.0:
            lost = (1.0 / forgetting - 1.0) / shown if teaches else 1.0 / (noise - shown)
            self.widen(direction, lost)
        share = innovation / self._absorb(regressor, 1.0, gain)
        for i in range(size):
            self.theta[i] += gain[i] * share if teaches else own[i] * innovation / noise

    def _given(self, regressor: Vector, walks: int) -> Vector:
        """C r: P r with the covariance that the last entries of θ have for given others.

        Args:
            regressor: r.
            walks: How many the last entries are; C is zero elsewhere.
        """
        size, result = len(self.theta), [0.0] * len(self.theta)
        if walks == 0:
            return result
        known, gain = Estimate(size), [0.0] * size
        known.upper, known.diagonal = list(self.upper), list(self.diagonal)
        for i in range(size - walks):
            known._absorb(unit(size, i), _SMALLEST, gain)
        known._project(regressor, result)
        for i in range(size - walks):
            result[i] = 0.0
        return result

    def _project(self, regressor: Vector, direction: Vector) -> float:
        """Write P r, and return rᵀ P r.

        Args:
            regressor: r.
            direction: P r, overwritten; zeros before.
        """
        size, upper = len(self.diagonal), self.upper
        total = 0.0
        for j in range(size):
            f = regressor[j]
            for i in range(j):
                f += upper[i * size + j] * regressor[i]
            v = self.diagonal[j] * f
            total += f * v
            direction[j] += v
            for i in range(j):
                direction[i] += upper[i * size + j] * v
        return total

    def _absorb(self, regressor: Vector, noise: float, gain: Vector) -> float:
        """P <- P - P r rᵀ P / (noise + rᵀ P r), in factored form (Bierman's update).

        Args:
            regressor: r.
            noise: Variance that stands for the sample's noise.
            gain: P r of the old P, overwritten.

        Returns:
            noise + rᵀ P r of the old P.
        """
        size, upper, diagonal = len(regressor), self.upper, self.diagonal
        scale = noise
        for j in range(size):
            f = regressor[j]
            for i in range(j):
                f += upper[i * size + j] * regressor[i]
            variance = diagonal[j]
            v = variance * f
            grown = scale + f * v
            diagonal[j] = variance * (scale / grown)
            gain[j] = v
            step = -f / scale
            for i in range(j):
                place = i * size + j
                old = upper[place]
                upper[place] = old + gain[i] * step
                gain[i] += old * v
            scale = grown
        return scale


def normalised(innovation: float, excitation: float, forgetting: float) -> float:
    """Return ε² ρ/(ρ + rᵀPr)."""
    return innovation * innovation * (forgetting / (forgetting + excitation))


class Residuals:
    """Forgetting sums over the innovations of an estimate, from which σ follows.

    Attributes:
        power: Sum of the squared normalised innovations.
        weight: Count of them.
        lag: Sum of the products of each and the one before.
    """

    def __init__(self) -> None:
        """Begin without an innovation."""
        self.power = 0.0
        self.weight = 0.0
        self.lag = 0.0
        self._last = 0.0

    def remember(self, estimate: Estimate, forgetting: float) -> None:
        """Add the innovation of an estimate."""
        power = estimate.squared_error(forgetting)
        self.power = forgetting * self.power + power
        self.weight = forgetting * self.weight + 1.0
        own = math.copysign(math.sqrt(max(0.0, power)), estimate.innovation)
        self.lag = forgetting * self.lag + own * self._last
        self._last = own

    def noise(self, count: int) -> float:
        """Return σ of the innovations, scaled; NaN before there are more of them than parameters.

        Args:
            count: Length of θ.
        """
        freedom = self.weight - count
        return math.sqrt(self.power / freedom) if freedom > 0.0 else math.nan

    def correlation_factor(self) -> float:
        """Return the factor by which innovations that resemble their neighbours widen a deviation.

        n samples whose neighbours have the correlation φ carry the information of
        n (1 - φ)/(1 + φ) independent ones (G. V. Bayley and J. M. Hammersley, Suppl. J. Roy. Stat.
        Soc. 8, 1946, doi:10.2307/2983560), and no less than one. Noise has no correlation; the
        error that a moving disturbance leaves has one, and so has what came with an alarm, until
        it is forgotten: its explanation is not confirmed yet.
        """
        if lacks(self.lag, 0.0):
            return 1.0
        if self.lag >= self.power:
            return math.sqrt(self.weight)
        return math.sqrt(min((self.power + self.lag) / (self.power - self.lag), self.weight))
