"""Random systems to try the control code on, and loops closed without polynomial algebra."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import companion
from scipy.signal import cont2discrete

from adaptdrive.control.design.pole_placement import Plant

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class System:
    """H(s), highest power first; numerator as long as the denominator."""

    numerator: list[float]
    denominator: list[float]

    @property
    def order(self) -> int:
        return len(self.denominator) - 1

    @property
    def dc_gain(self) -> float:
        return self.numerator[-1] / self.denominator[-1]

    def response(self, rad_s: float) -> complex:
        """H(jω)."""
        return complex(
            np.polyval(self.numerator, 1j * rad_s) / np.polyval(self.denominator, 1j * rad_s)
        )

    def state_space(self) -> tuple[Array, Array, Array, Array]:
        direct = self.numerator[0]
        row = np.array(self.numerator[1:]) - direct * np.array(self.denominator[1:])
        unit = np.eye(self.order)[:, :1]
        return companion(self.denominator), unit, row[None, :], np.array([[direct]])


def decades(low: float, high: float) -> st.SearchStrategy[float]:
    """Positive numbers, evenly over their logarithm."""
    return st.floats(np.log10(low), np.log10(high)).map(lambda power: float(10.0**power))


@st.composite
def stable_systems(
    draw: st.DrawFn, orders: tuple[int, int] = (1, 4), *, direct: bool = False
) -> System:
    """Stable systems with time constants of 0.5 to 30 s, complex pairs, any zeros, gain of 1."""
    order = draw(st.integers(*orders))
    denominator = np.ones(1)
    while len(denominator) <= order:
        if order - len(denominator) >= 1 and draw(st.booleans()):
            period, damping = draw(decades(0.5, 30.0)), draw(st.floats(0.2, 1.0))
            factor = [1.0, 2.0 * damping / period, 1.0 / period**2]
        else:
            factor = [1.0, 1.0 / draw(decades(0.5, 30.0))]
        denominator = np.convolve(denominator, factor)
    shape = [draw(st.floats(-1.0, 1.0)) for _ in range(order)]
    leading = [shape[0] if direct else 0.0]
    numerator = [*leading, *(x * y for x, y in zip(shape[1:], denominator[1:-1], strict=True))]
    return System([*numerator, float(denominator[-1])], denominator.tolist())


def motor_system(disks: int = 1, gain: float = 0.011, filter_s: float = 10.0) -> System:
    """The reference motor with 1, 2 or 3 disks."""
    tau_s = 11.7 * disks
    product = tau_s * filter_s
    return System([0.0, 0.0, gain / product], [1.0, (tau_s + filter_s) / product, 1.0 / product])


def impulse_invariant(
    gain: float, tau_sum_s: float, tau_product_s2: float, period_s: float
) -> Array:
    """A, then B, of g/((τ1 s + 1)(τ2 s + 1)): (24) with (25) corrected, for any two poles."""
    roots = np.roots([1.0, tau_sum_s / tau_product_s2, 1.0 / tau_product_s2]).astype(complex)
    decays, apart = np.exp(roots * period_s), roots[0] - roots[1]
    slope = period_s * np.exp(roots[0] * period_s) if apart == 0.0 else np.diff(decays)[0] / -apart
    b1 = period_s * gain / tau_product_s2 * slope
    return np.array([1.0, -sum(decays).real, np.prod(decays).real, 0.0, b1.real, 0.0])


def place_poles(
    a: list[float], b: list[float], desired: list[float]
) -> tuple[list[float], list[float]]:
    """R and S of the loop with the poles of a polynomial."""
    return Plant(a, b).place(desired)


def matrix_of(step: Callable[[Array], Array], size: int) -> Array:
    """The matrix of a linear map: the images of the unit vectors, less that of zero."""
    rest = step(np.zeros(size))
    return np.column_stack([step(unit) - rest for unit in np.eye(size)])


def distance(poles: NDArray[Any], expected: Sequence[complex]) -> float:
    """Largest distance of a pole from the expected one nearest to it, matched one to one."""
    left, worst = list(expected), 0.0
    for pole in poles:
        nearest = min(left, key=lambda other: abs(other - pole))
        left.remove(nearest)
        worst = max(worst, abs(nearest - pole))
    return worst


def polynomials(system: tuple[Array, Array, Array, Array, float]) -> tuple[Array, Array]:
    """Denominator and numerator in z of a discrete state space, equally long."""
    a, b, c, d, _ = system
    bottom = np.asarray(np.poly(a))
    return bottom, np.asarray(np.poly(a - b @ c) + (d[0, 0] - 1.0) * bottom)


def held_polynomials(system: System, period_s: float) -> tuple[Array, Array]:
    """Denominator and numerator in z of a system whose input is held, by scipy."""
    return polynomials(cont2discrete(system.state_space(), period_s, "zoh"))


def row_norms(root: Sequence[float]) -> list[float]:
    """Standard deviations from L, flat, of a covariance L Lᵀ."""
    size = math.isqrt(len(root))
    found: list[float] = np.linalg.norm(np.reshape(root, (size, size)), axis=1).tolist()
    return found
