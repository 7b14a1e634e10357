import math
import re
from pathlib import Path
from typing import Any

import pytest

from adaptdrive.config.bus import CanBus, CommandSignals, FrameIntegrity, SignalSource, SwitchSource
from adaptdrive.control.signals import SAFE_COMMAND
from adaptdrive.devices.can.database import read_dbc
from adaptdrive.devices.can.mapping import map_drive
from adaptdrive.devices.description import demands_of
from adaptdrive.util.errors import ConfigurationError
from tests.unit.devices.bench import (
    MOTOR,
    MOTOR_BUS,
    TIMING,
    motor_bus,
    motor_signals,
    rewritten,
)


def integrity(message: str, **changes: object) -> dict[str, FrameIntegrity]:
    """The example's integrity with that of one message changed."""
    changed = MOTOR_BUS.integrity[message].model_copy(update=changes)
    return {**MOTOR_BUS.integrity, message: changed}


def flaws_of(bus: CanBus) -> dict[str, str]:
    """Message by place of every flaw of the example on a bus."""
    with pytest.raises(ConfigurationError) as caught:
        map_drive(bus, MOTOR.signals, TIMING)
    return {flaw.place: flaw.message for flaw in caught.value.flaws}


def commanding(**changes: str) -> CommandSignals:
    return CommandSignals.model_validate({**dict(MOTOR.signals.command), **changes})


def test_the_example_maps_without_a_flaw() -> None:
    mapping = map_drive(MOTOR_BUS, MOTOR.signals, TIMING)
    assert mapping.counter_modulus == 65536
    assert map_drive(MOTOR_BUS, motor_signals(counter=None), TIMING).counter_modulus is None
    assert {status.codec.name for status in mapping.statuses} == {"DriveStatus", "DriveLoad"}
    assert [order.codec.name for order in mapping.orders] == ["DriveCommand"]


NEVER_ON = "the bridge would never be on: BridgeOn = 8 is outside 0…1"
OF_BUS: list[tuple[dict[str, object], str, str]] = [
    ({"clock": "DriveLod"}, "clock", "did you mean 'DriveLoad'"),
    ({"clock": "DriveCommand"}, "clock", "no entry of [signals]"),
    ({"channel": "can0"}, "channel", "'can0'"),
    ({"channel": "10.0.0.1"}, "channel", "multicast group"),
    ({"interface": "socketcan", "channel": ""}, "channel", "such as can0"),
    ({"polled": {"DriveLod": "rtr"}}, "polled.DriveLod", "did you mean 'DriveLoad'"),
    ({"polled": {"DriveLoad": "pgn"}}, "polled.DriveLoad", "address; ask by 'rtr'"),
    ({"polled": {"DriveCommand": "rtr"}}, "polled.DriveCommand", "carries the com"),
]
OF_SIGNALS: list[tuple[dict[str, object], str]] = [
    ({"output": "DriveLoad.Tacho"}, "did you mean 'Tachometer'"),
    ({"output": "Tachometer"}, "Message.Signal"),
    ({"output": {"signal": "Tachometer"}}, "Message.Signal"),
    ({"output": "a.b.c"}, "no message 'a'"),
    ({"fault": "Nothing.Fault"}, "no message 'Nothing'"),
    ({"fault": "DriveStatus.LoadPower"}, "factor 1"),
    ({"bridge": "DriveLoad.Tachometer"}, "factor 1"),
    ({"counter": "DriveLoad.Tachometer"}, "cannot count"),
    ({"counter": "DriveStatus.BridgeOn"}, "cannot count"),
    ({"counter": SignalSource(signal="DriveLoad.HalfCycle", scale=2.0)}, "no scale"),
]
OF_BRIDGE = [
    ("DriveCommand.Bridge", "did you mean 'BridgeEnable'"),
    ("DriveCommand.CommandCrc", "counter or checksum"),
    ("DriveCommand.CurrentScale", "could not be switched"),
]
OF_INTEGRITY: list[tuple[dict[str, object], str, str]] = [
    ({"counter": "Alive"}, ".counter", "'Alive'"),
    ({"counter": "Tachometer"}, ".counter", "cannot count"),
    ({"checksum": "LoadCurrent"}, ".checksum", "one whole byte"),
    ({"counter": "LoadCrc"}, "", "both counter and checksum"),
]
FLAWS: list[tuple[Any, ...]] = [
    *((bus, {}, f"bus.{place}", words) for bus, place, words in OF_BUS),
    *(({}, signals, f"signals.{next(iter(signals))}", words) for signals, words in OF_SIGNALS),
    *(
        ({}, {"command": commanding(bridge=signal)}, "signals.command.bridge", words)
        for signal, words in OF_BRIDGE
    ),
    *(
        ({"integrity": integrity("DriveLoad", **changes)}, {}, f"bus.integrity.DriveLoad{at}", said)
        for changes, at, said in OF_INTEGRITY
    ),
    (
        {"integrity": {"DriveStats": FrameIntegrity()}},
        {},
        "bus.integrity.DriveStats",
        "did you mean 'DriveStatus'",
    ),
    (
        {},
        {"command": commanding(boost_reference_V="DriveStatus.BoostVoltage")},
        "signals.command",
        "carries measurements too",
    ),
    (
        {},
        {"bridge": SwitchSource(signal="DriveStatus.BridgeOn", on=8)},
        "signals.bridge.on",
        NEVER_ON,
    ),
]


