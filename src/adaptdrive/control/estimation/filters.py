"""Filters at the fast rate: outliers, the resolution of the sensor, and the chain of λ filters.

λ = 1/(τ_λ p + 1) (eq. 6), and λ^i is the signal after i filters in a row. One fast tick of length
T, with h = T/τ_λ, moves the chain x_i = λ^i w exactly for two kinds of input w:

    held (step-invariant):            x_i <- Σ_j φ_j x_(i-j) + P_i w[n]
    linear between samples (ramp-invariant):
                                      x_i <- Σ_j φ_j x_(i-j) + (P_i - R_i) w[n] + R_i w[n+1]

    φ_j = e^-h h^j / j!               (impulse response of j filters, over one tick)
    P_i = e^-h Σ_(j>=i) h^j / j!      (response of x_i to a held 1: incomplete gamma function)
    R_i = P_i - (i/h) P_(i+1)         (response of x_i to a ramp that rises from 0 to 1)

The sums are written with positive terms only, so that high orders at small h keep full precision.

A tracker predicts each fast sample from level and slope (an α-β filter) and keeps the mean
absolute deviation s of the samples from their prediction:

    e = y - (ŷ + v)          e_c = e clipped to ± c s
    ŷ <- ŷ + v + α e_c       v <- v + β e_c       s <- s + γ n (min(|e|, 2 c s) - s)

The sample passed on is ŷ + v + e_c; n is the number of ticks since the last one. A spike counts
as c deviations and no more. A change lasts: the fifth sample in a row (`FEWEST`) beyond the same
limit opens the outlier filter to its own deviation, however narrow it had become at a standstill.
For Gaussian noise s is 0.8 σ.
(Huber, Ann. Math. Statist. 35, 1964, doi:10.1214/aoms/1177703732.)

The differences of the samples of a rounded output are whole multiples of one step q. Each
difference d > 0 of two successive samples is compared with the multiples of a candidate:

    k = round(d / q)      agrees: k >= 1 and |d / q - k| <= tolerance      else: k q - d remains

A candidate counts once enough differences agreed. One with which several do not agree is replaced
by what remained of the last, as in Euclid's algorithm; below the finest step that matters the
search begins again. A candidate outlives single samples off the steps. Samples that are not
rounded, or to steps far below the noise that is always counted with, give no step.

Rounding errs by q/√12 while the output stands still. Noise of a deviation σ before it spreads the
samples over several steps, whose mean errs less, by exp(-2 π² σ²/q²) (B. Widrow and I. Kollár,
Quantization Noise, 2008, chapter 4). σ shows in the share p of the samples that differ from the
one before: two samples differ by 2 σ/√π on average, which is p q as long as p is small. The result
is at most a sixth of q/√12 too large.

    rounding error = q/√12 exp(-π³ p²/2)
"""

import math
import sys
from dataclasses import dataclass

from adaptdrive.control.thresholds import EARLIEST, FEWEST, MEMORY, NOISE_FLOOR
from adaptdrive.control.vectors import Vector, total

# The λ filters: a chain of first-order low-pass filters, run at the fast rate.

Gains = tuple[Vector, Vector, Vector]
"""φ, P and R of a chain."""

_SERIES_TERMS = 40
"""Terms of the series in h: up to h = 5 the last are below the rounding of a double."""


def chain_gains(order: int, tick_period_s: float, tau_s: float) -> Gains:
    """φ_0 ... φ_(order-1), P_1 ... P_order and R_1 ... R_order of a tick length."""
    h = tick_period_s / tau_s
    terms = [math.exp(-h)]
    for j in range(1, order + _SERIES_TERMS):
        terms.append(terms[-1] * (h / j))
    held = [total(terms[i:]) for i in range(1, order + 2)]
    ramp = [held[i] - (i + 1) / h * held[i + 1] for i in range(order)]
    return terms[:order], held[:order], ramp


def advance(chain: Vector, gains: Gains, end: float) -> None:
    """Move a chain over one tick in which its input goes linearly to a new value.

    Args:
        chain: w, λw, λ²w, ..., overwritten.
        gains: From `chain_gains`.
        end: Input at the end of the tick; that of its beginning for a held input.
    """
    decay, held, ramp = gains
    start = chain[0]
    rise = end - start
    for i in range(len(held) - 1, -1, -1):
        value = held[i] * start + ramp[i] * rise
        for j in range(i + 1):
            value += decay[j] * chain[i + 1 - j]
        chain[i + 1] = value
    chain[0] = end


# The outlier filter in front of the filters: spikes are clipped, honest changes pass.

ALPHA = 1.0 / EARLIEST
"""Gain on the level: it follows a change within so many samples."""

BETA = ALPHA * ALPHA / (2.0 - ALPHA)
"""Gain on the slope: the tracker is damped by 0.71 then (T. R. Benedict and G. W. Bordner, IRE
Transactions on Automatic Control 7, 1962)."""

GAMMA = 1.0 / MEMORY
"""Rate of the mean deviation: a mean over so many ticks."""

_GAMMA_MAX = 1.0 / FEWEST
"""Largest share of one sample in the mean deviation: fewer samples are no mean."""

WIDE = 0.01
"""Deviation to start with, as a share of the output: wide enough for an honest first second."""


@dataclass(slots=True)
class OutlierFilter:
    """State of the outlier_filter.

    Attributes:
        level: ŷ.
        slope: v, per tick.
        deviation: s.
        beyond: Samples in a row beyond the upper limit, negative for the lower one.
    """

    level: float
    slope: float
    deviation: float
    beyond: int = 0


