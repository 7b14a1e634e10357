"""A register map that does not fit is refused, wholly listed, and named by its place."""

from __future__ import annotations

from pathlib import Path

import pytest

from adaptdrive.config.modbus import ModbusRtu
from tests.config import documents
from tests.config.modbus_documents import flaws, parse


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


@pytest.mark.parametrize("host", ["", " ", "my gateway", "gateway:502"])
def test_a_host_that_cannot_be_looked_up_is_refused(host: str) -> None:
    found = flaws(bus__host=f'"{host}"')
    assert set(found) == {"bus.host"}
    assert "neither an IP address nor a host name" in found["bus.host"]


def test_a_serial_port_without_a_name_is_refused() -> None:
    rtu = {"bus__type": '"modbus-rtu"', "bus__host": None}
    assert flaws(**rtu, bus__device='""') == {"bus.device": "must not be empty (it is '')"}


def test_every_flaw_is_listed_with_its_place() -> None:
    found = flaws(
        bus__port="0",
        bus__hots='"typo"',
        bus__registers__voltage="{ address = -1, table = 'coils' }",
        bus__heartbeat__drvie='"alive"',
    )
    assert set(found) == {
        "bus.port",
        "bus.hots",
        "bus.registers.voltage.address",
        "bus.registers.voltage.table",
        "bus.heartbeat.drvie",
    }


def test_every_wrong_reference_is_listed() -> None:
    found = flaws(
        signals__output='"sped"',
        signals__fault='"nothing"',
        signals__command__bridge='"state"',
        bus__heartbeat__drive='"pulse"',
        bus__heartbeat__daemon='"wanted"',
    )
    assert set(found) == {
        "signals.output.signal",
        "signals.fault.signal",
        "signals.command.bridge",
        "bus.heartbeat.drive",
        "bus.heartbeat.daemon",
    }
    assert "no register 'sped'" in found["signals.output.signal"]
    assert "cannot be written" in found["signals.command.bridge"]


def test_a_name_of_a_can_bus_is_none_of_a_register() -> None:
    on_modbus = flaws(signals__output='"DriveLoad.Tachometer"')
    assert set(on_modbus) == {"signals.output.signal"}


@pytest.mark.parametrize(
    ("changes", "place", "words"),
    [
        (
            {"bus__registers__speed": "{ address = 65535, table = 'input', type = 'float32' }"},
            "bus.registers.speed.address",
            "no room",
        ),
        (
            {"bus__registers__line": "{ address = 1, table = 'input', scale = 0.0 }"},
            "bus.registers.line.scale",
            "must not be 0",
        ),
        (
            {
                "bus__registers__line": (
                    "{ address = 1, table = 'input', range = { low = 9.0, high = 1.0 } }"
                )
            },
            "bus.registers.line.range",
            "low = 9.0 must be below high = 1.0",
        ),
        (
            {"bus__registers__state": "{ address = 5, table = 'input', bit = 16 }"},
            "bus.registers.state.bit",
            "uint16 has no bit 16",
        ),
        (
            {"bus__registers__line": "{ address = 1, table = 'input', not_available = 65536 }"},
            "bus.registers.line.not_available",
            "uint16 has no count 65536",
        ),
        (
            {"bus__registers__line": "{ address = 1, table = 'input', not_available = -1 }"},
            "bus.registers.line.not_available",
            "uint16 has no count -1",
        ),
        (
            {"bus__registers__state": "{ address = 5, table = 'input', mask = 0x10000 }"},
            "bus.registers.state.mask",
            "uint16 has no bits 0x10000",
        ),
        (
            {"bus__registers__state": "{ address = 5, table = 'discrete', bit = 1 }"},
            "bus.registers.state.type",
            "a discrete is one bit",
        ),
        (
            {"signals__fault": '"speed"'},
            "signals.fault",
            "must be an integer with factor 1",
        ),
        (
            {"signals__bridge": "{ signal = 'state', scale = 2.0 }"},
            "signals.bridge",
            "takes no scale",
        ),
        (
            {"bus__heartbeat__drive": '"alive"'},
            "bus.heartbeat.drive",
            "'alive' lies in the register of 'alive', which the daemon writes",
        ),
        (
            {"bus__registers__alive": "{ address = 1, table = 'holding' }"},
            "bus.heartbeat.daemon",
            "'alive' lies in the same register as 'control'",
        ),
        ({"bus__heartbeat__daemon": '""'}, "bus.heartbeat.daemon", "has no register ''"),
        ({"bus__timeout_s": "0.1"}, "bus.timeout_s", "must be below one poll"),
        ({"interlocks__stale_s": "0.149"}, "interlocks.stale_s", "at least 0.15 s"),
        ({"load__latency_ticks": "2"}, "load.latency_ticks", "a multiple of one poll"),
        ({"load__period_s": "0.95"}, "load.period_s", "whole multiple of one poll"),
        ({"voltage_loop__where": '"daemon"'}, "voltage_loop.where", "must hold its own"),
        (
            {"signals__command__current_scale_S": '"alive"'},
            "signals.command.current_scale_S",
            "V_c only",
        ),
        (
            {"signals__command__boost_reference_V": None},
            "signals.command.boost_reference_V",
            "is missing",
        ),
    ],
)
def test_what_does_not_fit_is_a_flaw(
    changes: dict[str, str | None], place: str, words: str
) -> None:
    given = {"bus__heartbeat__daemon": '"alive"', **changes}
    found = flaws(**given)
    assert place in found
    assert words in found[place]


