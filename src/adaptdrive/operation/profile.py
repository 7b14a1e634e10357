"""The description of a drive for operators, in addition to its state: names, units and limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from adaptdrive.control.signals import Mode

Range = tuple[float | None, float | None]
"""Lowest and highest value, None where there is no limit."""


@dataclass(frozen=True, slots=True)
class Output:
    """The regulated quantity.

    Attributes:
        name: Its name, such as `speed`.
        unit: Unit of output, reference and set-point; empty for a plain number.
    """

    name: str = "output"
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Profile:
    """The constant part of `state`.

    Attributes:
        drive: Name of the drive.
        output: Name and unit of the regulated quantity.
        limits: Lowest and highest values: of `setpoint` and `output_trip` in the unit of the
            output, of `pole`, of `boost_V`, `boost_trip_V`, `power_W` and, for a waveform,
            `period_s`.
        modes: Modes that an operator can choose.
        version: Version of the daemon.
        manipulated: Name and unit of what the drive is commanded, and gives.
    """

    drive: str
    output: Output = Output()
    limits: Mapping[str, Range] | None = None
    modes: tuple[Mode, ...] = tuple(Mode)
    version: str = ""
    manipulated: Output = Output("v_bst", "V")
