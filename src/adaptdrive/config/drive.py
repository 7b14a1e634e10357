"""`[drive]` and `[voltage_loop]`: the power stage and the control of its boost voltage."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar, Literal

from pydantic import Field

from adaptdrive.config.section import FiniteFloat, NonNegativeFloat, PositiveFloat, Section, key
from adaptdrive.util.errors import Flaw
from adaptdrive.util.quantity import BOOST_VOLTAGE, Given

BROKER_USERS = frozenset({"operator", "viewer"})
"""Users of `deploy/mosquitto/adaptdrive.acl` that are operators, not drives."""


class DriveLimits(Section):
    """`[drive.limits]`: what the drive may be asked for."""

    rising: ClassVar = ("boost_reference_min_V", "boost_reference_max_V")

    boost_reference_min_V: FiniteFloat = 200.0
    boost_reference_max_V: PositiveFloat = 400.0
    current_scale_max_S: PositiveFloat = 0.15
    regeneration_scale_max_S: PositiveFloat | None = None
    current_scale_slew_S: PositiveFloat = 0.15

    manual_slew_V_per_s: PositiveFloat = 100.0
    load_power_max_W: PositiveFloat = 1500.0


class Manipulated(Section):
    """`[drive.manipulated]`: what a drive is commanded, and gives, where that is no voltage.

    All keys and topics that end in `_V` are then in its unit.
    """

    name: str = key(BOOST_VOLTAGE, pattern=r"^[A-Za-z_][A-Za-z0-9_ ]{0,31}$")
    unit: str = key("V", max_length=16)

    @property
    def given(self) -> Given:
        """The words for it."""
        return Given(self.name, self.unit)


class DriveSection(Section):
    """`[drive]`: the power-electronic drive."""

    name: str = Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_-]{0,63}$")
    kind: Literal["unidirectional", "bidirectional"] = "unidirectional"
    line_frequency_Hz: Literal[50, 60] = 60
    line_voltage_V: PositiveFloat = 120.0
    boost_capacitance_F: PositiveFloat = 1.0e-3
    enable_bit: Literal["bridge", "bridge-and-boost"] = "bridge"
    limits: DriveLimits = Field(default_factory=DriveLimits)
    manipulated: Manipulated = Field(default_factory=Manipulated)

    @property
    def given(self) -> Given:
        """The words for what it is commanded, and gives."""
        return self.manipulated.given

    @property
    def half_cycle_s(self) -> float:
        """Half a line cycle at nominal frequency: one fast tick."""
        return 0.5 / self.line_frequency_Hz

    @property
    def current_scale_min_S(self) -> float:
        """Lowest line-current scale: 0, or negative for a bidirectional drive."""
        if self.kind == "unidirectional":
            return 0.0
        limits = self.limits
        return -(limits.regeneration_scale_max_S or limits.current_scale_max_S)

    def flaws(self) -> Iterator[Flaw]:
        """Yield a name with too many rights, and a limit of another kind of drive."""
        if self.name.lower() in BROKER_USERS:
            problem = f"{self.name!r} is a user of the broker: a drive of that name could command"
            yield Flaw("name", f"{problem} all others; choose another name")
        if self.kind == "unidirectional" and self.limits.regeneration_scale_max_S is not None:
            yield Flaw("", "limits.regeneration_scale_max_S needs kind = 'bidirectional'")


class VoltageLoop(Section):
    """`[voltage_loop]`: the fast loop that makes v_bst follow V_c."""

    where: Literal["daemon", "drive"] = "daemon"
    feed_forward: bool = True
    lag_s: NonNegativeFloat | None = None