@pytest.mark.parametrize(("bus", "signals", "place", "words"), FLAWS)
def test_each_flaw_names_its_place(
    bus: dict[str, object], signals: dict[str, object], place: str, words: str
) -> None:
    with pytest.raises(ConfigurationError) as caught:
        map_drive(motor_bus(**bus), motor_signals(**signals), TIMING)
    found = {flaw.place: flaw.message for flaw in caught.value.flaws}
    assert words in found[place]


def test_all_flaws_are_listed_at_once() -> None:
    bus = motor_bus(clock="A", channel="can0", integrity=integrity("DriveLoad", counter="C"))
    signals = motor_signals(output="DriveLoad.B", command=commanding(bridge="D"))
    with pytest.raises(ConfigurationError) as caught:
        map_drive(bus, signals, TIMING, "motor.toml")
    assert {flaw.place for flaw in caught.value.flaws} == {
        "bus.clock",
        "bus.channel",
        "bus.integrity.DriveLoad.counter",
        "signals.output",
        "signals.command.bridge",
    }
    assert all(line.startswith("motor.toml: ") for line in str(caught.value).splitlines())


def test_a_signal_that_excludes_zero_cannot_command(tmp_path: Path) -> None:
    bus = rewritten(tmp_path, ("(0.01,0) [0|600]", "(0.01,0) [200|600]"))
    with pytest.raises(ConfigurationError, match=r"signals\.command\.boost_reference_V.*200…600"):
        map_drive(bus, MOTOR.signals, TIMING)


def test_a_signed_bit_is_on_at_minus_one(tmp_path: Path) -> None:
    """At 1, the value where `on` is left out, each reading would have the bridge off."""
    bus = rewritten(tmp_path, ("44|1@1+ (1,0) [0|1]", "44|1@1- (1,0) [-1|0]"))
    with pytest.raises(
        ConfigurationError, match=r"signals\.bridge\.on.* BridgeOn = 1 is outside -1…0"
    ):
        map_drive(bus, MOTOR.signals, TIMING)
    signals = motor_signals(bridge=SwitchSource(signal="DriveStatus.BridgeOn", on=-1))
    (bridge,) = (
        one
        for status in map_drive(bus, signals, TIMING).statuses
        for one in status.sources
        if one.quantity == "bridge"
    )
    assert bridge.on == -1.0


def with_initial(folder: Path, message: str, signal: str, kind: str, value: str) -> CanBus:
    """The bus of the example, whose DBC has a signal of its own and an initial value."""
    spare = ' SG_ Spare : 33|4@1- (1,0) [0|0] "" Drive\n'
    bus = rewritten(folder, (" SG_ CommandAlive", spare + " SG_ CommandAlive"))
    text = bus.database[0].read_text(encoding="utf-8")
    number = re.search(rf"BO_ (\d+) {message}", text)
    assert number is not None
    attribute = '"GenSigStartValue"'
    text += f"\nBA_DEF_ SG_ {attribute} {kind};\nBA_DEF_DEF_ {attribute} 0;\n"
    text += f"BA_ {attribute} SG_ {number[1]} {signal} {value};\n"
    bus.database[0].write_text(text)
    return bus


@pytest.mark.parametrize("kind", ["INT -100 100", "FLOAT -100 100"])
@pytest.mark.parametrize("value", [-8, 7])
def test_an_initial_value_of_either_kind_is_sent(tmp_path: Path, kind: str, value: int) -> None:
    bus = with_initial(tmp_path, "DriveCommand", "Spare", kind, str(value))
    (order,) = map_drive(bus, MOTOR.signals, TIMING).orders
    message = read_dbc(bus.database[0])[0].get_message_by_name("DriveCommand")
    sent = message.decode_simple(order.encode(SAFE_COMMAND))
    assert (sent["Spare"], sent["BoostReference"]) == (value, 0.0)


@pytest.mark.parametrize("value", ["0.5", "8", "-9", "1e9"])
def test_an_initial_value_that_its_signal_cannot_hold_is_a_flaw(tmp_path: Path, value: str) -> None:
    bus = with_initial(tmp_path, "DriveCommand", "Spare", "FLOAT -100 100", value)
    found = flaws_of(bus)
    assert list(found) == ["signals.command"]
    named = "'Spare' of 4 bits cannot hold its initial value (GenSigStartValue)"
    assert f"{named} {float(value):.12g}" in found["signals.command"]


