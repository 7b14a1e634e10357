"""Interface of a load to the controller, which every file in `loads` implements.

A load is a linear model of order m between an input u and the output y, and a map from the boost
voltage to that input. A new load is one new file that provides a `Load`.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from adaptdrive.control.vectors import Vector

Discretise = Callable[[Vector, Vector, float], tuple[Vector, Vector]]
"""(numerator, denominator, period) to A and B in q^-1."""

Physical = Callable[[Vector, Vector], Vector]
"""(numerator, denominator) to the physical parameters, in the order of `Load.names`."""

Realise = Callable[[Vector], tuple[Vector, Vector]]
"""Physical parameters to (numerator, denominator): the inverse of `Physical`."""


@dataclass(frozen=True, slots=True)
class Charging:
    """Settings of the charge of a battery.

    Attributes:
        turns_ratio: N2.
        droop_Ohm: R_d.
        internal_Ohm: R_0.
        voltage_max_V: V_max.
        end_current_A: Current at which charging ends.
        longest_s: Longest charge.
    """

    turns_ratio: float
    droop_Ohm: float
    internal_Ohm: float
    voltage_max_V: float
    end_current_A: float
    longest_s: float = math.inf


OFFSET = "input_offset"
"""Name of the estimated constant at the input."""


Products = Mapping[str, Mapping[str, int]]
"""Quantities by name that are products of parameters: the powers of these by name."""


@dataclass(frozen=True, slots=True)
class Load:
    """One kind of load, with its nominal model.

    Attributes:
        numerator: b_0 ... b_m of the nominal H(s), highest power of s first.
        denominator: 1, a_1 ... a_m.
        input_powers: The powers i of λ^i u that enter the λ-transformed model.
        input_gain: u = gain · v_bst^exponent.
        input_exponent: 1 or 2.
        names: Names of the physical parameters.
        physical: Physical parameters of a model.
        realise: The model that has given physical parameters.
        paper_model: The discretisation that the paper uses for this load.
        charging: For a battery: when its current must taper and end.
        delay_s: Dead time from the input to the output.
        products: What its parameters say of it.
        loss: Name of what acts against the input: the offset with the opposite sign.
    """

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    input_powers: tuple[int, ...]
    input_gain: float
    input_exponent: int
    names: tuple[str, ...]
    physical: Physical
    realise: Realise
    paper_model: Discretise
    charging: Charging | None = None
    delay_s: float = 0.0
    products: Products = field(default_factory=dict)
    loss: str = "loss"

    @property
    def order(self) -> int:
        """m."""
        return len(self.denominator) - 1

    @property
    def gain(self) -> float:
        """Return the dc gain of the nominal model."""
        return self.numerator[self.order] / self.denominator[self.order]

    @property
    def lag_s(self) -> float:
        """Return the sum of the nominal time constants."""
        return self.denominator[self.order - 1] / self.denominator[self.order]

    def possible(self, output: float) -> float:
        """Return the possible output that is nearest: a battery takes no negative current."""
        return output if self.charging is None else max(0.0, output)


def is_damped(denominator: Vector, least: float) -> bool:
    """Return whether a model has the least damping of a passive load, where its order is two."""
    if len(denominator) != 3:
        return True
    square = 4.0 * least * least * denominator[2]
    return denominator[1] > 0.0 and denominator[1] * denominator[1] >= square


def to_input(boost_voltage_V: float, gain: float, exponent: int) -> float:
    """The load's input u at a boost voltage."""
    if exponent == 2:
        return gain * boost_voltage_V * boost_voltage_V
    return gain * boost_voltage_V


def to_voltage(load_input: float, gain: float, exponent: int) -> float:
    """The boost voltage that gives the load's input u (0 where none does)."""
    if exponent == 2:
        return math.sqrt(max(0.0, load_input / gain))
    return load_input / gain


def derived(products: Products, loss: str, estimates: Mapping[str, float]) -> dict[str, float]:
    """Return the quantities that follow from estimates.

    Args:
        products: As of `Load`.
        loss: As of `Load`.
        estimates: Values of the estimates by name; one that is 0 has no inverse.
    """
    found = {
        name: math.prod(estimates[one] ** float(power) for one, power in powers.items())
        for name, powers in products.items()
        if all(map(estimates.get, powers))
    }
    if OFFSET in estimates:
        found[loss] = -estimates[OFFSET]
    return found
