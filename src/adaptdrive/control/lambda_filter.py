"""The λ filters: a chain of first-order low-pass filters, run at the fast rate.

λ = 1/(τ_λ p + 1) (eq. 6), and λ^i is the signal after i filters in a row. One fast tick of length
T, with h = T/τ_λ, moves the chain x_i = λ^i w exactly for two kinds of input w:

    held (step-invariant):            x_i <- Σ_j φ_j x_(i-j) + P_i w[n]
    linear between samples (ramp-invariant):
                                      x_i <- Σ_j φ_j x_(i-j) + (P_i - R_i) w[n] + R_i w[n+1]

    φ_j = e^-h h^j / j!               (impulse response of j filters, over one tick)
    P_i = e^-h Σ_(j>=i) h^j / j!      (response of x_i to a held 1: incomplete gamma function)
    R_i = P_i - (i/h) P_(i+1)         (response of x_i to a ramp that rises from 0 to 1)

The sums are written with positive terms only, so that high orders at small h keep full precision.
"""

from __future__ import annotations

import math

from adaptdrive.control.vectors import Vector

_SERIES_TERMS = 40
"""Terms of the series in h: up to h = 5 the last are below the rounding of a double."""


def chain_decay(order: int, tick_period_s: float, tau_s: float) -> Vector:
    """φ_0 ... φ_(order-1): what is left of each filter's state after one tick."""
    h = tick_period_s / tau_s
    decay = [0.0] * order
    term = math.exp(-h)
    for j in range(order):
        decay[j] = term
        term *= h / (j + 1)
    return decay


def step_gains(order: int, tick_period_s: float, tau_s: float) -> Vector:
    """P_1 ... P_order: response to an input that is held over the tick."""
    h = tick_period_s / tau_s
    return [_held_response(i + 1, h) for i in range(order)]


def ramp_gains(order: int, tick_period_s: float, tau_s: float) -> Vector:
    """R_1 ... R_order: response to an input that rises linearly from 0 to 1 over the tick."""
    h = tick_period_s / tau_s
    gains = [0.0] * order
    for i in range(order):
        stage = i + 1
        gains[i] = _held_response(stage, h) - stage / h * _held_response(stage + 1, h)
    return gains


def _held_response(stage: int, h: float) -> float:
    term = math.exp(-h)
    for j in range(1, stage + 1):
        term *= h / j
    result = 0.0
    for j in range(stage + 1, stage + _SERIES_TERMS):
        result += term
        term *= h / j
    return result


def advance(
    chain: Vector, decay: Vector, held: Vector, ramp: Vector, start: float, end: float
) -> None:
    """Move a chain over one tick whose input goes linearly from `start` to `end`.

    Args:
        chain: λw, λ²w, ..., overwritten.
        decay: From `chain_decay`.
        held: From `step_gains`.
        ramp: From `ramp_gains`.
        start: Input at the beginning of the tick.
        end: Input at the end of the tick; equal to `start` for a held input.
    """
    rise = end - start
    for i in range(len(chain) - 1, -1, -1):
        value = held[i] * start + ramp[i] * rise
        for j in range(i + 1):
            value += decay[j] * chain[i - j]
        chain[i] = value
