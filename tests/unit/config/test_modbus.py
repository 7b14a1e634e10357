"""A register map that does not fit is refused, wholly listed, and named by its place."""

from __future__ import annotations

from pathlib import Path

from adaptdrive.config.polled import ModbusRtu
from tests.unit.config import documents
from tests.unit.config.modbus_documents import parse


def test_a_small_map_is_enough() -> None:
    bus = parse().bus
    assert bus.type == "modbus-tcp"
    assert (bus.port, bus.device_id) == (502, 1)


def test_a_serial_port_is_found_beside_the_file() -> None:
    rtu = {"bus__type": '"modbus-rtu"', "bus__host": None}
    bus = parse(**rtu, bus__device='"drive.tty"').bus
    assert isinstance(bus, ModbusRtu)
    assert bus.device == documents.SOURCE.parent / "drive.tty"
    absolute = parse(**rtu, bus__device='"/dev/ttyUSB0"').bus
    assert isinstance(absolute, ModbusRtu)
    assert absolute.device == Path("/dev/ttyUSB0")
