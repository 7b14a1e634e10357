"""A small valid configuration of a drive on Modbus, and variations of it."""

from __future__ import annotations

from adaptdrive.config import Configuration, parse_configuration
from adaptdrive.config.polled import ModbusRtu, ModbusTcp
from adaptdrive.devices.polled.mapping import map_drive
from adaptdrive.util.errors import ConfigurationError
from tests.unit.config.documents import SOURCE

MINIMAL = {
    "drive.name": '"bench"',
    "bus.type": '"modbus-tcp"',
    "bus.host": '"127.0.0.1"',
    "bus.registers.voltage": "{ address = 0, table = 'input', scale = 0.01 }",
    "bus.registers.line": "{ address = 1, table = 'input', scale = 0.1 }",
    "bus.registers.power": "{ address = 2, table = 'input', type = 'int16' }",
    "bus.registers.speed": "{ address = 3, table = 'input', type = 'float32' }",
    "bus.registers.state": "{ address = 5, table = 'input' }",
    "bus.registers.wanted": "{ address = 0, table = 'holding', scale = 0.01 }",
    "bus.registers.control": "{ address = 1, table = 'holding' }",
    "bus.registers.alive": "{ address = 2, table = 'holding' }",
    "signals.boost_voltage_V": '"voltage"',
    "signals.line_voltage_V": '"line"',
    "signals.load_power_W": '"power"',
    "signals.output": '"speed"',
    "signals.command.boost_reference_V": '"wanted"',
    "signals.command.bridge": '"control"',
    "voltage_loop.where": '"drive"',
    "load.type": '"motor"',
    "load.period_s": "1.0",
    "load.pole": "0.7",
    "load.reference_max": "6.0",
    "load.output_name": '"speed"',
    "load.output_unit": '"V"',
    "load.latency_ticks": "12",
    "load.model.gain": "0.02",
    "load.model.tau_motor_s": "9.0",
    "load.model.tau_filter_s": "3.0",
    "interlocks.stale_s": "0.25",
    "interlocks.output_max": "7.0",
}


def document(**changes: str | None) -> str:
    """TOML text; keys have `__` for dots, None takes a key away."""
    named = {key.replace("__", "."): value for key, value in changes.items()}
    keys = {**MINIMAL, **named}
    return "\n".join(f"{key} = {value}" for key, value in keys.items() if value is not None)


def parse(**changes: str | None) -> Configuration:
    """The small configuration with changes."""
    return parse_configuration(document(**changes), SOURCE)


def flaws(**changes: str | None) -> dict[str, str]:
    """Message by place of every flaw of the file, and of the registers that it binds."""
    try:
        configuration = parse(**changes)
        bus = configuration.bus
        assert isinstance(bus, ModbusTcp | ModbusRtu)
        map_drive(configuration, bus, SOURCE, passive=False)
    except ConfigurationError as error:
        return {flaw.place: flaw.message for flaw in error.flaws}
    return {}
