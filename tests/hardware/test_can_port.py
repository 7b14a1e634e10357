import asyncio
import contextlib
import math
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import can
import pytest

from adaptdrive.app.ports import build_port as build_configured
from adaptdrive.config.bus import CanBus, CommandSignals, SignalSource
from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.errors import BusError
from adaptdrive.hardware.dbc.mapping import map_drive
from adaptdrive.hardware.dbc.port import CanPort
from adaptdrive.hardware.doubts import QUIET_S
from adaptdrive.hardware.link.bus import open_bus
from adaptdrive.hardware.port import Reading
from adaptdrive.runtime.interlocks import Limits, find_cause
from adaptdrive.runtime.stop_watch import Stop, StopWatch
from tests.hardware.bench import (
    MOTOR,
    STATUS,
    TIMING,
    Clock,
    Drive,
    Ear,
    build_port,
    motor_bus,
    motor_signals,
    noted_delays,
    reference_database,
    rewritten,
    running,
    until,
    with_crc,
)

COMMAND = Command(current_scale_S=0.04321, boost_reference_V=287.65, bridge=True)
Changes = tuple[float, int]
"""`interlocks.stop_s`, and the cycle of the message with the bridge, in ms."""


@pytest.fixture
def config(free_udp_port: int) -> CanBus:
    """A bus of its own for each test."""
    return motor_bus(udp_port=free_udp_port)


@pytest.fixture
def drive(config: CanBus) -> Iterator[Drive]:
    bus = open_bus(config)
    yield Drive(bus)
    bus.shutdown()


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def port(config: CanBus, clock: Clock) -> CanPort:
    return build_port(config, clock)


@pytest.fixture
def ear() -> Ear:
    return Ear()


@contextlib.asynccontextmanager
async def heard(
    port: CanPort, drive: Drive, ear: Ear, *commands: Command, **status: float
) -> AsyncIterator[None]:
    """Run a port until the block ends, from a report of its drive and the commands after it on."""
    async with running(port, ear):
        await drive.reports(ear, **status)
        for command in commands:
            assert port.send(command)
        yield


async def heard_by(port: CanPort, count: int) -> None:
    await until(lambda: port.statistics.received >= count)


async def test_a_reading_holds_what_the_drive_sent(port: CanPort, drive: Drive, ear: Ear) -> None:
    async with running(port, ear):
        drive.half_cycle = 65535
        await drive.reports(ear)
    assert asdict(ear.readings[0]) == {
        "arrival_s": 1000.0,
        "oldest_s": 1000.0,
        "counter": 65535,
        "boost_voltage_V": pytest.approx(300.12),
        "line_voltage_V": pytest.approx(120.4),
        "load_power_W": pytest.approx(431.7),
        "output": pytest.approx(3.123456),
        "fault": 0,
        "bridge": True,
        "other": {},
        "slack_s": 0.0,
        "fault_name": "",
        "bridge_s": 1000.0,
        "whole": True,
        "warning": "",
    }


async def test_the_clock_message_alone_makes_readings(
    port: CanPort, drive: Drive, ear: Ear
) -> None:
    async with running(port, ear):
        drive.send_load()
        drive.send_load()
        drive.send_status()
        await heard_by(port, 3)
        assert ear.readings == []  # first without a status, then without a tick
        drive.send_load()
        await ear.hears(1)
        drive.send_status()
        await heard_by(port, 5)
        assert len(ear.readings) == 1


async def test_values_age_while_their_message_is_missing(
    port: CanPort, drive: Drive, ear: Ear, clock: Clock
) -> None:
    async with heard(port, drive, ear):
        for count in (2, 3, 4):
            clock.now_s += 0.25
            drive.send_load()
            await ear.hears(count)
    ages = [reading.arrival_s - reading.oldest_s for reading in ear.readings]
    assert ages == [0.0, 0.25, 0.5, 0.75]


def rarely_clocked(config: CanBus, folder: Path, clock: Clock) -> CanPort:
    """A port whose clock comes every 100 ms, and the other message every half cycle."""
    bus = rewritten(folder, ("BO_ 257 8;", "BO_ 257 100;"), bus=config)
    bus = bus.model_copy(update={"clock_ticks": 12})
    timing = replace(TIMING, stale_s=0.15, voltage_parts=frozenset())
    return build_port(bus, clock, timing)


async def test_a_rare_clock_may_lose_a_frame_and_is_named_once_it_is_gone(
    config: CanBus, drive: Drive, ear: Ear, clock: Clock, tmp_path: Path
) -> None:
    port, limits = rarely_clocked(config, tmp_path, clock), Limits(430.0, 5.0, "V")
    causes: list[str | None] = []
    async with heard(port, drive, ear):
        for count in range(2, 33):  # one frame of the clock is lost, then all of them
            clock.now_s += 0.01
            drive.send_status()
            await heard_by(port, count + 1)
            cause = find_cause(ear.readings[-1], clock.now_s, limits, 0.15, port.explain_age)
            causes.append(cause)
    assert causes[:29] == [None] * 29
    assert causes[30] is not None
    assert "limit 300 ms; output (0x101 (DriveLoad), Tachometer) is the oldest" in causes[30]
    assert port.stop_slack_s == pytest.approx(0.15)  # the report of the bridge waits for it too
    assert port.bridge_cycle_s == pytest.approx(0.1)


def flipped(drive: Drive, name: str) -> bytes:
    frame = drive.frame(name)
    return bytes((frame[0] ^ 1,)) + frame[1:]


def repeated(drive: Drive, name: str) -> bytes:
    drive.alive[name] = (drive.alive[name] - 1) % 16
    return drive.frame(name)


def leapt(drive: Drive, name: str) -> bytes:
    drive.alive[name] = (drive.alive[name] + 5) % 16
    return drive.frame(name)


