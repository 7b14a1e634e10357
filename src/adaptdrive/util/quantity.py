"""The words for what a drive is commanded, and gives: its boost voltage, or what a key names.

Whatever leaves the process with such a value takes name and unit from here: texts, topics, columns
and figures.
"""

from dataclasses import dataclass

BOOST_VOLTAGE = "v_bst"
"""Name of what a power stage gives that nothing else is said of."""


@dataclass(frozen=True, slots=True)
class Given:
    """Name and unit of what a drive is commanded, and gives.

    Attributes:
        name: Its name, such as `frequency`.
        unit: Its unit; empty for a plain number.
    """

    name: str = BOOST_VOLTAGE
    unit: str = "V"

    @property
    def is_boost_voltage(self) -> bool:
        """True for the voltage of a boost stage, which is there before the load is fed."""
        return self.name == BOOST_VOLTAGE

    @property
    def title(self) -> str:
        """Its name for people."""
        return "boost voltage" if self.is_boost_voltage else self.name

    @property
    def asked(self) -> str:
        """Label of its commanded value."""
        return "V_c" if self.is_boost_voltage else f"{self.name} asked for"

    @property
    def by_hand(self) -> str:
        """Name of its value in mode manual."""
        return "voltage" if self.is_boost_voltage else self.name

    @property
    def symbol(self) -> str:
        """Its commanded value in a sentence."""
        return "V_c" if self.is_boost_voltage else self.name

    @property
    def axis(self) -> str:
        """Label of an axis of a figure."""
        return f"{self.title} ({self.unit})" if self.unit else self.title

    def text(self, value: float, form: str = ".4g") -> str:
        """Return a value with its unit.

        Args:
            value: In the unit.
            form: How the number is written.
        """
        return f"{value:{form}} {self.unit}".rstrip()


BOOST = Given()
"""The voltage of a boost stage."""
