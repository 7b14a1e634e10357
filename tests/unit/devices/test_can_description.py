"""What a DBC of another make asks for: pages, names, constants, seldom messages, CAN FD."""

from __future__ import annotations

import asyncio
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import can
import cantools
import pytest
from cantools.database.can.database import Database
from crccheck.crc import Crc8GsmA

from adaptdrive.app.ports import build_port
from adaptdrive.config import Configuration, load_configuration
from adaptdrive.config.bus import CanBus, SignalSource
from adaptdrive.config.file import validate_configuration
from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.devices.can import port as can_port
from adaptdrive.devices.can.bus import open_bus
from adaptdrive.safety.interlocks import Limits, find_cause
from adaptdrive.safety.trips import Trip, TripKind
from adaptdrive.util.errors import ConfigurationError
from adaptdrive.util.quantity import Display
from tests.unit.devices.bench import (
    EXAMPLES,
    MOTOR,
    Clock,
    Drive,
    Ear,
    rewritten,
    running,
    until,
    with_crc,
)

INVERTER = load_configuration(EXAMPLES / "motor-inverter.toml")
DATA_IDS = {"INV_STATE": 0x5F10, "INV_ACT": 0x5F11, "HOST_CMD": 0x5F13}
Values = dict[str, float | str]
STATE: Values = {"STATE": "Run", "FAULT_CODE": "None", "N_ACT": 1500.0, "I_OUT": 3.0}
VOLTAGES: Values = {"ACT_PAGE": 1, "U_DC": 300.0, "P_OUT": 420.0}
MAINS: Values = {"ACT_PAGE": 2, "U_MAINS": 121.5, "T_HEATSINK": 40.0}
HOURS: Values = {"ACT_PAGE": 3, "RUN_HOURS": 20.0}
RUN = Command(current_scale_S=0.0, boost_reference_V=287.66, bridge=True)


def commanding(**changes: object) -> Configuration:
    """The example with another `[signals.command]`, validated again."""
    document = INVERTER.model_dump()
    document["signals"]["command"] |= changes
    return Configuration.model_validate(document, strict=False)


def port_of(
    configuration: Configuration, clock: Callable[[], float] | None = None
) -> can_port.Port:
    port = build_port(configuration, clock or Clock(), "inverter.toml")
    assert isinstance(port, can_port.Port)
    return port


def load(path: Path) -> Database:
    database = cantools.database.load_file(path)
    assert isinstance(database, Database)
    return database


class Inverter:
    """Speaks as the DBC says, by cantools and crccheck."""

    def __init__(self, bus: can.BusABC) -> None:
        self.bus, self.database = bus, load(EXAMPLES / "inverter.dbc")
        self._alive = dict.fromkeys(DATA_IDS, 0)

    def send(self, name: str, values: Mapping[str, float | str]) -> None:
        message = self.database.get_message_by_name(name)
        prefix = name.removeprefix("INV_")
        proofs = {f"{prefix}_ALIVE": self._alive[name], f"{prefix}_CRC": 0}
        self._alive[name] = (self._alive[name] + 1) % 15
        data = bytearray(message.encode({**values, **proofs}, strict=False))
        data[7] = Crc8GsmA.calc(DATA_IDS[name].to_bytes(2, "little") + bytes(data[:7]))
        self.bus.send(
            can.Message(arbitration_id=message.frame_id, is_extended_id=True, data=bytes(data))
        )

    def decode(self, frame: can.Message) -> dict[str, object]:
        """Whatever a frame says; its checksum is verified."""
        message = self.database.get_message_by_frame_id(frame.arbitration_id)
        data = bytes(frame.data)
        assert data[7] == Crc8GsmA.calc(DATA_IDS[message.name].to_bytes(2, "little") + data[:7])
        return dict(message.decode_simple(data))

    def heard(self) -> list[dict[str, object]]:
        """Whatever the frames that have come say."""
        frames = list(iter(lambda: self.bus.recv(0), None))
        assert {(one.arbitration_id, one.is_extended_id) for one in frames} == {(0x18FF5F13, True)}
        return [self.decode(one) for one in frames]

    def send_all(self) -> None:
        self.send("INV_ACT", VOLTAGES)
        self.send("INV_ACT", MAINS)
        self.send("INV_STATE", STATE)


@pytest.fixture
def own(request: pytest.FixtureRequest) -> Configuration:
    """The example on a bus of its own."""
    assert isinstance(INVERTER.bus, CanBus)
    update = {"interface": "virtual", "channel": request.node.name}
    return INVERTER.model_copy(update={"bus": INVERTER.bus.model_copy(update=update)})


