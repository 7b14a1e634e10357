"""The port of a drive on CAN: what of its DBC, its counters and its bus the contract cannot ask."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import can
import pytest

from adaptdrive.config.bus import CanBus, CommandSignals
from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.devices.can import port as can_port
from adaptdrive.devices.can.bus import open_bus
from adaptdrive.devices.can.mapping import map_drive
from adaptdrive.safety.facts import Reading
from adaptdrive.safety.interlocks import Limits, find_cause
from adaptdrive.safety.monitor import QUIET_S, Verdict
from adaptdrive.safety.stop import Stop, StopWatch
from adaptdrive.safety.trips import TripKind
from adaptdrive.util.errors import BusError
from adaptdrive.util.quantity import Display
from tests.support import text_of
from tests.unit.devices.bench import (
    STATUS,
    TIMING,
    Clock,
    Drive,
    Ear,
    build_port,
    memory_bus,
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
TICK_S = 1.0 / 120.0
LIMITS = Limits(430.0, 5.0, Display("V"))


class Bench:
    """A port, its drive, an ear, and a clock that the test moves."""

    port: can_port.Port

    def __init__(self, config: CanBus, folder: Path) -> None:
        self.config, self.folder = config, folder
        self.clock, self.ear = Clock(), Ear()
        self.drive = Drive(open_bus(config))
        self.build()

    def build(self, *changes: tuple[str, str], **signals: object) -> None:
        """Make the port of other signals, or of a DBC in which some words are others."""
        config = rewritten(self.folder, *changes, bus=self.config) if changes else self.config
        self.port = build_port(config, self.clock, TIMING, **signals)

    def build_late(self) -> None:
        """Make a port whose frames count as having waited since their queue was last empty."""
        mapping = map_drive(self.config, motor_signals(), TIMING)
        self.port = can_port.Port(self.config, mapping, self.clock, lambda: 4e9)

    def running(self) -> contextlib.AbstractAsyncContextManager[None]:
        """Run the port until the block ends."""
        return running(self.port, self.ear)

    @contextlib.asynccontextmanager
    async def heard(self, *commands: Command, **status: float) -> AsyncIterator[None]:
        """Run it from a report of its drive, and the commands after it, on."""
        async with self.running():
            await self.reports(**status)
            for command in commands:
                assert self.port.send(command)
            yield

    @contextlib.asynccontextmanager
    async def come_on(self) -> AsyncIterator[None]:
        """Run it with a drive that has come on by command, and had its time to switch."""
        async with self.heard(COMMAND, BridgeOn=0):
            for _ in range(2):
                self.port.monitor.look(self.clock.now_s, 0.0, self.clock.now_s, due=True)
                self.clock.now_s += 0.5
                await self.reports()
            yield

    async def reports(self, **status: float) -> None:
        """Send what a drive sends each half cycle, and wait for the reading of it."""
        await self.drive.reports(self.ear, **status)

    async def received(self, count: int) -> None:
        """Wait until the port has had so many frames."""
        await until(lambda: self.port.statistics.received >= count)

    async def loses_its_bus(self) -> None:
        """Close the bus under the port, and wait until it is open again."""
        known = len(self.ear.bus)
        assert self.port._connection.bus is not None
        self.port._connection.bus.shutdown()
        await until(lambda: len(self.ear.bus) == known + 2)

    async def commanded(self, count: int) -> list[can.Message]:
        """The frames that the drive has heard."""
        heard: list[can.Message] = []

        def hear() -> bool:
            heard.extend(iter(lambda: self.drive.bus.recv(0), None))
            return len(heard) >= count

        await until(hear)
        return heard

    async def answers(self, command: Command, count: int) -> list[bool]:
        """Command the drive after each of its readings; whether it gave a cause to trip then."""
        found = []
        for _ in range(count):
            await self.reports()
            self.port.send(command)
            found.append(self.port.trip_cause is not None)
        return found

    def bridges(self) -> list[bool]:
        """What the readings say of the bridge."""
        return [reading.bridge for reading in self.ear.readings]


@pytest.fixture
async def bench(tmp_path: Path) -> AsyncIterator[Bench]:
    bench = Bench(memory_bus(), tmp_path)
    yield bench
    bench.drive.bus.shutdown()


async def test_a_reading_holds_what_the_drive_sent(bench: Bench) -> None:
    async with bench.running():
        bench.drive.half_cycle = 65535
        await bench.reports()
    (reading,) = bench.ear.readings
    assert reading.boost_voltage_V == pytest.approx(300.12)
    assert reading.line_voltage_V == pytest.approx(120.4)
    assert reading.load_power_W == pytest.approx(431.7)
    assert reading.output == pytest.approx(3.123456)
    assert (reading.counter, reading.fault, reading.bridge, reading.whole) == (65535, 0, True, True)


async def test_the_clock_message_alone_makes_readings_as_old_as_their_oldest_value(
    bench: Bench,
) -> None:
    async with bench.running():
        bench.drive.send_load()
        bench.drive.send_load()
        bench.drive.send_status()
        await bench.received(3)
        assert bench.ear.readings == []  # first without a status, then without a tick
        for count in (1, 2, 3):
            bench.drive.send_load()
            await bench.ear.hears(count)
            bench.clock.now_s += 0.25
        bench.drive.send_status()
        await bench.received(7)
    ages = [reading.arrival_s - reading.oldest_s for reading in bench.ear.readings]
    assert ages == [0.0, 0.25, 0.5]


async def test_a_rare_clock_may_lose_a_frame_and_is_named_once_it_is_gone(bench: Bench) -> None:
    """It comes every 100 ms, and the other message every half cycle."""
    bus = rewritten(bench.folder, ("BO_ 257 8;", "BO_ 257 100;"), bus=bench.config)
    timing = replace(TIMING, stale_s=0.15, voltage_parts=frozenset())
    port = build_port(bus.model_copy(update={"clock_ticks": 12}), bench.clock, timing)
    bench.port = port
    causes: list[str | None] = []
    async with bench.heard():
        for count in range(2, 33):  # one frame of the clock is lost, then all of them
            bench.clock.now_s += 0.01
            bench.drive.send_status()
            await bench.received(count + 1)
            now_s, reading = bench.clock.now_s, bench.ear.readings[-1]
            cause = find_cause(reading, now_s, LIMITS, 0.15, port.explain_age)
            causes.append(text_of(cause))
    assert causes[:29] == [None] * 29
    assert causes[30] is not None
    assert "limit 300 ms; output (0x101 (DriveLoad), Tachometer) is the oldest" in causes[30]
    assert port.monitor.slack_s == pytest.approx(0.15)  # the report of the bridge waits for it too
    assert port.monitor.cycle_s == pytest.approx(0.1)


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
async def test_a_frame_that_fails_a_check_changes_nothing_and_is_counted(
    bench: Bench, name: str, spoil: Callable[[Drive, str], bytes], counts: dict[str, int]
) -> None:
    async with bench.heard():
        bench.clock.now_s += 1.0
        bench.drive.put(name, spoil(bench.drive, name))
        await bench.received(3)
        assert len(bench.ear.readings) == 1
        expected = dict.fromkeys(asdict(bench.port.statistics), 0) | {"received": 3} | counts
        assert asdict(bench.port.statistics) == expected
        if name == "DriveStatus":
            bench.drive.send_load(Tachometer=1.0)
            await bench.ear.hears(2)
            good, reading = bench.ear.readings
            assert reading.boost_voltage_V == good.boost_voltage_V
            assert reading.oldest_s == good.oldest_s
        await bench.reports()
        assert bench.ear.readings[-1].oldest_s == 1001.0


async def test_of_readings_that_piled_up_only_the_newest_is_handed_out(bench: Bench) -> None:
    """All frames wait in the kernel when the loop looks: as after a while without the CPU."""
    bench.build_late()
    async with bench.running():
        for number in range(40):
            bench.drive.send_status(Fault=4 * (number == 7))
            bench.drive.send_load(Tachometer=0.01 * number)
        bench.clock.now_s += 0.01
        await bench.received(80)
        (reading,) = bench.ear.readings
        assert (reading.counter, reading.fault) == (39, 4)  # the fault is that of another one
        assert reading.output == pytest.approx(0.39)
        await bench.reports()
        assert bench.ear.readings[-1].fault == 0
        assert bench.port.statistics.counter_lost == 0


async def test_a_fault_behind_a_piled_up_reading_is_kept(bench: Bench) -> None:
    """The drive falls silent after the frame that shows it."""
    bench.build_late()
    async with bench.running():
        bench.drive.send_both()
        bench.drive.send_status(Fault=4)
        bench.clock.now_s += 0.01
        await bench.received(3)
        assert [reading.fault for reading in bench.ear.readings] == [0]
        expected = "drive fault: Fault bit 2 Boost overvoltage (word 0x4)"
        assert str(bench.port.trip_cause) == expected


async def test_what_waits_is_handed_out_when_it_is_asked_for(bench: Bench) -> None:
    bench.port.catch_up()
    async with bench.heard():
        bench.drive.send_both()
        for _ in range(2):
            bench.port.catch_up()  # without a turn of the event loop in between
            assert len(bench.ear.readings) == 2


async def test_what_the_drive_does_not_send_has_its_default(bench: Bench) -> None:
    bench.build(counter=None, fault=None, bridge=None)
    async with bench.heard(COMMAND):
        await bench.reports()
    found = [(one.counter, one.fault, one.bridge) for one in bench.ear.readings]
    assert found == [(None, 0, False), (None, 0, True)]


async def test_a_command_is_what_cantools_reads_and_no_stranger_to_its_port(bench: Bench) -> None:
    message = reference_database().get_message_by_name("DriveCommand")
    async with bench.heard(COMMAND):
        (frame,) = await bench.commanded(1)
        await bench.reports()
    assert (frame.arbitration_id, frame.is_extended_id) == (0x080, False)
    assert with_crc(bytes(frame.data)) == bytes(frame.data)
    told = message.decode_simple(bytes(frame.data), decode_choices=False)
    names = ("CurrentScale", "BoostReference", "BridgeEnable", "CommandAlive")
    assert [told[name] for name in names] == pytest.approx([0.04321, 287.65, 1, 0])
    counts = bench.port.statistics
    assert (counts.sent, counts.received, counts.foreign) == (1, 4, 0)


async def test_a_reset_is_given_for_a_moment_and_to_a_drive_that_is_off(bench: Bench) -> None:
    bit = ' SG_ Reset : 33|1@1+ (1,0) [0|1] "" Drive\n SG_ CommandAlive'
    words = {"current_scale_S": "DriveCommand.CurrentScale", "bridge": "DriveCommand.BridgeEnable"}
    given = CommandSignals.model_validate({**words, "reset": "DriveCommand.Reset"})
    bench.build((" SG_ CommandAlive", bit), command=given)
    async with bench.heard(SAFE_COMMAND):
        reset = asyncio.create_task(bench.port.reset_fault())
        await asyncio.sleep(0)
        for command in (SAFE_COMMAND, COMMAND, SAFE_COMMAND):
            assert bench.port.send(command)
        await reset
        assert bench.port.send(SAFE_COMMAND)
        frames = await bench.commanded(5)
    assert [frame.data[4] >> 1 & 1 for frame in frames] == [0, 1, 0, 1, 0]


async def test_a_command_of_another_sender_is_a_complaint(bench: Bench) -> None:
    async with bench.heard(COMMAND):
        assert bench.port.trip_cause is None
        bench.drive.put("DriveCommand", bytes(8))
        await until(lambda: bench.port.trip_cause is not None)
        assert "1 x frame 0x080 (DriveCommand)" in str(bench.port.trip_cause)
        assert bench.port.statistics.foreign_commands == 1
        bench.clock.now_s += QUIET_S - 0.1
        assert bench.port.trip_cause is not None
        bench.clock.now_s += 0.2
        assert bench.port.trip_cause is None


def spread_over_messages(bench: Bench) -> None:
    """Let the bridge of the drive have a message of its own, and nothing set its voltage."""
    extra = 'BO_ 129 Switch: 8 Controller\n SG_ On : 0|1@1+ (1,0) [0|1] "" Drive\n\nBO_ 256 Drive'
    words = {"current_scale_S": "DriveCommand.CurrentScale", "bridge": "Switch.On"}
    bench.build(("BO_ 256 Drive", extra), command=CommandSignals.model_validate(words))


async def test_a_command_may_be_spread_over_messages_and_is_zero_where_nothing_is_mapped(
    bench: Bench,
) -> None:
    spread_over_messages(bench)
    assert not bench.port.send(COMMAND)  # there is no bus yet, and it keeps no later one back
    async with bench.running():
        assert bench.port.send(COMMAND)
        frames = await bench.commanded(2)
        assert bench.port.statistics.sent == 2
    assert [frame.arbitration_id for frame in frames] == [0x080, 0x081]
    message = reference_database().get_message_by_name("DriveCommand")
    assert message.decode_simple(bytes(frames[0].data))["BoostReference"] == 0.0


async def test_a_stop_arrives_on_a_bus_that_takes_one_frame_of_each_command(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A queue with room for one frame in each half cycle: the others would feed a drive that is on.

    The drive obeys the bridge, and any frame of its commands keeps its own time-out from ending.
    """
    spread_over_messages(bench)
    async with bench.running():
        assert bench.port.send(COMMAND)
        bus = bench.port._connection.bus
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
            assert not bench.port.send(SAFE_COMMAND)
        frames = await bench.commanded(5)
    assert [frame.data[0] & 1 for frame in frames if frame.arbitration_id == 0x081] == [1, 0, 0, 0]


