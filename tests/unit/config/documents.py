"""A small valid configuration, and variations of it."""

from __future__ import annotations

from pathlib import Path

from adaptdrive.config import Configuration, parse_configuration
from adaptdrive.util.errors import ConfigurationError

SOURCE = Path("/site/drives/bench.toml")
MINIMAL = {
    "drive.name": '"bench"',
    "bus.type": '"can"',
    "bus.interface": '"virtual"',
    "bus.channel": '"bench"',
    "bus.database": '"bench.dbc"',
    "bus.clock": '"DriveLoad"',
    "signals.boost_voltage_V.signal": '"DriveStatus.BoostVoltage"',
    "signals.line_voltage_V.signal": '"DriveStatus.LineVoltage"',
    "signals.load_power_W.signal": '"DriveStatus.LoadPower"',
    "signals.output.signal": '"DriveLoad.Tachometer"',
    "signals.command.current_scale_S.signal": '"DriveCommand.CurrentScale"',
    "signals.command.bridge": '"DriveCommand.BridgeEnable"',
    "load.type": '"motor"',
    "load.period_s": "1.0",
    "load.pole": "0.7",
    "load.reference_max": "6.0",
    "load.output_name": '"speed"',
    "load.output_unit": '"V"',
    "load.model.gain": "0.02",
    "load.model.tau_motor_s": "9.0",
    "load.model.tau_filter_s": "3.0",
    "interlocks.output_max": "7.0",
}


def document(**changes: str | None) -> str:
    """TOML text of the small configuration.

    Args:
        changes: TOML value by dotted key with `__` for the dots; None takes the key away, and
            a value for a whole table replaces its keys.
    """
    named = {key.replace("__", "."): value for key, value in changes.items()}
    replaced = tuple(f"{key}." for key in named)
    kept = {key: value for key, value in MINIMAL.items() if not key.startswith(replaced)}
    keys = {**kept, **named}
    return "\n".join(f"{key} = {value}" for key, value in keys.items() if value is not None)


def parse(**changes: str | None) -> Configuration:
    """The small configuration with changes."""
    return parse_configuration(document(**changes), SOURCE)


def flaws(**changes: str | None) -> dict[str, str]:
    """Message by place of every flaw of the small configuration with changes."""
    try:
        parse(**changes)
    except ConfigurationError as error:
        return {flaw.place: flaw.message for flaw in error.flaws}
    return {}