@pytest.fixture
def inverter(own: Configuration) -> Iterator[Inverter]:
    assert isinstance(own.bus, CanBus)
    bus = open_bus(own.bus)
    yield Inverter(bus)
    bus.shutdown()


@pytest.fixture
async def port(own: Configuration) -> can_port.Port:
    return port_of(own, asyncio.get_running_loop().time)


@pytest.fixture
def ear() -> Ear:
    return Ear()


async def test_a_reading_is_gathered_from_pages_of_either_order(
    inverter: Inverter, own: Configuration, ear: Ear
) -> None:
    """A page that nobody asked for is read over."""
    other = {"heat_sink": SignalSource(signal="INV_ACT.T_HEATSINK", offset=273.15)}
    signals = own.signals.model_copy(update={"other": other})
    port = port_of(own.model_copy(update={"signals": signals}))
    async with running(port, ear):
        inverter.send("INV_ACT", HOURS)
        inverter.send_all()
        await ear.hears(1)
    (reading,) = ear.readings
    assert reading.boost_voltage_V == pytest.approx(300.0)
    assert reading.load_power_W == pytest.approx(420.0)
    assert reading.line_voltage_V == pytest.approx(121.5)
    assert reading.output == pytest.approx(1500.0 * 2.1502e-3)
    assert (reading.bridge, reading.fault, reading.counter) == (True, 0, None)
    assert reading.other == {"heat_sink": pytest.approx(313.15)}
    assert port.statistics.out_of_range == port.statistics.foreign == 0


async def test_names_of_the_value_tables_are_used_and_told(
    inverter: Inverter, port: can_port.Port, ear: Ear
) -> None:
    async with running(port, ear):
        inverter.send_all()
        inverter.send("INV_STATE", STATE | {"STATE": "Fault", "FAULT_CODE": "Heat sink too hot"})
        await ear.hears(1)
        await until(lambda: ear.readings[-1].fault == 17)
    reading = ear.readings[-1]
    assert not reading.bridge
    limits = Limits(430.0, 5.0, Display("V"))
    assert find_cause(reading, reading.oldest_s, limits, 1.0) == Trip(
        TripKind.DRIVE_FAULT, "drive fault: FAULT_CODE Heat sink too hot (word 0x11)"
    )


@pytest.mark.parametrize(
    ("name", "values", "raw"),
    [
        ("INV_STATE", STATE, {"N_ACT": -8388.608}),  # "Encoder broken"
        ("INV_STATE", STATE, {"N_ACT": 8388.607}),  # "SNA"
        ("INV_STATE", STATE, {"STATE": "SNA"}),
        ("INV_ACT", MAINS, {"U_MAINS": 6553.4}),  # "Out of range"
        ("INV_ACT", MAINS, {"U_MAINS": 6553.5}),  # "SNA"
        ("INV_ACT", VOLTAGES, {"U_DC": 1310.7}),  # all ones, though the DBC's range has room for it
    ],
)
async def test_a_count_that_has_a_name_is_no_measurement(
    inverter: Inverter, port: can_port.Port, name: str, values: Values, raw: Values
) -> None:
    async with running(port, Ear()):
        inverter.send_all()
        inverter.send(name, values | raw)
        await until(lambda: port.statistics.received == 4)
        assert port.statistics.out_of_range == 1


async def test_a_command_is_spread_over_pages_with_its_constants(
    inverter: Inverter, port: can_port.Port
) -> None:
    async with running(port, Ear()):
        assert port.send(RUN)
        assert port.send(SAFE_COMMAND)
    heard = inverter.heard()

    def sent(name: str) -> list[object]:
        return [values[name] for values in heard if name in values]

    assert [values["CMD_ALIVE"] for values in heard] == [0, 1, 2, 3]
    assert sent("CMD_PAGE") == [1, 2, 1, 2]
    assert sent("REQUEST") == ["Run", "Stop"]
    assert sent("MODE") == ["Remote", "Remote"]
    assert sent("U_DC_SET") == [287.66, 0.0]
    assert sent("I_LIMIT") == [20.0, 20.0]