def refuse_to_send(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the adapter receive, and send nothing any more."""

    def refuse(*_: object, **__: object) -> None:
        raise can.CanOperationError("Transmit buffer full")

    monkeypatch.setattr(bench.port._connection.bus, "send", refuse)


@pytest.mark.parametrize("command", [COMMAND, SAFE_COMMAND])
async def test_commands_that_the_bus_does_not_take_are_a_complaint_until_it_takes_one(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, command: Command
) -> None:
    """A full queue of a moment is none."""
    async with bench.running():
        for refused in (2, 4, 2, 4):
            with monkeypatch.context() as stuck:
                refuse_to_send(bench, stuck)
                complaints = await bench.answers(command, refused)
            assert complaints == [False, False, True, True][:refused]
            if refused == 4:
                text = "the bus does not take commands: 4 in a row were refused while the drive's "
                assert str(bench.port.trip_cause).startswith(text)
            assert await bench.answers(command, 1) == [False]


async def test_commands_into_a_silent_or_a_lost_bus_are_no_complaint(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A drive that is off acknowledges no frame, and its silence is reported by itself."""
    port = bench.port
    assert not any(port.send(SAFE_COMMAND) for _ in range(10))
    async with bench.running():
        await bench.answers(SAFE_COMMAND, 1)
        assert (port.statistics.sent, port.statistics.send_drops) == (1, 10)
        refuse_to_send(bench, monkeypatch)
        assert not any(port.send(SAFE_COMMAND) for _ in range(10))
        assert port.trip_cause is None
        await bench.answers(SAFE_COMMAND, 3)
        assert port.trip_cause is not None
        await bench.loses_its_bus()
        assert port.trip_cause is None


@pytest.mark.parametrize("stopped", [False, True])
async def test_a_drive_that_was_on_when_its_bus_was_lost_is_heard_before_it_is_driven_on(
    bench: Bench, *, stopped: bool
) -> None:
    port = bench.port
    async with bench.come_on():
        for _ in range(2):
            await bench.loses_its_bus()
            assert not port.send(COMMAND)
        bench.clock.now_s += TICK_S
        await bench.reports(BridgeOn=int(not stopped))
        assert port.send(COMMAND) is not stopped
        assert ("the bus was lost meanwhile" in str(port.monitor.stop)) is stopped
        assert port.send(SAFE_COMMAND)
        assert port.monitor.stop is None


async def repeat_in_turn(bench: Bench, held: int) -> None:
    """Send the last frames of both messages again and again, as the buffers of a gateway do."""
    drive, heard = bench.drive, bench.port.statistics.received
    last = drive.alive
    for back in [*range(held - 1, -1, -1)] * 5:
        drive.alive = {name: (alive - 1 - back) % 16 for name, alive in last.items()}
        drive.send_both()
    await bench.received(heard + 2 * 5 * held)
    drive.alive = last


@pytest.mark.parametrize("held", [1, 2, 4])
@pytest.mark.parametrize("lost", [False, True], ids=["at once", "after a loss"])
async def test_last_frames_that_are_repeated_are_none(
    bench: Bench, held: int, *, lost: bool
) -> None:
    """The drive may have stopped since: a gateway repeats its bridge, which is on."""
    async with bench.running():
        for _ in range(4):
            await bench.reports()
        assert bench.port.send(COMMAND)
        if lost:
            await bench.loses_its_bus()
        bench.clock.now_s += 0.1
        await repeat_in_turn(bench, held)
        assert len(bench.ear.readings) == 4
        assert not bench.port.send(COMMAND)
        bench.clock.now_s += 0.01
        await bench.reports()
        await bench.reports()
        assert bench.port.send(COMMAND)


@pytest.mark.parametrize("losses", [0, 1, 2])
async def test_a_drive_that_came_on_just_before_its_bus_was_lost_is_not_driven_on_when_it_is_off(
    bench: Bench, losses: int
) -> None:
    """No reading carries a report that comes between the last clock and the loss.

    One that has not come on yet is driven on.
    """
    port = bench.port
    async with bench.heard(COMMAND, BridgeOn=0):
        if losses:
            bench.drive.send_status(BridgeOn=1)
            await bench.received(3)
        for _ in range(max(losses, 1)):
            await bench.loses_its_bus()
        assert not port.send(COMMAND)
        bench.clock.now_s += TICK_S
        await bench.reports(BridgeOn=0)
        assert ("drive stopped" in str(port.monitor.stop)) is (losses > 0)
        assert port.send(COMMAND) is (losses == 0)
        assert port.send(SAFE_COMMAND)
        assert port.monitor.stop is None


@pytest.mark.parametrize("message", ["DriveStatus", "DriveLoad"])
@pytest.mark.parametrize("stopped", [False, True])
async def test_a_drive_whose_alive_counter_leaps_is_heard_before_it_is_driven_on(
    bench: Bench, message: str, *, stopped: bool
) -> None:
    """Of a drive that starts anew the first frame is refused, and shows that its bridge is off."""
    port, drive = bench.port, bench.drive
    async with bench.heard(COMMAND):
        drive.alive[message] = 9
        drive.send_both()
        await bench.received(4)
        assert port.statistics.counter_lost
        assert not port.send(COMMAND)
        assert port.statistics.withheld_commands == 1
        bench.clock.now_s += TICK_S
        drive.send_status(BridgeOn=int(not stopped))
        drive.send_load()
        await bench.ear.hears(2 if message == "DriveLoad" else 3)
        assert port.send(COMMAND) is not stopped
        assert (port.statistics.withheld_commands, port.statistics.send_drops) == (1 + stopped, 0)
        assert ("its alive counter leapt meanwhile" in str(port.monitor.stop)) is stopped
        assert port.send(SAFE_COMMAND)
        assert port.monitor.stop is None


@pytest.mark.parametrize("alive", [0, 9])
async def test_a_stop_in_the_frame_whose_alive_counter_stands_or_leaps_is_believed(
    bench: Bench, alive: int
) -> None:
    """A command on its way has switched the drive on again before its next report.

    The counter of a drive that starts anew may by chance stand where it stood.
    """
    async with bench.come_on():
        bench.drive.alive["DriveStatus"] = alive
        await bench.reports(BridgeOn=0)
        assert bench.ear.readings[-1].bridge_s == bench.ear.readings[-2].bridge_s
        await bench.reports()
        assert bench.port.monitor.verdict is Verdict.STOPPED


@pytest.mark.parametrize("alive", [1, 9], ids=["stands", "leaps"])
async def test_an_old_frame_confirms_no_stop(bench: Bench, alive: int) -> None:
    """A gateway repeats one from before the drive came on, which does not obey the safe command."""
    port, drive, watch = bench.port, bench.drive, StopWatch(TIMING, bench.port.monitor.slack_s)

    def verdict() -> Stop:
        return watch.judge(bench.ear.readings[-1], port.monitor.safe_s, bench.clock.now_s)

    async with bench.heard(COMMAND):
        assert port.send(SAFE_COMMAND)
        watch.command(bench.clock.now_s)
        bench.clock.now_s += 0.01
        await bench.reports()
        known, drive.alive["DriveStatus"] = drive.alive["DriveStatus"], alive
        await bench.reports(BridgeOn=0)
        assert verdict() is Stop.AWAITED
        drive.alive["DriveStatus"] = known
        for _ in range(2):  # the first one after a leap is refused
            bench.clock.now_s += 0.01
            drive.send_status(BridgeOn=0)
        drive.send_load()
        await bench.ear.hears(4)
        assert verdict() is Stop.CONFIRMED


@pytest.mark.parametrize(
    ("message", "cycle_ms", "cycle_s"), [(256, 0, math.inf), (257, 0, TICK_S), (257, 8, TICK_S)]
)
def test_the_cycle_of_the_bridge_is_known_where_the_dbc_or_the_clock_states_it(
    bench: Bench, message: int, cycle_ms: int, cycle_s: float
) -> None:
    """`bus.clock_ticks` states that of the clock."""
    bench.build((f"BO_ {message} 8;", f"BO_ {message} {cycle_ms};"))
    assert bench.port.monitor.cycle_s == pytest.approx(cycle_s)


@pytest.mark.parametrize("stopped", [False, True])
async def test_a_rare_report_of_the_bridge_is_waited_for_too(
    bench: Bench, *, stopped: bool
) -> None:
    bus = rewritten(bench.folder, ("BO_ 256 8;", "BO_ 256 500;"), bus=bench.config)
    bench.port = build_port(bus, bench.clock, replace(TIMING, voltage_parts=frozenset()))
    async with bench.heard(COMMAND):
        bench.drive.alive["DriveStatus"] = 9
        bench.drive.send_both()
        await bench.received(4)
        assert bench.port.statistics.counter_lost
        for count in (3, 4, 5):
            bench.clock.now_s += 0.1
            bench.drive.send_load()
            await bench.ear.hears(count)
            assert not bench.port.send(COMMAND)
        await bench.reports(BridgeOn=int(not stopped))
        assert bench.port.send(COMMAND) is not stopped


@pytest.mark.parametrize("spoil", [None, flipped])
async def test_a_stop_that_the_drive_reports_between_two_readings_is_not_missed(
    bench: Bench, spoil: Callable[[Drive, str], bytes] | None
) -> None:
    """Its clock is lost or refused at the stop, and a command might have it on again by then."""
    async with bench.come_on():
        known = bench.port.statistics.received
        bench.drive.send_status(BridgeOn=0)
        if spoil is not None:
            bench.drive.put("DriveLoad", spoil(bench.drive, "DriveLoad"))
        await bench.received(known + 1 + (spoil is not None))
        assert not bench.port.send(COMMAND)
        await bench.reports()
        assert bench.port.monitor.verdict is Verdict.STOPPED


OFF_COMMAND = replace(COMMAND, bridge=False)


@pytest.mark.parametrize(
    ("last", "between", "stopped"),
    [
        (COMMAND, (1, 0), True),
        (COMMAND, (1, 0, 1), False),
        (OFF_COMMAND, (1, 0), False),
        (None, (1, 0), False),
    ],
    ids=["came on and stopped", "bounced", "was commanded off", "was not commanded"],
)
async def test_a_drive_that_came_on_and_stopped_between_two_readings_is_not_driven_on(
    bench: Bench, last: Command | None, between: Sequence[int], *, stopped: bool
) -> None:
    """By the newest of its frames alone it is yet to come on, and may be commanded on.

    One that bounces has not stopped; one that was not commanded on is off.
    """
    async with bench.heard(BridgeOn=0):
        if last is not None:
            assert bench.port.send(last)
        for bridge in between[:-1]:
            bench.drive.send_status(BridgeOn=bridge)
        await bench.reports(BridgeOn=between[-1])
        assert bench.port.send(COMMAND) is not stopped
        bench.clock.now_s += TICK_S
        await bench.reports(BridgeOn=between[-1])
        assert (bench.port.monitor.verdict is Verdict.STOPPED) is stopped


@pytest.mark.parametrize("last", [SAFE_COMMAND, OFF_COMMAND])
async def test_a_drive_that_was_off_when_its_bus_was_lost_may_be_off_after_it(
    bench: Bench, last: Command
) -> None:
    async with bench.heard(COMMAND):
        assert bench.port.send(last)
        await bench.loses_its_bus()
        assert bench.port.send(COMMAND)
        await bench.reports(BridgeOn=0)
        assert bench.port.trip_cause is None


async def test_a_bus_that_carries_errors_alone_is_opened_again_ever_later(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A shorted bus whose controller restarts by itself: each time, warnings precede bus-off."""
    delays_s = noted_delays("adaptdrive.devices.can.connection", monkeypatch)
    async with bench.heard():
        for count in (2, 4, 6):
            for error in (0x04, 0x40):
                frame = can.Message(arbitration_id=error, is_error_frame=True, data=bytes(8))
                bench.drive.bus.send(frame)
            await until(lambda count=count: len(bench.ear.bus) == count)  # type: ignore[misc]
        await bench.reports()
    assert delays_s == [0.1, 0.2, 0.4]
    assert [up for up, _ in bench.ear.bus] == [False, True] * 3
    assert "bus-off" in bench.ear.bus[0][1]


async def test_a_first_failure_is_raised() -> None:
    ear, port = Ear(), build_port(motor_bus(interface="socketcan", channel="nosuchcan0"))
    with pytest.raises(BusError, match="socketcan nosuchcan0"):
        await port.run(ear, lambda: None)
    assert ear.bus == []


async def test_a_flood_of_strangers_does_not_hide_the_drive(bench: Bench) -> None:
    async with bench.running():
        for number in range(10):
            for foreign in range(0x200, 0x228):
                frame = can.Message(arbitration_id=foreign, is_extended_id=False, data=bytes(8))
                bench.drive.bus.send(frame)
            bench.drive.send_both()
            await bench.received((number + 1) * 42)
        assert len(bench.ear.readings) == 10
        assert bench.port.statistics.foreign == 400


@pytest.mark.parametrize("kind", ["is_extended_id", "is_remote_frame", "is_error_frame"])
async def test_other_kinds_of_frame_with_a_known_id_are_strangers(bench: Bench, kind: str) -> None:
    async with bench.heard():
        data = b"" if kind == "is_remote_frame" else bench.drive.frame("DriveLoad")
        given = {"is_extended_id": False, "data": data} | {kind: True}
        bench.drive.bus.send(can.Message(arbitration_id=0x101, **given))  # type: ignore[arg-type]
        await bench.received(3)
        assert bench.port.statistics.foreign == 1
        assert len(bench.ear.readings) == 1


async def test_an_error_while_opening_leaves_no_bus_open(bench: Bench) -> None:
    with pytest.raises(ZeroDivisionError):
        await bench.port.run(bench.ear, lambda: 1 // 0)  # type: ignore[arg-type]
    assert not bench.port.send(COMMAND)


async def test_the_oldest_value_is_named_with_its_cause(bench: Bench) -> None:
    port = bench.port
    assert str(port.explain_age()).endswith("the bus is lost")
    assert port.explain_age().kind is TripKind.BUS_LOST
    async with bench.running():
        assert "(0x100 (DriveStatus), " in str(port.explain_age())
        assert "has never come: no message comes" in str(port.explain_age())
        assert port.explain_age().kind is TripKind.NO_MESSAGE
        await bench.reports()
        bench.clock.now_s += 0.1
        bench.drive.send_load()
        await bench.ear.hears(2)
        status = port.explain_age()
        assert "(0x100 (DriveStatus), " in str(status)
        assert "is the oldest value, 100 ms old: other messages come, and this one has" in str(
            status
        )
        assert " come before" in str(status)
        assert "as often as interlocks.stale_s needs?" in str(status)
        assert status.kind is TripKind.MESSAGE_MISSING
        bench.drive.put("DriveStatus", bytes(8))
        await until(lambda: port.statistics.wrong_checksum == 1)
        refused = "its frames come and are refused (wrong_checksum, 1 in a row)"
        assert refused in str(port.explain_age())
        assert port.explain_age().kind is TripKind.FRAMES_REFUSED
        assert any("wrong_checksum 1 x, last [00 00" in line for line in port.details())
        bench.clock.now_s += 0.1
        await bench.reports()
        bench.clock.now_s += 0.1
        assert "no message comes" in str(port.explain_age())
        assert port.explain_age().kind is TripKind.NO_MESSAGE


async def test_the_oldest_value_is_named_with_its_own_age(bench: Bench) -> None:
    """The last reading is as old as a value that has come again since."""
    async with bench.running():
        bench.drive.send_status()
        await bench.received(1)
        bench.clock.now_s += 0.010
        bench.drive.send_load()
        await bench.ear.hears(1)
        bench.clock.now_s += 0.020
        bench.drive.send_status()
        await bench.received(3)
        bench.clock.now_s += 0.025
        reading, explain = bench.ear.readings[-1], bench.port.explain_age
        cause = find_cause(reading, bench.clock.now_s, LIMITS, 0.05, explain)
    assert cause is not None
    assert "measurement is 55 ms old, limit 50 ms; output (0x101 (DriveLoad), Tach" in str(cause)
    assert ") is the oldest value, 45 ms old: " in str(cause)


async def test_a_fault_is_kept_when_the_clocking_frame_is_lost(bench: Bench) -> None:
    """One frame shows it; the next frames say that all is well again."""
    async with bench.heard():
        for count, fault in enumerate((1, 8, 64), 2):
            bench.drive.send_status(Fault=fault)
            await until(lambda: bench.port.trip_cause is not None)
            assert f"word {fault:#x}" in str(bench.port.trip_cause)
            bench.drive.send_status(Fault=0)
            bench.drive.send_load()
            await bench.ear.hears(count)
            assert bench.ear.readings[-1].fault == fault
            assert bench.port.trip_cause is None
        await bench.reports()
        assert bench.ear.readings[-1].fault == 0


async def test_of_two_fault_codes_between_two_readings_the_first_is_told(bench: Bench) -> None:
    """Added up they would name a fault that never was."""
    bench.build(('2 "Overtemperature"', '2 "Overtemperature" 3 "Earth fault"'))
    async with bench.heard():
        bench.drive.send_status(Fault=1)
        bench.drive.send_status(Fault=2)
        await bench.received(4)
        assert str(bench.port.trip_cause) == "drive fault: Fault Overcurrent (word 0x1)"
        for count in (2, 3):
            bench.drive.send_load()
            await bench.ear.hears(count)
            bench.drive.send_status(Fault=6)
            await bench.received(2 * count + 2)
        assert str(bench.port.trip_cause) == "drive fault: Fault 6 (word 0x6)"
    faults = [(reading.fault, reading.fault_name) for reading in bench.ear.readings]
    assert faults == [(0, ""), (1, "Fault Overcurrent"), (6, "Fault 6")]


def without_new_values(reading: Reading, good: Reading) -> bool:
    """Whether no value of a reading is newer than that of another one."""
    held = ("output", "boost_voltage_V", "line_voltage_V", "oldest_s")
    return all(getattr(reading, name) == getattr(good, name) for name in held)


@pytest.mark.parametrize("spoilt", ["DriveStatus", "DriveLoad"])
async def test_the_words_beside_a_value_that_is_not_available_are_used(
    bench: Bench, spoilt: str
) -> None:
    """They show fault and bridge, and no value becomes newer by them."""
    async with bench.heard(COMMAND):
        bench.clock.now_s += 0.01
        status = bench.drive.frame("DriveStatus", **(STATUS | {"Fault": 2, "BridgeOn": 0}))
        no_volts = with_crc(b"\xff\xff" + status[2:])
        bench.drive.put("DriveStatus", no_volts if spoilt == "DriveStatus" else status)
        await until(lambda: "word 0x2" in str(bench.port.trip_cause))
        if spoilt == "DriveLoad":
            bench.drive.put("DriveLoad", unavailable(bench.drive, "DriveLoad"))
        else:
            bench.drive.send_load()
        await bench.ear.hears(2)
        await bench.reports()
    good, reading, next_one = bench.ear.readings
    assert (reading.fault, reading.bridge, reading.bridge_s) == (2, False, bench.clock.now_s)
    assert reading.oldest_s == good.oldest_s
    assert (reading.whole, next_one.whole, next_one.oldest_s) == (False, True, bench.clock.now_s)
    if spoilt == "DriveStatus":
        assert without_new_values(reading, good)
        (refused,) = bench.port.details()
        assert "]: BoostVoltage = 655.35 V (0…655.34); a sensor of the drive" in refused
    assert bench.port.statistics.out_of_range == 1