def short(drive: Drive, name: str) -> bytes:
    return drive.frame(name)[:7]


def unavailable(drive: Drive, name: str) -> bytes:
    frame = drive.frame(name)
    missing = {"DriveStatus": b"\xff\xff", "DriveLoad": b"\xff\xff\x7f"}[name]
    return with_crc(missing + frame[len(missing) :])


@pytest.mark.parametrize("name", ["DriveStatus", "DriveLoad"])
@pytest.mark.parametrize(
    ("spoil", "counts"),
    [
        (flipped, {"wrong_checksum": 1}),
        (repeated, {"counter_stuck": 1}),
        (leapt, {"counter_lost": 5}),
        (short, {"wrong_length": 1}),
    ],
)
async def test_a_frame_that_fails_a_check_changes_nothing_and_is_counted(  # noqa: PLR0917
    port: CanPort,
    drive: Drive,
    ear: Ear,
    clock: Clock,
    name: str,
    spoil: Callable[[Drive, str], bytes],
    counts: dict[str, int],
) -> None:
    async with heard(port, drive, ear):
        clock.now_s += 1.0
        drive.put(name, spoil(drive, name))
        await heard_by(port, 3)
        assert len(ear.readings) == 1
        expected = dict.fromkeys(asdict(port.statistics), 0) | {"received": 3} | counts
        assert asdict(port.statistics) == expected
        if name == "DriveStatus":
            drive.send_load(Tachometer=1.0)
            await ear.hears(2)
            assert ear.readings[1].boost_voltage_V == ear.readings[0].boost_voltage_V
            assert ear.readings[1].oldest_s == ear.readings[0].oldest_s


async def test_good_frames_follow_bad_ones(port: CanPort, drive: Drive, ear: Ear) -> None:
    async with heard(port, drive, ear):
        for spoil in (flipped, leapt, short, unavailable):
            for name in ("DriveStatus", "DriveLoad"):
                drive.put(name, spoil(drive, name))
        await drive.reports(ear)
    assert ear.readings[1].boost_voltage_V == pytest.approx(300.12)


async def test_a_small_jump_is_believed_and_counted(port: CanPort, drive: Drive, ear: Ear) -> None:
    async with heard(port, drive, ear):
        drive.frame("DriveLoad")
        drive.frame("DriveLoad")
        await drive.reports(ear)
        assert port.statistics.counter_lost == 2


async def test_the_fault_word_and_the_bridge_are_passed_on(
    port: CanPort, drive: Drive, ear: Ear
) -> None:
    async with heard(port, drive, ear, Fault=9, BridgeOn=0):
        await drive.reports(ear, Fault=127)
    assert [(reading.fault, reading.bridge) for reading in ear.readings] == [
        (9, False),
        (127, True),
    ]


def late_port(config: CanBus, clock: Clock) -> CanPort:
    """A port whose frames count as having waited since their queue was last empty."""
    return CanPort(config, map_drive(config, motor_signals(), TIMING), clock, lambda: 4e9)


async def test_of_readings_that_piled_up_only_the_newest_is_handed_out(
    config: CanBus, drive: Drive, ear: Ear, clock: Clock
) -> None:
    """All frames wait in the kernel when the loop looks: as after a while without the CPU."""
    port = late_port(config, clock)
    async with running(port, ear):
        for number in range(40):
            drive.send_status()
            drive.send_load(Tachometer=0.01 * number)
        clock.now_s += 0.01
        await heard_by(port, 80)
        assert [reading.counter for reading in ear.readings] == [39]
        assert ear.readings[0].output == pytest.approx(0.39)
        assert port.statistics.counter_lost == 0
        await drive.reports(ear)


async def test_a_fault_among_readings_that_piled_up_is_not_forgotten(
    config: CanBus, drive: Drive, ear: Ear, clock: Clock
) -> None:
    async with running(late_port(config, clock), ear):
        for fault in (0, 4, 0, 0):
            drive.send_status(Fault=fault)
            drive.send_load()
        clock.now_s += 0.01
        await ear.hears(1)
        await drive.reports(ear)
    assert [reading.fault for reading in ear.readings] == [4, 0]


async def test_a_fault_behind_a_piled_up_reading_is_kept(
    config: CanBus, drive: Drive, ear: Ear, clock: Clock
) -> None:
    """The drive falls silent after the frame that shows it."""
    port = late_port(config, clock)
    async with running(port, ear):
        drive.send_both()
        drive.send_status(Fault=4)
        clock.now_s += 0.01
        await heard_by(port, 3)
        assert [reading.fault for reading in ear.readings] == [0]
        assert port.complaint == "drive fault: Fault bit 2 Boost overvoltage (word 0x4)"


async def test_what_waits_is_handed_out_when_it_is_asked_for(
    port: CanPort, drive: Drive, ear: Ear
) -> None:
    port.catch_up()
    async with heard(port, drive, ear):
        drive.send_both()
        port.catch_up()  # without a turn of the event loop in between
        assert len(ear.readings) == 2
        port.catch_up()
        assert len(ear.readings) == 2


async def test_scale_and_offset_convert_to_si(
    config: CanBus, drive: Drive, ear: Ear, clock: Clock
) -> None:
    source = SignalSource(signal="DriveLoad.Tachometer", scale=48.7, offset=273.15)
    async with running(build_port(config, clock, output=source), ear):
        drive.send_status()
        drive.send_load(Tachometer=2.0)
        await ear.hears(1)
    assert ear.readings[0].output == pytest.approx(2.0 * 48.7 + 273.15)


async def test_what_the_drive_does_not_send_has_its_default(
    config: CanBus, drive: Drive, ear: Ear
) -> None:
    port = build_port(config, counter=None, fault=None, bridge=None)
    async with heard(port, drive, ear, COMMAND):
        await drive.reports(ear)
    found = [(reading.counter, reading.fault, reading.bridge) for reading in ear.readings]
    assert found == [(None, 0, False), (None, 0, True)]