@pytest.mark.parametrize(
    ("message", "signal"), [("DriveStatus", "LoadPower"), ("DriveCommand", "BoostReference")]
)
@pytest.mark.parametrize("value", ["3", "0.5", "1e9"])
def test_an_initial_value_that_is_never_sent_may_be_any(
    tmp_path: Path, message: str, signal: str, value: str
) -> None:
    bus = with_initial(tmp_path, message, signal, "FLOAT -100 100", value)
    mapping = map_drive(bus, MOTOR.signals, TIMING)
    assert all(status.codec.encode({}) for status in mapping.statuses)


def test_what_selects_a_page_cannot_be_commanded_itself(tmp_path: Path) -> None:
    bus = rewritten(
        tmp_path,
        ("BridgeEnable : 32", "BridgeEnable M : 32"),
        ("BoostReference : 16", "BoostReference m1 : 16"),
    )
    found = flaws_of(bus)
    assert list(found) == ["signals.command.bridge"]
    assert "selects what else" in found["signals.command.bridge"]


@pytest.mark.parametrize("content", [None, "no database\n", "VERSION 1\nBO_ one"])
def test_a_file_that_is_no_database_is_one_flaw(tmp_path: Path, content: str | None) -> None:
    path = tmp_path / "some.dbc"
    if content is not None:
        path.write_text(content)
    found = flaws_of(motor_bus(database=[path]))
    assert list(found) == ["bus.database"]
    assert "\n" not in found["bus.database"]


TEXT_CYCLES = (
    ('"GenMsgCycleTime" INT 0 65535', '"GenMsgCycleTime" STRING '),
    ('BA_DEF_DEF_ "GenMsgCycleTime" 0', 'BA_DEF_DEF_ "GenMsgCycleTime" ""'),
    ("BO_ 128 8;", 'BO_ 128 "8";'),
)


def test_a_cycle_time_that_is_a_text_is_none(tmp_path: Path) -> None:
    bus = rewritten(tmp_path, *TEXT_CYCLES, ("BO_ 256 8;", 'BO_ 256 "8 ms";'), ("BO_ 257 8;", ""))
    status, _ = map_drive(bus, MOTOR.signals, TIMING).statuses
    assert status.codec.name == "DriveStatus"
    assert {one.cycle_s for one in status.sources} == {math.inf}


@pytest.mark.parametrize(
    ("number", "place", "message"),
    [(" 257 ", "signals", "DriveLoad"), (" 128 ", "signals.command", "DriveCommand")],
)
def test_a_message_with_the_id_of_a_measurement_is_a_flaw(
    tmp_path: Path, number: str, place: str, message: str
) -> None:
    same = f"messages 'DriveStatus' and {message!r} have the same id 0x100"
    assert flaws_of(rewritten(tmp_path, (number, " 256 "))) == {place: same}


def test_the_same_number_of_both_lengths_is_two_ids(tmp_path: Path) -> None:
    bus = rewritten(tmp_path, ("BO_ 257 ", f"BO_ {(1 << 31) | 256} "))
    assert len(map_drive(bus, MOTOR.signals, TIMING).statuses) == 2


@pytest.mark.parametrize(
    ("range_", "place"),
    [
        ("[-8.388608|8.388606]", "signals.output"),
        ("[0|600]", "signals.command.boost_reference_V"),
    ],
)
def test_a_range_that_ends_below_its_start_is_a_flaw(
    tmp_path: Path, range_: str, place: str
) -> None:
    low, high = range_.strip("[]").split("|")
    found = flaws_of(rewritten(tmp_path, (range_, f"[{high}|{low}]")))
    assert "ends below its start" in found[place]


@pytest.mark.parametrize(
    ("range_", "narrow", "place", "key"),
    [
        ("[-8.388608|8.388606]", "[0|5]", "signals.output", "output_max = 5"),
        ("[0|655.34]", "[0|420]", "signals.boost_voltage_V", "boost_voltage_max_V = 430"),
    ],
)
def test_a_measurement_that_cannot_show_what_trips_is_a_flaw(
    tmp_path: Path, range_: str, narrow: str, place: str, key: str
) -> None:
    demands = demands_of(MOTOR)
    with pytest.raises(ConfigurationError) as caught:
        map_drive(rewritten(tmp_path, (range_, narrow)), MOTOR.signals, TIMING, demands=demands)
    (flaw,) = caught.value.flaws
    assert flaw.place == place
    assert f"interlocks.{key} can never trip" in flaw.message
    map_drive(motor_bus(), MOTOR.signals, TIMING, demands=demands)