def reject_outlier(
    outlier_filter: OutlierFilter, sample: float, clip: float, ticks: int, least: float = 0.0
) -> float:
    """One fast sample, clipped.

    Args:
        outlier_filter: Overwritten.
        sample: y.
        clip: c.
        ticks: n: a drive that is polled has one sample in several ticks.
        least: Least deviation: a noiseless output must not close the outlier_filter.
    """
    predicted = outlier_filter.level + outlier_filter.slope
    error = sample - predicted
    limit = _limit(outlier_filter, error, clip)
    kept = min(max(error, -limit), limit)
    outlier_filter.level = predicted + ALPHA * kept
    outlier_filter.slope += BETA * kept
    seen = min(abs(error), 2.0 * limit)
    share = min(GAMMA * ticks, _GAMMA_MAX)
    outlier_filter.deviation = max(
        least, outlier_filter.deviation + share * (seen - outlier_filter.deviation)
    )
    return predicted + kept


def _limit(outlier_filter: OutlierFilter, error: float, clip: float) -> float:
    """Return the largest deviation that passes, opened for a change that lasts."""
    limit = clip * outlier_filter.deviation
    if abs(error) <= limit:
        outlier_filter.beyond = 0
        return limit
    side = 1 if error > 0.0 else -1
    same = outlier_filter.beyond * side > 0
    outlier_filter.beyond = outlier_filter.beyond + side if same else side
    if abs(outlier_filter.beyond) < FEWEST:
        return limit
    outlier_filter.beyond = 0
    outlier_filter.deviation = abs(error) / clip
    return abs(error)


# The resolution of the sensor, found in its own samples, and the rounding error that it leaves.

FINEST = math.sqrt(NOISE_FLOOR)
"""Smallest step that is looked for, and least deviation in the outlier filter, as shares of the
scale: the rounding error of smaller steps is far below least noise."""

TOLERANCE = 0.02
"""Distance from a multiple, in steps: more than single precision leaves of the finest step."""

_FOUND = math.ceil(math.log(sys.float_info.epsilon) / math.log(2.0 * TOLERANCE))
"""Differences that must agree: without steps all do by a chance below the rounding of a double."""

_MISS = _FOUND // 3
"""Weight of a difference that does not agree, which by chance only one of 25 does: three refute a
step that has just been found."""

_SURE = _FOUND + 2 * _MISS
"""Differences that are counted: a sample off the steps makes two that do not agree, after which
the step is still found."""

_LARGEST_MULTIPLE = 1.0e6
"""Steps in a difference: more no sensor shows, and an infinite number of them has no multiple."""


@dataclass(slots=True)
class Quantiser:
    """State of the search for the step of a sensor.

    Attributes:
        last: Last sample; NaN where only the step is known.
        candidate: Step that is being tried, in the unit of the output; 0 for none.
        score: Differences that agreed with it, less those that did not.
        changes: Ticks of the slow period so far whose sample differs from the one before.
        share: p, over the slow periods so far.
        periods: Slow periods in it, up to its memory.
    """

    last: float
    candidate: float = 0.0
    score: int = 0
    changes: int = 0
    share: float = 0.0
    periods: float = 0.0

    @property
    def step(self) -> float:
        """The step of the sensor in the unit of the output, 0 while none is known."""
        return self.candidate if self.score >= _FOUND else 0.0


def known_quantiser(step: float) -> Quantiser:
    """Return a search that begins with the step that an earlier run has found, 0 for none."""
    return Quantiser(math.nan, step, _SURE) if step > 0.0 else Quantiser(0.0)


def note_sample(quantiser: Quantiser, sample: float, scale: float, ticks: int = 1) -> None:
    """Compare a raw sample with the one before it.

    Args:
        quantiser: Overwritten.
        sample: y as the sensor gave it.
        scale: Output of order one.
        ticks: Half line cycles since the last sample: more than 1 where a drive is polled.
    """
    if sample == quantiser.last:
        return
    difference = abs(sample - quantiser.last)
    quantiser.last = sample
    quantiser.changes += ticks
    finest = FINEST * scale
    if quantiser.candidate <= 0.0:
        quantiser.candidate = difference if finest <= difference < scale else 0.0
        return
    ratio = difference / quantiser.candidate
    if not ratio < _LARGEST_MULTIPLE:  # or no number
        return
    multiple = math.floor(ratio + 0.5)
    rest = abs(ratio - multiple)
    if multiple >= 1 and rest <= TOLERANCE:
        quantiser.score = min(quantiser.score + 1, _SURE)
        return
    quantiser.score -= _MISS
    if quantiser.score < 0:
        remains = rest * quantiser.candidate
        quantiser.candidate, quantiser.score = (remains if remains >= finest else 0.0), 0


def close_share(quantiser: Quantiser, ticks: int) -> None:
    """Take the changes of a slow period into their share.

    Args:
        quantiser: Overwritten.
        ticks: Half line cycles of the period.
    """
    quantiser.periods = min(quantiser.periods + 1.0, MEMORY)
    quantiser.share += (min(1.0, quantiser.changes / ticks) - quantiser.share) / quantiser.periods
    quantiser.changes = 0


def rounding_error(step: float, share: float) -> float:
    """Return the standard deviation of the rounding error of a slow sample.

    Args:
        step: q, in the unit of the output.
        share: p.
    """
    return step / math.sqrt(12.0) * math.exp(-0.5 * math.pi**3 * share * share)