async def test_a_drive_that_took_a_part_of_its_first_command_counts_as_on(
    inverter: Inverter, port: can_port.Port, ear: Ear, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The frame that energises went out, and the next did not: it is heard before it gets more."""
    async with running(port, ear):
        bus = port._connection.bus
        assert bus is not None
        take, frames = bus.send, iter(range(2))

        def take_first(frame: can.Message, timeout: float | None = None) -> None:
            if next(frames):
                raise can.CanOperationError("Transmit buffer full")
            take(frame, timeout)

        monkeypatch.setattr(bus, "send", take_first)
        assert not port.send(RUN)
        assert [told["REQUEST"] for told in inverter.heard()] == ["Run"]
        bus.shutdown()
        await until(lambda: [up for up, _ in ear.bus] == [False, True])
        assert not port.send(RUN)
        inverter.send_all()
        await ear.hears(1)
        assert port.send(RUN)


async def test_a_seldom_value_may_be_as_old_as_its_cycle_time_says(
    inverter: Inverter, port: can_port.Port, ear: Ear
) -> None:
    async with running(port, ear):
        inverter.send_all()
        await ear.hears(1)
        inverter.send("INV_STATE", STATE)
        await ear.hears(2)
    # 4 cycles of 25 ms for the state; pages take three turns, so that theirs are 4 × 75 ms
    limits, stale_s = Limits(430.0, 5.0, Display("V")), INVERTER.interlocks.stale_s
    reading = ear.readings[1]
    assert reading.slack_s == 0.0  # the state is out of date first
    assert find_cause(reading, reading.arrival_s + 0.099, limits, stale_s) is None
    assert "limit 100 ms" in str(find_cause(reading, reading.arrival_s + 0.101, limits, stale_s))
    pages = replace(reading, slack_s=0.2)
    assert find_cause(pages, pages.oldest_s + 0.299, limits, stale_s) is None
    assert "limit 300 ms" in str(find_cause(pages, pages.oldest_s + 0.301, limits, stale_s))


@pytest.mark.parametrize(
    ("changes", "place", "words"),
    [
        ({"constants": {"HOST_CMD.MODE": "Remot"}}, "HOST_CMD.MODE", "did you mean 'Remote'"),
        ({"constants": {"HOST_CMD.MODE": 256.0}}, "HOST_CMD.MODE", "is outside 0…255"),
        ({"constants": {"HOST_CMD.MODE": 2.6}}, "HOST_CMD.MODE", "2.6 would be sent as 3"),
        ({"constants": {"HOST_CMD.MODE": -0.4}}, "HOST_CMD.MODE", "-0.4 would be sent as 0"),
        ({"constants": {"HOST_CMD.I_LIMIT": 20.04}}, "HOST_CMD.I_LIMIT", "counts are 0.05 apart"),
        ({"constants": {"HOST_CMD.REQUEST": 1.0}}, "signals.command.bridge", "a constant too"),
        ({"constants": {"HOST_CMD.CMD_CRC": 1.0}}, "HOST_CMD.CMD_CRC", "counter or checksum"),
        (
            {"bridge": {"signal": "HOST_CMD.REQUEST", "on": "Go"}},
            "signals.command.bridge",
            "no 'Go'",
        ),
        (
            {"bridge": {"signal": "HOST_CMD.REQUEST", "on": 0}},
            "signals.command.bridge",
            "both 0",
        ),
        ({"boost_reference_V": {"signal": "HOST_CMD.CMD_PAGE"}}, "boost_reference_V", "selects"),
    ],
)
def test_each_flaw_of_a_command_names_its_place(
    changes: dict[str, object], place: str, words: str
) -> None:
    with pytest.raises(ConfigurationError, match=f"(?s){re.escape(place)}.*{re.escape(words)}"):
        port_of(commanding(**changes))


def test_a_name_of_several_values_is_a_flaw(tmp_path: Path) -> None:
    """A drive that runs in two directions: in one of them its bridge would read as off."""
    text = (EXAMPLES / "inverter.dbc").read_text()
    path = tmp_path / "directions.dbc"
    path.write_text(
        text.replace('2 "Run"', '2 "Run" 4 "Run"').replace('85 "Run"', '85 "Run" 3 "Run"')
    )
    configuration = commanding()
    bus = configuration.bus.model_copy(update={"database": [path]})
    with pytest.raises(ConfigurationError) as caught:
        port_of(configuration.model_copy(update={"bus": bus}))
    found = {flaw.place: flaw.message for flaw in caught.value.flaws}
    assert found["signals.bridge.on"].endswith("several values the name 'Run': 2, 4")
    assert found["signals.command.bridge"].endswith("several values the name 'Run': 3, 85")


def test_a_bridge_that_is_on_where_nothing_is_known_is_a_flaw() -> None:
    document = INVERTER.model_dump()
    document["signals"]["bridge"]["on"] = "SNA"
    with pytest.raises(ConfigurationError) as caught:
        port_of(Configuration.model_validate(document, strict=False))
    (flaw,) = caught.value.flaws
    assert flaw.place == "signals.bridge.on"
    assert flaw.message.endswith("STATE = 15 says that nothing is known")


@pytest.mark.parametrize("amperes", [0.05, 20.15, 1599.95])
def test_a_constant_may_miss_its_count_in_binary(amperes: float) -> None:
    port_of(commanding(constants={"HOST_CMD.I_LIMIT": amperes}))


async def test_a_command_is_converted_to_the_unit_of_its_signal(
    inverter: Inverter, own: Configuration
) -> None:
    configuration = commanding(boost_reference_V={"signal": "HOST_CMD.U_DC_SET", "scale": 2.0})
    port = port_of(configuration.model_copy(update={"bus": own.bus}))
    async with running(port, Ear()):
        assert port.send(RUN)
    told = [values["U_DC_SET"] for values in inverter.heard() if "U_DC_SET" in values]
    assert told == [143.84]


@pytest.mark.parametrize(
    ("conversion", "words"),
    [
        ({"scale": 2.0, "offset": 100.0}, "switched: U_DC_SET = -50 is outside"),
        ({"offset": -0.013}, "0 would be sent as 0"),
    ],
)
def test_a_safe_command_that_no_count_of_its_signal_is_is_a_flaw(
    conversion: dict[str, float], words: str
) -> None:
    with pytest.raises(ConfigurationError, match=words):
        port_of(commanding(boost_reference_V={"signal": "HOST_CMD.U_DC_SET", **conversion}))


def fd_drive(folder: Path, length: int) -> CanBus:
    """The bus of a drive one of whose messages is longer than a classic frame."""
    longer = "BO_ 257 DriveLoad: 8", f"BO_ 257 DriveLoad: {length}"
    return rewritten(folder, longer, ("LoadCrc : 56|8", f"LoadCrc : {8 * length - 8}|8"))


async def test_long_frames_of_can_fd_are_exchanged(tmp_path: Path, free_udp_port: int) -> None:
    fields = {"fd": True, "udp_port": free_udp_port}
    bus = fd_drive(tmp_path, 48).model_copy(update=fields)
    port, ear = port_of(MOTOR.model_copy(update={"bus": bus})), Ear()
    peer = open_bus(bus)
    drive = Drive(peer)
    message = load(bus.database[0]).get_message_by_name("DriveLoad")
    async with running(port, ear):
        drive.send_status()
        names = [signal.name for signal in message.signals]
        data = message.encode(dict.fromkeys(names, 0) | {"Tachometer": 2.5, "LoadAlive": 3})
        peer.send(
            can.Message(
                arbitration_id=0x101,
                is_extended_id=False,
                is_fd=True,
                bitrate_switch=True,
                data=with_crc(data),
            )
        )
        await ear.hears(1)
        assert ear.readings[0].output == pytest.approx(2.5)
        assert port.send(SAFE_COMMAND)
    peer.shutdown()


@pytest.mark.parametrize(
    ("length", "fd", "words"), [(48, False, "bus.fd = true"), (40, True, "which no frame has")]
)
def test_a_frame_that_the_bus_cannot_carry_is_a_flaw(
    tmp_path: Path, length: int, fd: bool, words: str
) -> None:
    bus = fd_drive(tmp_path, length).model_copy(update={"fd": fd})
    with pytest.raises(ConfigurationError, match=words):
        port_of(MOTOR.model_copy(update={"bus": bus}))


SELDOM = ('"GenMsgCycleTime" BO_ 256 8', '"GenMsgCycleTime" BO_ 256 100')


def test_a_voltage_that_comes_seldom_is_no_business_of_the_fast_loop(tmp_path: Path) -> None:
    bus = rewritten(tmp_path, SELDOM)
    with pytest.raises(ConfigurationError, match=r"signals\.boost_voltage_V.*too seldom"):
        port_of(MOTOR.model_copy(update={"bus": bus}))


def test_a_voltage_that_comes_seldom_feeds_no_voltage_loop_by_a_detour(tmp_path: Path) -> None:
    tables = tomllib.loads((EXAMPLES / "motor.toml").read_text())
    tables["bus"]["database"] = str(rewritten(tmp_path, SELDOM).database[0])
    signals = tables["signals"]
    signals["other"] = {"dc_link": signals.pop("boost_voltage_V")}
    tables["derived"] = {"boost_voltage_V": {"rule": "mean", "of": ["dc_link"]}}
    tables["interlocks"]["stale_s"] = 0.3  # three cycles are no older than that
    with pytest.raises(ConfigurationError, match=r"signals\.other\.dc_link.*too seldom"):
        port_of(validate_configuration(tables, EXAMPLES / "motor.toml"))