async def test_a_command_reaches_the_drive(port: CanPort, drive: Drive, ear: Ear) -> None:
    message = reference_database().get_message_by_name("DriveCommand")
    async with running(port, ear):
        for number in range(20):
            assert port.send(COMMAND if number % 2 else SAFE_COMMAND)
            frame = await asyncio.to_thread(drive.bus.recv, 5.0)
            assert frame is not None
            assert (frame.arbitration_id, frame.is_extended_id) == (0x080, False)
            data = bytes(frame.data)
            assert data == with_crc(data)
            heard = message.decode_simple(data, decode_choices=False)
            assert heard["CommandAlive"] == number % 16
            expected = (0.04321, 287.65, 1) if number % 2 else (0.0, 0.0, 0)
            names = ("CurrentScale", "BoostReference", "BridgeEnable")
            assert tuple(heard[name] for name in names) == pytest.approx(expected)
        assert port.statistics.sent == 20
        assert port.statistics.send_drops == 0


async def test_our_own_commands_are_no_strangers(port: CanPort, drive: Drive, ear: Ear) -> None:
    async with running(port, ear):
        port.send(COMMAND)
        await drive.reports(ear)
        assert port.statistics.foreign == 0
        assert port.statistics.received == 2


async def test_a_command_of_another_sender_is_a_complaint(
    config: CanBus, drive: Drive, ear: Ear, clock: Clock
) -> None:
    port = build_port(config, clock)
    async with running(port, ear):
        port.send(COMMAND)
        await drive.reports(ear)
        assert port.complaint is None
        drive.put("DriveCommand", bytes(8))
        await until(lambda: port.complaint is not None)
        assert "1 x frame 0x080 (DriveCommand)" in str(port.complaint)
        assert port.statistics.foreign_commands == 1
        clock.now_s += QUIET_S + 0.1
        assert port.complaint is None


async def test_what_is_not_mapped_is_sent_as_zero(
    config: CanBus, drive: Drive, ear: Ear, clock: Clock
) -> None:
    command = CommandSignals.model_validate(
        {"current_scale_S": "DriveCommand.CurrentScale", "bridge": "DriveCommand.BridgeEnable"}
    )
    port = build_port(config, clock, command=command)
    async with running(port, ear):
        assert port.send(COMMAND)
        frame = await asyncio.to_thread(drive.bus.recv, 5.0)
    assert frame is not None
    message = reference_database().get_message_by_name("DriveCommand")
    assert message.decode_simple(bytes(frame.data))["BoostReference"] == 0.0


def spread_over_messages(config: CanBus, folder: Path) -> CanPort:
    """The port of a drive whose bridge has a message of its own."""
    extra = 'BO_ 129 Switch: 8 Controller\n SG_ On : 0|1@1+ (1,0) [0|1] "" Drive\n\nBO_ 256 Drive'
    bus = rewritten(folder, ("BO_ 256 Drive", extra), bus=config)
    command = CommandSignals.model_validate(
        {"current_scale_S": "DriveCommand.CurrentScale", "bridge": "Switch.On"}
    )
    return build_port(bus, command=command)


async def test_a_command_may_be_spread_over_messages(
    config: CanBus, drive: Drive, ear: Ear, tmp_path: Path
) -> None:
    port = spread_over_messages(config, tmp_path)
    async with running(port, ear):
        assert port.send(COMMAND)
        frames = [await asyncio.to_thread(drive.bus.recv, 5.0) for _ in range(2)]
        assert port.statistics.sent == 2
    assert [frame.arbitration_id for frame in frames if frame] == [0x080, 0x081]


