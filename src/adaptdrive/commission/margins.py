"""Margins and effort of the fixed controller on an identified load."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.config.root import Configuration
from adaptdrive.control.design import compensator_gains, discrete_model
from adaptdrive.control.pole_placement import closed_loop_polynomial

Array = NDArray[np.float64]

_FREQUENCIES = 4000
_STEPS = 400


@dataclass(frozen=True, slots=True)
class Margins:
    """Distance of a loop from instability, by its model.

    Attributes:
        gain: Factor of the load's gain at which the loop becomes unstable.
        delay_s: Additional dead time at which it becomes unstable.
        effort: Largest change of the load's input after a step of the set-point, over the step.
    """

    gain: float
    delay_s: float
    effort: float


def margins_of(configuration: Configuration) -> Margins:
    """Return the margins of the fixed controller on the configured model.

    Args:
        configuration: The drive, with the model of the load.
    """
    load, section = build_load(configuration), configuration.load
    settings = controller_settings(configuration)
    numerator, denominator = list(load.numerator), list(load.denominator)
    a, b = discrete_model(settings, load, numerator, denominator, section.period_s)
    gains = compensator_gains(a, b, load.order, section.pole)
    taps = len(gains) - load.order - 1
    r, s = [1.0, *gains[:taps]], gains[taps:]
    omega = np.linspace(math.pi / _FREQUENCIES, math.pi, _FREQUENCIES)
    loop = _response(b, omega) * _response(s, omega) / (_response(a, omega) * _response(r, omega))
    return Margins(
        gain=_gain_margin(loop),
        delay_s=_delay_margin(loop, omega) * section.period_s,
        effort=_effort(a, b, r, s),
    )


def _response(polynomial: list[float], omega: Array) -> NDArray[np.complex128]:
    """Return a polynomial in q^-1 on the unit circle."""
    powers = np.arange(len(polynomial))
    values: NDArray[np.complex128] = np.exp(-1j * np.outer(omega, powers)) @ np.array(polynomial)
    return values


def _gain_margin(loop: NDArray[np.complex128]) -> float:
    """Return 1/|L| at the crossing of the negative real axis that is nearest to -1."""
    crossings = np.flatnonzero(np.diff(np.sign(loop.imag)) != 0)
    sizes = [abs(loop[i]) for i in crossings if loop[i].real < 0.0]
    below = [size for size in sizes if size < 1.0]
    return 1.0 / max(below) if below else math.inf


def _delay_margin(loop: NDArray[np.complex128], omega: Array) -> float:
    """Return the least phase margin over frequency, in slow periods."""
    crossings = np.flatnonzero(np.diff(np.sign(np.abs(loop) - 1.0)) != 0)
    margins = [((np.angle(loop[i]) + math.pi) % (2.0 * math.pi)) / omega[i] for i in crossings]
    return float(min(margins, default=math.inf))


def _effort(a: list[float], b: list[float], r: list[float], s: list[float]) -> float:
    """Return the largest input after a unit step of the set-point."""
    closed = closed_loop_polynomial(a, b, r, s)
    inputs = lfilter(sum(s) * np.array(a), closed, np.ones(_STEPS))
    return float(np.abs(inputs).max())
