"""One value that the description of a device has: how it is coded, and which codes mean something.

A DBC, an EDS and a register map describe it in three ways; here it is the same for all of them.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

Raw = int | float

_ROUNDING = 1e-6
"""Share of one count by which a declared limit may miss its count in binary."""

_LARGEST_FLOATS = {16: 65504.0, 32: 3.4028234663852886e38, 64: 1.7976931348623157e308}
_SENSELESS = 1e30


@dataclass(frozen=True, slots=True)
class Field:
    """One value of a device.

    Attributes:
        name: Name of the signal, the object or the register.
        low: Smallest raw value in range.
        high: Largest raw value in range.
        integer: Whether raw values are integers.
        scale: Physical units per count.
        offset: Physical value of the raw value zero.
        unavailable: Raw value that means "not available".
        idle: Raw value of a signal that the sender does not set.
        blanks: Values of a whole register that say nothing where its bits, or off, are taken.
        unknown: Raw values within the range that say nothing.
        unit: Unit of the physical value as the description writes it, empty for none.
        names: Names of raw values, as a value table has them.
    """

    name: str
    low: Raw
    high: Raw
    integer: bool
    scale: float = 1.0
    offset: float = 0.0
    unavailable: Raw = 0
    idle: Raw = 0
    blanks: frozenset[Raw] = frozenset()
    unknown: frozenset[Raw] = frozenset()
    unit: str = ""
    names: Mapping[int, str] = field(default_factory=dict)

    def physical(self, raw: Raw) -> float:
        """The physical value of a raw one, in the unit of the signal."""
        return raw * self.scale + self.offset

    def raw(self, value: float | None) -> Raw:
        """The raw value of a physical one; None stands for "not available".

        Raises:
            ValueError: The value is not finite, outside the range of the signal, or says nothing.
        """
        if value is None:
            return self.unavailable
        raw: Raw = (value - self.offset) / self.scale
        if self.integer and math.isfinite(raw):
            raw = round(raw)
        if not self.low <= raw <= self.high:
            low, high = self.ends
            raise ValueError(f"{self.name} = {value:.10g} is outside {low:.10g}…{high:.10g}")
        if raw in self.unknown:
            raise ValueError(f"{self.name} = {value:.10g} says that nothing is known")
        return raw

    def problem(self, value: float) -> str | None:
        """Return why a physical value has no raw one, None where it has."""
        try:
            self.raw(value)
        except ValueError as problem:
            return str(problem)
        return None

    def value(self, raw: Raw) -> float | None:
        """The physical value of a raw one, None where it must not be used."""
        if not self.low <= raw <= self.high or raw in self.unknown:
            return None
        return raw * self.scale + self.offset

    def within(self, other: "Field") -> "Field":
        """Return the field whose raw values say something here and in another use of the same."""
        low, high = max(self.low, other.low), min(self.high, other.high)
        return replace(self, low=low, high=high, unknown=self.unknown | other.unknown)

    @property
    def ends(self) -> tuple[float, float]:
        """The smallest and the largest physical value."""
        first, last = self.physical(self.low), self.physical(self.high)
        return min(first, last), max(first, last)

    @property
    def is_word(self) -> bool:
        """True if the physical value is the raw integer."""
        return self.integer and self.scale == 1 and self.offset == 0


def natural_limits(bits: int, *, signed: bool, real: bool) -> tuple[Raw, Raw]:
    """Return the smallest and the largest raw value that a type has.

    Args:
        bits: Length.
        signed: Whether an integer has a sign.
        real: Whether it is a floating-point number.
    """
    if real:
        largest = _LARGEST_FLOATS.get(bits, _LARGEST_FLOATS[64])
        return -largest, largest
    if signed:
        return -(1 << (bits - 1)), (1 << (bits - 1)) - 1
    return 0, (1 << bits) - 1


def sensible_limits(low: Raw, high: Raw) -> tuple[Raw, Raw]:
    """Return the limits of a measured float: beyond 1e30 it is the largest one, or another mark."""
    return max(low, -_SENSELESS), min(high, _SENSELESS)


def declared_limits(
    natural: tuple[Raw, Raw], ends: tuple[float, float], scale: float, offset: float = 0.0
) -> tuple[Raw, Raw]:
    """Return the raw limits of a type within a declared range of physical values.

    Args:
        natural: Smallest and largest raw value of the type, integers of an integer.
        ends: The declared range; one that is not finite declares nothing.
        scale: Physical units per count.
        offset: Physical value of the raw value zero.
    """
    low, high = natural
    first, last = sorted((end - offset) / scale for end in ends)
    if not (math.isfinite(first) and math.isfinite(last)):
        return natural
    if isinstance(low, float):
        return max(low, first), min(high, last)
    return max(low, math.ceil(first - _ROUNDING)), min(high, math.floor(last + _ROUNDING))