@pytest.mark.parametrize(
    ("register", "on", "words"),
    [
        ("bit = 3", 8, "the bridge would never be on: state = 8 is outside 0…1"),
        ("bit = 3", -1, "outside 0…1"),
        ("type = 'uint16'", 65536, "outside 0…65535"),
        ("type = 'uint16'", -1, "outside 0…65535"),
        ("type = 'int16'", 32768, "outside -32768…32767"),
        ("type = 'int32'", -2147483649, "outside -2147483648…2147483647"),
        ("range = { low = 0.5, high = 7.5 }", 8, "outside 1…7"),
        ("range = { low = -1e6, high = 1e6 }", 65536, "outside 0…65535"),
        ("not_available = 8", 8, "state = 8 says that nothing is known"),
    ],
)
def test_a_count_that_no_reading_of_the_bridge_can_be_is_a_flaw(
    register: str, on: int, words: str
) -> None:
    found = flaws(
        bus__registers__state=f"{{ address = 6, table = 'input', {register} }}",
        signals__bridge=f"{{ signal = 'state', on = {on} }}",
    )
    assert set(found) == {"signals.bridge.on"}
    assert words in found["signals.bridge.on"]


@pytest.mark.parametrize(
    ("register", "on"),
    [
        ("bit = 3", 0),
        ("bit = 3", 1),
        ("bit = 3, not_available = 1", 1),
        ("mask = 0x0070", 7),
        ("type = 'uint16'", 65535),
        ("type = 'int16'", -32768),
        ("type = 'uint32'", 4294967295),
        ("range = { low = 1.0, high = 8.0 }", 8),
    ],
)
def test_a_count_that_a_reading_of_the_bridge_can_be_is_taken(register: str, on: int) -> None:
    given = f"{{ address = 6, table = 'input', {register} }}"
    assert (
        flaws(bus__registers__state=given, signals__bridge=f"{{ signal = 'state', on = {on} }}")
        == {}
    )


@pytest.mark.parametrize(
    "other",
    [
        "{ address = 4, table = 'input' }",  # the second register of the float at 3
        "{ address = 2, table = 'input', type = 'uint32' }",
        "{ address = 3, table = 'input', type = 'float32', word_order = 'little' }",
        "{ address = 3, table = 'input', type = 'float32', scale = 0.1 }",
    ],
)
def test_values_that_share_a_register_are_a_flaw(other: str) -> None:
    (place, message), *_ = flaws(bus__registers__other=other).items()
    assert place in {"bus.registers.other", "bus.registers.speed"}
    assert "share a register" in message


def test_what_is_written_must_not_reach_into_what_is_read() -> None:
    read = "{ address = 0, table = 'holding', type = 'int32' }"
    assert set(flaws(bus__registers__other=read)) == {
        "bus.registers.other",
        "bus.registers.control",
    }


@pytest.mark.parametrize(
    "other",
    [
        "{ address = 3, table = 'input', type = 'float32' }",  # the same value by two names
        "{ address = 5, table = 'input', bit = 3 }",
        "{ address = 3, table = 'holding', type = 'float32' }",
    ],
)
def test_one_value_may_have_two_names(other: str) -> None:
    assert flaws(bus__registers__other=other) == {}


@pytest.mark.parametrize(
    ("address", "table", "meant"),
    [
        (30001, "input", "address = 0, table = 'input'"),
        (39999, "input", "address = 9998, table = 'input'"),
        (40001, "holding", "address = 0, table = 'holding'"),
        (40020, "input", "address = 19, table = 'holding'"),
    ],
)
def test_a_label_of_a_manual_is_no_address(address: int, table: str, meant: str) -> None:
    register = f"{{ address = {address}, table = '{table}' }}"
    found = flaws(bus__registers__other=register)
    assert set(found) == {"bus.registers.other.address"}
    assert meant in found["bus.registers.other.address"]
    assert flaws(bus__registers__other=register, bus__zero_based="true") == {}


@pytest.mark.parametrize("address", [30000, 40000, 50000])
def test_other_high_addresses_are_taken_as_they_stand(address: int) -> None:
    assert flaws(bus__registers__other=f"{{ address = {address}, table = 'input' }}") == {}


def test_a_register_that_is_not_there_is_proposed() -> None:
    assert (
        "did you mean 'voltage'?"
        in flaws(signals__boost_voltage_V='"voltag"')["signals.boost_voltage_V.signal"]
    )
