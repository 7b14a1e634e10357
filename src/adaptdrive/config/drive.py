"""`[drive]` and `[voltage_loop]`: the power stage and the control of its boost voltage."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, field_validator, model_validator

from adaptdrive.config.section import FiniteFloat, NonNegativeFloat, PositiveFloat, Section, key

BROKER_USERS = frozenset({"operator", "viewer"})
"""Users of `deploy/mosquitto/adaptdrive.acl` that are operators, not drives."""


class DriveLimits(Section):
    """`[drive.limits]`: what the drive may be asked for."""

    boost_reference_min_V: FiniteFloat = key(
        200.0,
        "lowest V_c: above the line's peak where the daemon holds the voltage; "
        "below 0 for a motor that turns both ways",
    )
    boost_reference_max_V: PositiveFloat = key(400.0, "highest V_c")
    current_scale_max_S: PositiveFloat = key(
        0.15, "largest line-current scale k (line current over line voltage)"
    )
    regeneration_scale_max_S: PositiveFloat | None = key(
        None,
        "largest -k of a bidirectional drive: times the line voltage squared, the "
        "power that the line takes; current_scale_max_S when left out",
    )
    current_scale_slew_S: PositiveFloat = key(0.15, "largest change of k from one tick to the next")

    manual_slew_V_per_s: PositiveFloat = key(100.0, "largest slope of V_c in mode `manual`")
    load_power_max_W: PositiveFloat = key(1500.0, "load power above which V_c is held back")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.boost_reference_min_V >= self.boost_reference_max_V:
            raise ValueError(
                f"boost_reference_min_V = {self.boost_reference_min_V} must be below "
                f"boost_reference_max_V = {self.boost_reference_max_V}"
            )
        return self


class Manipulated(Section):
    """`[drive.manipulated]`: what a drive is commanded, and gives, where that is no voltage.

    All keys and topics that end in `_V` are then in its unit.
    """

    name: str = key(
        "v_bst",
        "name in texts, such as `frequency`, `torque` or `duty`",
        pattern=r"^[A-Za-z_][A-Za-z0-9_ ]{0,31}$",
    )
    unit: str = key("V", "unit in texts, such as `Hz`, `Nm`, `A` or `%`", max_length=16)


class DriveSection(Section):
    """`[drive]`: the power-electronic drive."""

    name: str = Field(
        pattern=r"^[A-Za-z0-9_][A-Za-z0-9_-]{0,63}$",
        description="name in topics, sessions, commands, and of the drive's user on the broker",
    )
    kind: Literal["unidirectional", "bidirectional"] = key(
        "unidirectional", "whether load current may be negative"
    )
    line_frequency_Hz: Literal[50, 60] = key(60, "line frequency; two fast ticks fit in one period")
    line_voltage_V: PositiveFloat = key(
        120.0, "nominal line voltage, rms, of a drive whose voltage the daemon holds"
    )
    boost_capacitance_F: PositiveFloat = key(1.0e-3, "boost capacitor")
    enable_bit: Literal["bridge", "bridge-and-boost"] = key(
        "bridge",
        "stages that `signals.command.bridge` switches: the bridge, on from `running`, or also the "
        "boost stage, on from `starting`; the load is then energised while v_bst rises",
    )
    limits: DriveLimits = Field(default_factory=DriveLimits)
    manipulated: Manipulated = Field(default_factory=Manipulated)

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

    @field_validator("name")
    @classmethod
    def _is_no_user(cls, name: str) -> str:
        if name.lower() in BROKER_USERS:
            raise ValueError(
                "is a user of the broker: a drive of that name could command all others; "
                "choose another name"
            )
        return name

    @model_validator(mode="after")
    def _regenerates(self) -> Self:
        if self.kind == "unidirectional" and self.limits.regeneration_scale_max_S is not None:
            raise ValueError("limits.regeneration_scale_max_S needs kind = 'bidirectional'")
        return self


class VoltageLoop(Section):
    """`[voltage_loop]`: the fast loop that makes v_bst follow V_c."""

    where: Literal["daemon", "drive"] = key(
        "daemon", "place of the voltage loop (from V_c to the current scale)"
    )
    feed_forward: bool = key(True, "add the measured load power")
    lag_s: NonNegativeFloat | None = key(
        None,
        "mean delay from V_c to v_bst of a drive that holds its own v_bst; at most "
        "the slow period; 9 half line cycles when left out",
    )