async def test_a_stop_arrives_on_a_bus_that_takes_one_frame_of_each_command(
    config: CanBus, drive: Drive, ear: Ear, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A queue with room for one frame in each half cycle: the others would feed a drive that is on.

    The drive obeys the bridge, and any frame of its commands keeps its own time-out from ending.
    """
    port = spread_over_messages(config, tmp_path)
    async with running(port, ear):
        assert port.send(COMMAND)
        bus = port._connection.bus
        assert bus is not None
        take, room = bus.send, 0

        def take_one(frame: can.Message, timeout: float | None = None) -> None:
            nonlocal room
            if not room:
                raise can.CanOperationError("Transmit buffer full")
            room -= 1
            take(frame, timeout)

        monkeypatch.setattr(bus, "send", take_one)
        for _ in range(3):
            room = 1
            assert not port.send(SAFE_COMMAND)
        frames = [await asyncio.to_thread(drive.bus.recv, 5.0) for _ in range(5)]
    bridges = [frame.data[0] & 1 for frame in frames if frame and frame.arbitration_id == 0x081]
    assert bridges == [1, 0, 0, 0]


@pytest.mark.parametrize(
    "command",
    [
        Command(0.5, 300.0, bridge=True),
        Command(float("nan"), 300.0, bridge=True),
        Command(0.0, float("inf"), bridge=False),
    ],
)
async def test_an_impossible_command_is_not_sent(
    port: CanPort, drive: Drive, ear: Ear, command: Command
) -> None:
    async with running(port, ear):
        with pytest.raises(ValueError, match="is outside"):
            port.send(command)
        assert port.statistics.sent == 0
        assert await asyncio.to_thread(drive.bus.recv, 0.05) is None


async def test_without_a_bus_a_command_is_a_counted_drop(port: CanPort, ear: Ear) -> None:
    assert not port.send(COMMAND)
    async with running(port, ear):
        assert port.send(COMMAND)
    assert not port.send(COMMAND)
    assert (port.statistics.sent, port.statistics.send_drops) == (1, 2)


def refuse_to_send(port: CanPort, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the adapter receive, and send nothing any more."""

    def refuse(*_: object, **__: object) -> None:
        raise can.CanOperationError("Transmit buffer full")

    assert port._connection.bus is not None
    monkeypatch.setattr(port._connection.bus, "send", refuse)


async def answer(port: CanPort, drive: Drive, ear: Ear, command: Command, count: int) -> list[bool]:
    """Command the drive after each of its readings; whether there was a complaint after each."""
    found = []
    for _ in range(count):
        await drive.reports(ear)
        port.send(command)
        found.append(port.complaint is not None)
    return found


@pytest.mark.parametrize("command", [COMMAND, SAFE_COMMAND])
async def test_commands_that_the_bus_does_not_take_are_a_complaint_until_it_takes_one(
    port: CanPort, drive: Drive, ear: Ear, monkeypatch: pytest.MonkeyPatch, command: Command
) -> None:
    async with running(port, ear):
        for _ in range(2):
            with monkeypatch.context() as stuck:
                refuse_to_send(port, stuck)
                assert await answer(port, drive, ear, command, 4) == [False, False, True, True]
                assert (port.complaint or "").startswith(
                    "the bus does not take commands: 4 in a row were refused while the drive's "
                )
            assert await answer(port, drive, ear, command, 1) == [False]


async def test_a_full_queue_of_a_moment_is_no_complaint(
    port: CanPort, drive: Drive, ear: Ear, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with running(port, ear):
        for _ in range(5):
            with monkeypatch.context() as stuck:
                refuse_to_send(port, stuck)
                assert not any(await answer(port, drive, ear, COMMAND, 2))
            assert not any(await answer(port, drive, ear, COMMAND, 1))


async def test_commands_into_a_silent_or_a_lost_bus_are_no_complaint(
    port: CanPort, drive: Drive, ear: Ear, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A drive that is off acknowledges no frame, and its silence is reported by itself."""
    for _ in range(10):
        assert not port.send(SAFE_COMMAND)
    async with running(port, ear):
        await answer(port, drive, ear, SAFE_COMMAND, 1)
        refuse_to_send(port, monkeypatch)
        for _ in range(10):
            assert not port.send(SAFE_COMMAND)
        assert port.complaint is None
        await answer(port, drive, ear, SAFE_COMMAND, 3)
        assert port.complaint is not None
        assert port._connection.bus is not None
        port._connection.bus.shutdown()
        await until(lambda: len(ear.bus) == 2)
        assert port.complaint is None


async def test_a_bus_closed_under_the_reader_is_reported_and_opened_again(
    port: CanPort, drive: Drive, ear: Ear
) -> None:
    async with heard(port, drive, ear):
        assert port._connection.bus is not None
        port._connection.bus.shutdown()
        assert not port.send(COMMAND)
        await until(lambda: len(ear.bus) == 2)
        assert [up for up, _ in ear.bus] == [False, True]
        assert port.description in ear.bus[0][1]
        drive.send_load()
        await heard_by(port, 3)
        assert len(ear.readings) == 1  # what was heard before the loss is not used after it
        await drive.reports(ear)
        assert port.send(COMMAND)
        assert port.statistics.reconnects == 1


async def lose_the_bus(port: CanPort, ear: Ear) -> None:
    """Close the bus under the port, and wait until it is open again."""
    known = len(ear.bus)
    assert port._connection.bus is not None
    port._connection.bus.shutdown()
    await until(lambda: len(ear.bus) == known + 2)


@pytest.mark.parametrize("stopped", [False, True])
async def test_a_drive_that_was_on_when_its_bus_was_lost_is_heard_before_it_is_driven_on(
    port: CanPort, drive: Drive, ear: Ear, *, stopped: bool
) -> None:
    async with heard(port, drive, ear, COMMAND):
        for _ in range(2):
            await lose_the_bus(port, ear)
            assert not port.send(COMMAND)
        await drive.reports(ear, BridgeOn=int(not stopped))
        assert port.send(COMMAND) is not stopped
        assert ("the bus was lost meanwhile" in str(port.complaint)) is stopped
        assert port.send(SAFE_COMMAND)
        assert port.complaint is None


async def repeat_in_turn(port: CanPort, drive: Drive, held: int) -> None:
    """Send the last frames of both messages again and again, as the buffers of a gateway do."""
    heard, last = port.statistics.received, drive.alive
    for back in [*range(held - 1, -1, -1)] * 5:
        drive.alive = {name: (alive - 1 - back) % 16 for name, alive in last.items()}
        drive.send_both()
    await heard_by(port, heard + 2 * 5 * held)
    drive.alive = last


@pytest.mark.parametrize("held", [1, 2, 4])
async def test_last_frames_that_are_repeated_are_none_when_the_bus_is_open_again(
    port: CanPort, drive: Drive, ear: Ear, clock: Clock, held: int
) -> None:
    """The drive may have stopped since: a gateway repeats its bridge, which is on."""
    async with running(port, ear):
        for _ in range(4):
            await drive.reports(ear)
        assert port.send(COMMAND)
        await lose_the_bus(port, ear)
        await repeat_in_turn(port, drive, held)
        assert len(ear.readings) == 4
        assert not port.send(COMMAND)
        clock.now_s += 0.01
        await drive.reports(ear)
        assert port.send(COMMAND)


@pytest.mark.parametrize("held", [2, 4])
async def test_last_frames_that_are_repeated_in_turn_make_no_value_newer(
    port: CanPort, drive: Drive, ear: Ear, clock: Clock, held: int
) -> None:
    async with running(port, ear):
        for _ in range(4):
            await drive.reports(ear)
        clock.now_s += 0.1
        await repeat_in_turn(port, drive, held)
        assert len(ear.readings) == 4
        for _ in range(2):
            await drive.reports(ear)


async def test_a_drive_that_lost_its_bus_before_it_started_is_driven_on(
    port: CanPort, drive: Drive, ear: Ear
) -> None:
    async with heard(port, drive, ear, COMMAND, BridgeOn=0):
        await lose_the_bus(port, ear)
        assert not port.send(COMMAND)
        await drive.reports(ear, BridgeOn=0)
        assert port.complaint is None
        assert port.send(COMMAND)


@pytest.mark.parametrize("losses", [1, 2])
async def test_a_drive_that_came_on_just_before_its_bus_was_lost_is_not_driven_on_when_it_is_off(
    port: CanPort, drive: Drive, ear: Ear, losses: int
) -> None:
    """No reading carries a report that comes between the last clock and the loss."""
    async with heard(port, drive, ear, COMMAND, BridgeOn=0):
        drive.send_status(BridgeOn=1)
        await heard_by(port, 3)
        for _ in range(losses):
            await lose_the_bus(port, ear)
        await drive.reports(ear, BridgeOn=0)
        assert "drive stopped" in str(port.complaint)
        assert not port.send(COMMAND)
        assert port.send(SAFE_COMMAND)
        assert port.complaint is None


@pytest.mark.parametrize("message", ["DriveStatus", "DriveLoad"])
@pytest.mark.parametrize("stopped", [False, True])
async def test_a_drive_whose_alive_counter_leaps_is_heard_before_it_is_driven_on(
    port: CanPort, clock: Clock, drive: Drive, ear: Ear, message: str, *, stopped: bool
) -> None:
    """Of a drive that starts anew the first frame is refused, and shows that its bridge is off."""
    async with heard(port, drive, ear, COMMAND):
        drive.alive[message] = 9
        drive.send_both()
        await heard_by(port, 4)
        assert port.statistics.counter_lost
        assert not port.send(COMMAND)
        assert port.statistics.withheld_commands == 1
        clock.now_s += 1.0 / 120.0
        drive.send_status(BridgeOn=int(not stopped))
        drive.send_load()
        await ear.hears(2 if message == "DriveLoad" else 3)
        assert port.send(COMMAND) is not stopped
        assert (port.statistics.withheld_commands, port.statistics.send_drops) == (1 + stopped, 0)
        assert ("its alive counter leapt meanwhile" in str(port.complaint)) is stopped
        assert port.send(SAFE_COMMAND)
        assert port.complaint is None


@pytest.mark.parametrize("alive", [0, 9])
async def test_a_stop_in_the_frame_whose_alive_counter_stands_or_leaps_is_believed(
    port: CanPort, clock: Clock, drive: Drive, ear: Ear, alive: int
) -> None:
    """A command on its way has switched the drive on again before its next report.

    The counter of a drive that starts anew may by chance stand where it stood.
    """
    async with heard(port, drive, ear, COMMAND):
        clock.now_s += 1.0 / 120.0
        drive.alive["DriveStatus"] = alive
        await drive.reports(ear, BridgeOn=0)
        assert ear.readings[1].bridge_s == ear.readings[0].bridge_s
        clock.now_s += 1.0 / 120.0
        await drive.reports(ear)
        assert [reading.bridge for reading in ear.readings] == [True, False, True]


@pytest.mark.parametrize("alive", [1, 9], ids=["stands", "leaps"])
async def test_an_old_frame_confirms_no_stop(
    port: CanPort, clock: Clock, drive: Drive, ear: Ear, alive: int
) -> None:
    """A gateway repeats one from before the drive came on, which does not obey the safe command."""
    watch = StopWatch(TIMING, port.stop_slack_s)
    async with heard(port, drive, ear, COMMAND):
        assert port.send(SAFE_COMMAND)
        watch.command(clock.now_s)
        clock.now_s += 0.01
        await drive.reports(ear)
        known, drive.alive["DriveStatus"] = drive.alive["DriveStatus"], alive
        await drive.reports(ear, BridgeOn=0)
        assert watch.judge(ear.readings[-1], port.safe_s, clock.now_s) is Stop.AWAITED
        drive.alive["DriveStatus"] = known
        for _ in range(2):  # the first one after a leap is refused
            clock.now_s += 0.01
            drive.send_status(BridgeOn=0)
        drive.send_load()
        await ear.hears(4)
        assert watch.judge(ear.readings[-1], port.safe_s, clock.now_s) is Stop.CONFIRMED


async def test_a_repeated_frame_reports_no_stop(port: CanPort, drive: Drive, ear: Ear) -> None:
    """A gateway repeats the last one from before the drive was switched on."""
    async with running(port, ear):
        off = drive.frame("DriveStatus", **(STATUS | {"BridgeOn": 0}))
        drive.put("DriveStatus", off)
        drive.send_load()
        await ear.hears(1)
        drive.put("DriveStatus", off)
        await drive.reports(ear)
        assert [reading.bridge for reading in ear.readings] == [False, True]


@pytest.mark.parametrize(
    ("message", "cycle_ms", "cycle_s"),
    [(256, 0, math.inf), (257, 0, 1.0 / 120.0), (257, 8, 1.0 / 120.0)],
)
def test_the_cycle_of_the_bridge_is_known_where_the_dbc_or_the_clock_states_it(
    config: CanBus, tmp_path: Path, message: int, cycle_ms: int, cycle_s: float
) -> None:
    """`bus.clock_ticks` states that of the clock."""
    bus = rewritten(tmp_path, (f"BO_ {message} 8;", f"BO_ {message} {cycle_ms};"), bus=config)
    assert build_port(bus, Clock()).bridge_cycle_s == pytest.approx(cycle_s)


@pytest.mark.parametrize("stopped", [False, True])
async def test_a_rare_report_of_the_bridge_is_waited_for_too(
    config: CanBus, drive: Drive, ear: Ear, clock: Clock, tmp_path: Path, *, stopped: bool
) -> None:
    bus = rewritten(tmp_path, ("BO_ 256 8;", "BO_ 256 500;"), bus=config)
    port = build_port(bus, clock, replace(TIMING, voltage_parts=frozenset()))
    async with heard(port, drive, ear, COMMAND):
        drive.alive["DriveStatus"] = 9
        drive.send_both()
        await heard_by(port, 4)
        assert port.statistics.counter_lost
        for count in (3, 4, 5):
            clock.now_s += 0.1
            drive.send_load()
            await ear.hears(count)
            assert not port.send(COMMAND)
        await drive.reports(ear, BridgeOn=int(not stopped))
        assert port.send(COMMAND) is not stopped


@pytest.mark.parametrize("spoil", [None, flipped])
async def test_a_stop_that_the_drive_reports_between_two_readings_is_not_missed(
    port: CanPort, drive: Drive, ear: Ear, spoil: Callable[[Drive, str], bytes] | None
) -> None:
    """Its clock is lost or refused at the stop, and a command might have it on again by then."""
    async with heard(port, drive, ear, COMMAND):
        drive.send_status(BridgeOn=0)
        if spoil is not None:
            drive.put("DriveLoad", spoil(drive, "DriveLoad"))
        await heard_by(port, 3 + (spoil is not None))
        assert not port.send(COMMAND)
        await drive.reports(ear)
        assert (ear.readings[0].bridge, ear.readings[1].bridge) == (True, False)
        assert port.send(COMMAND)
        await drive.reports(ear)
        assert ear.readings[2].bridge


async def test_a_drive_that_came_on_and_stopped_between_two_readings_is_shown_to_have_been_on(
    port: CanPort, drive: Drive, ear: Ear
) -> None:
    """By the newest of its frames alone it is yet to come on, and may be commanded on."""
    async with heard(port, drive, ear, COMMAND, BridgeOn=0):
        drive.send_status(BridgeOn=1)
        await drive.reports(ear, BridgeOn=0)
        assert not port.send(COMMAND)
        await drive.reports(ear, BridgeOn=0)
        assert [reading.bridge for reading in ear.readings] == [False, True, False]
        assert port.send(COMMAND)


@pytest.mark.parametrize("last", [None, replace(COMMAND, bridge=False)])
async def test_a_bridge_that_goes_off_while_it_is_not_commanded_on_is_off(
    port: CanPort, drive: Drive, ear: Ear, last: Command | None
) -> None:
    async with heard(port, drive, ear, BridgeOn=0):
        if last is not None:
            assert port.send(last)
        drive.send_status(BridgeOn=1)
        await drive.reports(ear, BridgeOn=0)
        assert not ear.readings[1].bridge


async def test_a_bridge_that_bounces_between_two_readings_has_not_stopped(
    port: CanPort, drive: Drive, ear: Ear
) -> None:
    async with heard(port, drive, ear, COMMAND, BridgeOn=0):
        for bridge in (1, 0, 1):
            drive.send_status(BridgeOn=bridge)
        for count in (2, 3):
            drive.send_load()
            await ear.hears(count)
            assert port.send(COMMAND)
        assert [reading.bridge for reading in ear.readings] == [False, True, True]


@pytest.mark.parametrize("last", [SAFE_COMMAND, replace(COMMAND, bridge=False)])
async def test_a_drive_that_was_off_when_its_bus_was_lost_may_be_off_after_it(
    port: CanPort, drive: Drive, ear: Ear, last: Command
) -> None:
    async with heard(port, drive, ear, COMMAND):
        assert port.send(last)
        await lose_the_bus(port, ear)
        assert port.send(COMMAND)
        await drive.reports(ear, BridgeOn=0)
        assert port.complaint is None


async def test_a_controller_that_goes_bus_off_is_reported_and_opened_again(
    port: CanPort, drive: Drive, ear: Ear
) -> None:
    async with heard(port, drive, ear):
        drive.bus.send(can.Message(arbitration_id=0x40, is_error_frame=True, dlc=8, data=bytes(8)))
        await until(lambda: len(ear.bus) == 2)
        assert [up for up, _ in ear.bus] == [False, True]
        assert "bus-off" in ear.bus[0][1]
        await drive.reports(ear)


async def lose_by_errors(drive: Drive, ear: Ear) -> None:
    """Let a controller warn and leave the bus; return when the bus is open again."""
    known = len(ear.bus)
    for error in (0x04, 0x40):
        frame = can.Message(arbitration_id=error, is_error_frame=True, dlc=8, data=bytes(8))
        drive.bus.send(frame)
    await until(lambda: len(ear.bus) == known + 2)


async def test_a_bus_that_carries_errors_alone_is_opened_again_ever_later(
    port: CanPort, drive: Drive, ear: Ear, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A shorted bus whose controller restarts by itself: each time, warnings precede bus-off."""
    delays_s = noted_delays("adaptdrive.hardware.link.connection", monkeypatch)
    async with heard(port, drive, ear):
        for _ in range(3):
            await lose_by_errors(drive, ear)
    assert delays_s == [0.1, 0.2, 0.4]


async def test_a_bus_that_stays_away_is_reported_once(
    port: CanPort, ear: Ear, monkeypatch: pytest.MonkeyPatch
) -> None:
    attempts = 0

    def refuse(*_: object) -> can.BusABC:
        nonlocal attempts
        attempts += 1
        raise BusError("bench", "unplugged")

    async with running(port, ear):
        monkeypatch.setattr("adaptdrive.hardware.link.connection.open_bus", refuse)
        assert port._connection.bus is not None
        port._connection.bus.shutdown()
        await until(lambda: attempts >= 3)
        assert [up for up, _ in ear.bus] == [False]
        monkeypatch.undo()
        await until(lambda: len(ear.bus) == 2)
        assert ear.bus[1][0]


async def test_a_first_failure_is_raised(ear: Ear) -> None:
    port = build_port(motor_bus(interface="socketcan", channel="nosuchcan0"))
    with pytest.raises(BusError, match="socketcan nosuchcan0"):
        await port.run(ear, lambda: None)
    assert ear.bus == []


async def test_a_flood_of_strangers_does_not_hide_the_drive(
    port: CanPort, drive: Drive, ear: Ear, config: CanBus
) -> None:
    async with running(port, ear):
        for number in range(50):
            for id_offset in range(40):
                stranger = can.Message(
                    arbitration_id=0x200 + id_offset, is_extended_id=False, data=bytes(8)
                )
                drive.bus.send(stranger)
            drive.send_both()
            await heard_by(port, (number + 1) * 42)
        assert len(ear.readings) == 50
        assert port.statistics.foreign == 2000


@pytest.mark.parametrize(
    "changes",
    [{"is_extended_id": True}, {"is_remote_frame": True}, {"is_error_frame": True}],
)
async def test_other_kinds_of_frame_with_a_known_id_are_strangers(
    port: CanPort, drive: Drive, ear: Ear, config: CanBus, changes: dict[str, bool]
) -> None:
    async with running(port, ear):
        drive.send_both()
        data = b"" if "is_remote_frame" in changes else drive.frame("DriveLoad")
        kind = {"is_extended_id": False} | changes
        drive.bus.send(can.Message(arbitration_id=0x101, data=data, **kind))
        await heard_by(port, 3)
        assert port.statistics.foreign == 1
        assert len(ear.readings) == 1


async def test_an_error_of_the_listener_ends_the_port(
    port: CanPort, drive: Drive, ear: Ear, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(reading: Reading) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(ear, "on_reading", fail)
    with pytest.raises(ZeroDivisionError):
        await port.run(ear, drive.send_both)
    assert not port.send(COMMAND)


async def test_an_error_while_opening_leaves_no_bus_open(port: CanPort, ear: Ear) -> None:
    def fail() -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        await port.run(ear, fail)
    assert not port.send(COMMAND)


async def test_the_oldest_value_is_named_with_its_cause(
    config: CanBus, drive: Drive, ear: Ear, clock: Clock
) -> None:
    port = build_port(config, clock)
    async with running(port, ear):
        assert "(0x100 (DriveStatus), " in port.explain_age()
        assert "has never come: no message comes" in port.explain_age()
        await drive.reports(ear)
        clock.now_s += 0.1
        drive.send_load()
        await ear.hears(2)
        status = port.explain_age()
        assert "(0x100 (DriveStatus), " in status
        assert "is the oldest value, 100 ms old: other messages come, and this one has" in status
        assert " come before" in status
        assert "as often as interlocks.stale_s needs?" in status
        drive.put("DriveStatus", bytes(8))
        await until(lambda: port.statistics.wrong_checksum == 1)
        refused = "its frames come and are refused (wrong_checksum, 1 in a row)"
        assert refused in port.explain_age()
        assert any("wrong_checksum 1 x, last [00 00" in line for line in port.details())
        clock.now_s += 0.1
        await drive.reports(ear)
        clock.now_s += 0.1
        assert "no message comes" in port.explain_age()


async def test_the_oldest_value_is_named_with_its_own_age(
    config: CanBus, drive: Drive, ear: Ear, clock: Clock
) -> None:
    """The last reading is as old as a value that has come again since."""
    port, limits = build_port(config, clock), Limits(430.0, 5.0, "V")
    async with running(port, ear):
        drive.send_status()
        await heard_by(port, 1)
        clock.now_s += 0.010
        drive.send_load()
        await ear.hears(1)
        clock.now_s += 0.020
        drive.send_status()
        await heard_by(port, 3)
        clock.now_s += 0.025
        cause = find_cause(ear.readings[-1], clock.now_s, limits, 0.05, port.explain_age)
    assert cause is not None
    assert "measurement is 55 ms old, limit 50 ms; output (0x101 (DriveLoad), Tach" in cause
    assert ") is the oldest value, 45 ms old: " in cause


async def test_without_its_bus_the_values_are_old_for_that(config: CanBus, clock: Clock) -> None:
    assert build_port(config, clock).explain_age().endswith("the bus is lost")


async def test_a_fault_is_kept_when_the_clocking_frame_is_lost(
    config: CanBus, drive: Drive, ear: Ear, clock: Clock
) -> None:
    """One frame shows it; the next frames say that all is well again."""
    port = build_port(config, clock)
    async with heard(port, drive, ear):
        for lost in range(10):
            drive.send_status(Fault=1 << (lost % 7))
            await until(lambda: port.complaint is not None)
            assert f"word {1 << (lost % 7):#x}" in str(port.complaint)
            drive.send_status(Fault=0)
            drive.send_load()
            await ear.hears(lost + 2)
            assert ear.readings[-1].fault == 1 << (lost % 7)
            assert port.complaint is None
        await drive.reports(ear)
        assert ear.readings[-1].fault == 0


def with_fault_codes(config: CanBus, folder: Path) -> CanBus:
    """The bus of a drive whose fault word holds one code, as its value table says."""
    code = '2 "Overtemperature" 3 "Earth fault"'
    return rewritten(folder, ('2 "Overtemperature"', code), bus=config)


async def test_of_two_fault_codes_between_two_readings_the_first_is_told(
    config: CanBus, drive: Drive, ear: Ear, clock: Clock, tmp_path: Path
) -> None:
    """Added up they would name a fault that never was."""
    port = build_port(with_fault_codes(config, tmp_path), clock)
    async with heard(port, drive, ear):
        drive.send_status(Fault=1)
        drive.send_status(Fault=2)
        await heard_by(port, 4)
        assert port.complaint == "drive fault: Fault Overcurrent (word 0x1)"
        for count in (2, 3):
            drive.send_load()
            await ear.hears(count)
            drive.send_status(Fault=6)
            await heard_by(port, 2 * count + 2)
        assert port.complaint == "drive fault: Fault 0x6 (word 0x6)"
    faults = [(reading.fault, reading.fault_name) for reading in ear.readings]
    assert faults == [(0, ""), (1, "Fault Overcurrent"), (6, "Fault 0x6")]


async def test_the_words_beside_a_value_that_is_not_available_are_used(
    port: CanPort, drive: Drive, ear: Ear, clock: Clock
) -> None:
    async with heard(port, drive, ear):
        clock.now_s += 0.01
        spoilt = drive.frame("DriveStatus", **{**STATUS, "Fault": 2, "BridgeOn": 0})
        drive.put("DriveStatus", with_crc(b"\xff\xff" + spoilt[2:]))
        await until(lambda: "word 0x2" in str(port.complaint))
        drive.send_load()
        await ear.hears(2)
    good, reading = ear.readings
    assert (reading.fault, reading.bridge, reading.bridge_s) == (2, False, clock.now_s)
    assert reading.boost_voltage_V == good.boost_voltage_V
    assert reading.line_voltage_V == good.line_voltage_V
    assert reading.oldest_s == good.oldest_s
    assert port.statistics.out_of_range == 1


async def test_a_clock_message_without_values_makes_a_reading_of_older_ones(
    port: CanPort, drive: Drive, ear: Ear, clock: Clock
) -> None:
    """It shows the bridge, and no value becomes newer by it."""
    async with heard(port, drive, ear, COMMAND):
        clock.now_s += 0.01
        drive.send_status(BridgeOn=0)
        drive.put("DriveLoad", unavailable(drive, "DriveLoad"))
        await ear.hears(2)
        await drive.reports(ear)
    good, reading, next_one = ear.readings
    assert (reading.bridge, reading.bridge_s) == (False, clock.now_s)
    assert (reading.output, reading.oldest_s) == (good.output, good.oldest_s)
    assert (reading.whole, next_one.whole, next_one.oldest_s) == (False, True, clock.now_s)
    assert port.statistics.out_of_range == 1


@pytest.mark.parametrize("bridge_on", [0, 1])
async def test_a_drive_without_values_confirms_its_stop_after_its_bus_was_lost(
    port: CanPort, drive: Drive, ear: Ear, clock: Clock, bridge_on: int
) -> None:
    async with heard(port, drive, ear, COMMAND):
        await lose_the_bus(port, ear)
        clock.now_s += 0.01
        drive.put("DriveLoad", unavailable(drive, "DriveLoad"))
        await heard_by(port, 3)
        assert len(ear.readings) == 1  # nothing is known of its bridge
        port.send(SAFE_COMMAND)
        drive.send_status(BridgeOn=bridge_on)
        drive.put("DriveLoad", unavailable(drive, "DriveLoad"))
        await ear.hears(2)
    good, reading = ear.readings
    assert (reading.bridge, reading.bridge_s) == (bool(bridge_on), clock.now_s)
    assert (reading.output, reading.oldest_s) == (good.output, good.oldest_s)


def seldom_reported(config: CanBus, folder: Path, clock: Clock, changes: Changes) -> CanPort:
    """The port of a file in which a stop, or the report of the bridge, may take long."""
    stop_s, cycle_ms = changes
    parts = {
        "bus": rewritten(folder, ("BO_ 256 8;", f"BO_ 256 {cycle_ms};"), bus=config),
        "interlocks": MOTOR.interlocks.model_copy(update={"stop_s": stop_s}),
        "voltage_loop": MOTOR.voltage_loop.model_copy(update={"where": "drive"}),
    }
    port = build_configured(MOTOR.model_copy(update=parts), clock, "motor.toml")
    assert isinstance(port, CanPort)
    return port


async def safe_commands(
    port: CanPort, drive: Drive, ear: Ear, clock: Clock, moments_s: Sequence[float]
) -> list[bool]:
    """Whether each safe command was sent to a drive that stays on, by the time since the first."""
    await drive.reports(ear)
    port.send(COMMAND)
    stopped_s, sent = clock.now_s, []
    for moment_s in moments_s:
        clock.now_s = stopped_s + moment_s
        sent.append(port.send(SAFE_COMMAND))
    return sent


@pytest.mark.parametrize("changes", [(3.0, 8), (0.5, 2000)])
async def test_a_drive_whose_stop_may_take_long_hears_the_safe_command_meanwhile(
    config: CanBus, drive: Drive, clock: Clock, tmp_path: Path, changes: Changes
) -> None:
    """Its own time-out would end a stop as a fault; so it would where the report comes seldom."""
    port, ear = seldom_reported(config, tmp_path, clock, changes), Ear()
    async with running(port, ear):
        sent = await safe_commands(port, drive, ear, clock, (0.0, 1.1, 1.9, 2.4, 3.1, 4.1))
    assert sent == [True, True, True, True, False, True]


async def test_a_drive_that_does_not_obey_the_safe_command_hears_nothing_every_other_second(
    port: CanPort, drive: Drive, ear: Ear, clock: Clock
) -> None:
    """Silence lets its own time-out switch it off; what it may have missed is said again."""
    async with running(port, ear):
        sent = await safe_commands(port, drive, ear, clock, (0.0, 0.9, 1.1, 1.9, 2.1, 2.9, 3.1))
        assert sent == [True, True, False, False, True, True, False]
        assert port.send(COMMAND)
        assert port.send(SAFE_COMMAND)
        clock.now_s += 1.5
        drive.send_status(BridgeOn=0)
        await heard_by(port, 3)
        assert port.send(SAFE_COMMAND)
