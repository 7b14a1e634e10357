"""The port against a drive that answers as it should, or stops by itself."""

from __future__ import annotations

import asyncio
import math
from itertools import groupby, pairwise
from statistics import median

import pytest

from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.safety.trips import TripKind
from adaptdrive.util.errors import BusError
from tests.unit.devices import memory
from tests.unit.devices.bench import Ear, until
from tests.unit.devices.modbus.bench import (
    FUNCTION_23,
    RUN,
    Bench,
    Peer,
    Pieces,
    POLL_s,
    TIMEOUT_s,
    benched,
    build,
    driven,
    ran,
    reported,
    untouched,
)

pytestmark = pytest.mark.usefixtures("memory")
Changes = dict[str, str | None]
BOTH_WAYS = pytest.mark.parametrize("changes", [{}, FUNCTION_23], ids=["apart", "function-23"])

LOST = 2
"""Requests without a reply after which a drive may have stopped by its own time-out."""

SCATTERED: Changes = {
    "bus__max_gap": "0",
    "bus__registers__line": "{ address = 5, table = 'holding', scale = 0.1 }",
    "bus__registers__speed": "{ address = 3, table = 'holding', type = 'float32' }",
}
"""Four blocks that are read one by one."""

REPORTED: Changes = {
    "bus__registers__on": "{ address = 5, table = 'input', mask = 0x1 }",
    "signals__bridge": '"on"',
}
"""The bridge is a bit of the peer's state."""

ON_OF_TWO: Changes = {
    "bus__registers__on": "{ address = 0, table = 'input', mask = 0x4 }",
    "signals__bridge": '"on"',
}
"""The bridge is a bit of the word of the voltage."""


async def test_the_newest_command_goes_out_with_each_poll_and_a_heartbeat() -> None:
    async with benched() as one:
        for voltage in (250.0, 260.0, 287.65):
            assert one.port.send(Command(0.0, voltage, bridge=True))
        await until(lambda: len(one.peer.writes) >= 4)
    assert {address for address, _ in one.peer.writes} == {0}
    assert [words[:2] for _, words in one.peer.writes[:4]] == [[28765, 1]] * 4
    beats = [words[2] for _, words in one.peer.writes]
    assert beats == list(range(beats[0], beats[0] + len(beats)))
    assert one.port.statistics.send_drops == 0


async def test_function_23_carries_both_ways_and_a_new_command_does_not_wait() -> None:
    async with benched(**FUNCTION_23) as one:
        await one.runs_until(lambda: bool(one.peer.writes))
        known = len(one.peer.requests)
        await one.hears(5)
        assert {request[0] for request in one.peer.requests[known:]} == {23}
        one.check_honesty()
        one.port.send(Command(0.0, 290.0, bridge=True))
        await one.asks(3)
        assert one.told() == [29000, 1]


async def test_the_safe_command_does_not_wait_for_the_next_poll() -> None:
    slow = {
        "bus__poll_ticks": "120",
        "load__latency_ticks": "120",
        "load__period_s": "2.0",
        "interlocks__stale_s": "2.0",
    }
    async with benched(**slow) as one:
        await one.runs_until(lambda: bool(one.peer.writes))
        await until(lambda: one.port.statistics.sent >= 2)
        polled, began_s = len(one.ear.readings), asyncio.get_running_loop().time()
        one.port.send(SAFE_COMMAND)
        await one.is_told(0, 0)
        assert asyncio.get_running_loop().time() - began_s < 0.01
        assert len(one.ear.readings) == polled
        one.port.send(SAFE_COMMAND)
        writes = len(one.peer.writes)
        await one.hears(1)
        assert len(one.peer.writes) <= writes + 1


async def test_a_serial_port_that_is_not_there_ends_the_start() -> None:
    with pytest.raises(BusError, match="no such serial port"):
        await build(**Peer("rtu").link).run(Ear(), lambda: None)


async def test_a_drive_on_tcp_that_is_switched_off_is_waited_for() -> None:
    peer = Peer()
    one = Bench(build(**peer.link), peer)
    async with ran(one):
        await one.hears_of_bus(up=False)
        assert not one.port.send(RUN)
        peer.start()
        await one.hears(1)
        assert one.ear.bus[-1][0]


class Mute:
    """A drive that hears its first connection and answers nothing, and closes all later ones."""

    def __init__(self) -> None:
        self.connections = 0

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        if self.connections == 1:
            while await reader.read(100):
                pass
        writer.close()


async def test_a_link_that_dies_under_an_urgent_command_is_not_hammered() -> None:
    mute, peer = Mute(), Peer()
    one = Bench(build(**peer.link, **FUNCTION_23), peer)
    assert isinstance(peer.address, int)
    with memory.serving(peer.address, mute.serve):
        async with ran(one):
            one.port.send(RUN)
            await until(lambda: mute.connections == 1)
            await until(lambda: one.port.send(SAFE_COMMAND) is None or mute.connections >= 3)
            known = mute.connections
            await asyncio.sleep(1.0)
            assert mute.connections - known <= 4


async def test_a_port_that_is_closed_while_it_waits_for_the_drive_opens_no_link() -> None:
    peer = Peer()
    one = Bench(build(**peer.link), peer)
    async with ran(one):
        await one.hears_of_bus(up=False)
        peer.start()
    assert peer.connections == 0


@BOTH_WAYS
async def test_a_drive_that_was_on_when_its_link_was_lost_is_read_before_it_is_driven_on(
    changes: Changes,
) -> None:
    """Its map has no bridge: it may have started anew, and cannot tell."""
    async with driven(None, **changes) as one:
        one.peer.stop()
        await one.hears_of_bus(up=False)
        written = len(one.peer.writes)
        one.port.send(RUN)
        one.peer.start()
        await one.hears_of_bus(up=True)
        await until(lambda: one.port.monitor.stop is not None)
        assert "the bus was lost meanwhile" in str(one.port.monitor.stop)
        assert not any(registers[1] for _, registers in one.peer.writes[written:])
        one.port.send(SAFE_COMMAND)
        assert one.port.monitor.stop is None
        await until(lambda: len(one.peer.writes) > written and one.told()[1] == 0)


@BOTH_WAYS
async def test_a_drive_whose_reply_to_its_first_energising_command_is_lost_is_read_first(
    changes: Changes,
) -> None:
    """It has executed the command, and may have started anew before the next connection."""
    async with benched(**changes) as one:
        peer, asked = one.peer, list[int]()

        def cut(reply: bytes) -> Pieces:
            if not asked and peer.writes and peer.writes[-1][1][1]:
                asked.append(len(peer.requests))
                peer.hang_up()
                return []
            return untouched(reply)

        peer.spoil = cut
        one.port.send(RUN)
        await until(lambda: peer.connections == 2 and len(peer.requests) > asked[0])
        assert peer.requests[asked[0]][0] in {3, 4}


@pytest.mark.parametrize("kind", ["tcp", "rtu"])
@pytest.mark.parametrize(("timeout_s", "silent"), [(None, LOST), ("0.1", 1)])
@BOTH_WAYS
async def test_a_drive_that_was_silent_is_read_before_it_is_driven_on(
    kind: str, changes: Changes, timeout_s: str | None, silent: int
) -> None:
    """Replies are lost, and the connection is kept: it may have stopped by its own time-out."""
    changes = {**changes, "bus__command_timeout_s": timeout_s}
    async with driven(None, kind, **changes) as one:
        peer, lost = one.peer, list[int]()

        def lose(reply: bytes) -> Pieces:
            begun = bool(lost) or peer.requests[-1][0] != 16  # a silence begins with a poll
            if len(lost) == silent or not begun:
                return untouched(reply)
            lost.append(len(peer.requests))
            return []

        peer.spoil = lose
        await until(lambda: len(lost) == silent)
        for _ in range(3):
            await one.hears(1)
            one.port.send(RUN)
        await one.hears(1)
        functions = [request[0] for request in peer.requests]
        assert functions[lost[-1]] in {3, 4}
        assert {16, 23} & {*functions[lost[-1] :]}
        assert one.told()[1] == 1
        assert one.port.trip_cause is None
        assert all(up for up, _ in one.ear.bus)


@BOTH_WAYS
async def test_a_drive_that_stopped_while_it_was_silent_is_not_driven_on(changes: Changes) -> None:
    async with driven(1, **reported(changes)) as one:
        await one.hears(3)
        one.peer.dead = {1}
        await one.reads(LOST)  # a write of the poll under way may be lost, too
        known, one.peer.state = len(one.peer.writes), 0
        one.peer.dead = set()
        await one.hears(2)
        assert "a read had no answer meanwhile" in str(one.port.monitor.stop)
        assert len(one.peer.writes) == known
        assert one.port.statistics.withheld_commands == 1  # one was given, and waits since
        one.port.send(SAFE_COMMAND)
        assert one.port.monitor.stop is None


@BOTH_WAYS
async def test_a_drive_one_of_whose_reports_is_lost_is_read_before_it_is_driven_on(
    changes: Changes,
) -> None:
    """It may have started anew: what energises is not written before it has reported again."""
    async with driven(1, **reported(changes)) as one:
        peer, lost = one.peer, list[int]()

        def lose(reply: bytes) -> Pieces:
            if lost or peer.requests[-1][0] == 16:
                return untouched(reply)
            lost.append(len(peer.requests))
            return []

        peer.spoil = lose
        await until(lambda: bool(lost) and len(peer.requests) > lost[0] + 3)
        functions = [request[0] for request in peer.requests[lost[0] :]]
        assert functions[0] in {3, 4}
        assert 16 in functions


async def test_a_command_from_before_the_bridge_went_off_is_not_written_again() -> None:
    """Whoever decides may hold the next one back: a drive that has just come on may bounce."""
    async with driven(1, **reported({})) as one:
        await one.hears(2)
        written: list[tuple[bool, int]] = []
        one.ear.decide = lambda reading: written.append((reading.bridge, len(one.peer.writes)))
        one.peer.state = 0
        await until(lambda: [bridge for bridge, _ in written].count(False) == 4)
        known = next(count for bridge, count in written if not bridge)
        assert len(one.peer.writes) == known
        one.port.send(SAFE_COMMAND)
        one.port.send(RUN)
        await until(lambda: len(one.peer.writes) > known)


async def test_a_command_follows_the_read_of_the_bridge() -> None:
    """Of several reads that of the bridge is the last: no slow one gives it time to stop."""
    async with driven(1, **SCATTERED, **ON_OF_TWO) as one:
        await until(lambda: len(one.peer.writes) > 3)
        read = {before for before, after in pairwise(one.peer.requests) if after[0] == 16}
        assert {request[:3] for request in read} == {b"\x04\0\0"}


async def test_a_safe_command_that_no_poll_has_carried_is_written_at_the_end() -> None:
    """A drive may be on since the process before; with a heartbeat the first poll is no reading."""
    peer = Peer()
    one = Bench(build(**peer.link), peer)
    peer.start()
    async with ran(one):
        await one.asks(1)
        one.port.send(SAFE_COMMAND)
    assert one.told() == [0, 0]


def refuses_writes(pdu: bytes) -> bytes:
    """A reply, or exception 6 in place of an acknowledgement."""
    return pdu if pdu[0] in {3, 4} else bytes((pdu[0] | 0x80, 6))


def beats(one: Bench, register: int, known: int) -> list[int]:
    """Heartbeats among the writes after the first so many."""
    return [
        words[register - address]
        for address, words in one.peer.writes[known:]
        if address <= register < address + len(words)
    ]


async def is_fed(one: Bench, register: int = 2) -> None:
    """Wait for some heartbeats."""
    known = len(one.peer.writes)
    await until(lambda: len(set(beats(one, register, known))) > 3)


@pytest.mark.parametrize("register", [2, 9], ids=["same-block", "own-block"])
async def test_a_drive_that_refuses_the_safe_command_gets_no_heartbeat(register: int) -> None:
    """Its own watchdog is what is left to switch it off; a drive that obeys is fed again."""
    alive = {"bus__registers__alive": f"{{ address = {register}, table = 'holding' }}"}
    async with driven(None, **alive) as one:
        one.peer.answer = refuses_writes
        one.port.send(SAFE_COMMAND)
        await asyncio.sleep(1.5)
        known = len(one.peer.writes)
        await until(lambda: len(one.peer.writes) > known + 10)
        assert len(set(beats(one, register, known))) <= (register == 2)
        assert [0, 0] in [words[:2] for _, words in one.peer.writes[known:]]
        one.peer.answer = lambda pdu: pdu
        await is_fed(one, register)


@pytest.mark.parametrize("is_reported", [True, False])
async def test_a_drive_that_was_on_gets_no_heartbeat_on_new_connections_without_readings(
    *, is_reported: bool
) -> None:
    """It acknowledges the safe command and does not obey it; one that reports off is fed again,
    also beside values that are refused, and so is one that never reports its bridge.
    """
    async with driven(1, **(REPORTED if is_reported else {})) as one:
        peer = one.peer
        if is_reported:
            peer.answer = lambda pdu: bytes((0x84, 4)) if pdu[0] == 4 else pdu
        else:
            peer.speed = math.nan
        one.port.send(SAFE_COMMAND)
        for _ in range(4):
            await asyncio.sleep(0.4)
            peer.hang_up()
        if is_reported:
            known = len(peer.writes)
            await until(lambda: len(peer.writes) > known + 10)
            assert len(set(beats(one, 2, known))) == 1
            peer.answer, peer.state, peer.speed = (lambda pdu: pdu), 2, math.nan
        await is_fed(one)


@pytest.mark.parametrize("coded", ["uint16", "int16"])
async def test_a_register_without_a_value_confirms_no_stop(coded: str) -> None:
    """A gateway gives all ones for a module that it does not reach; the other values are right."""
    register = f"{{ address = 5, table = 'input', type = '{coded}' }}"
    state = {
        "bus__registers__state": register,
        "bus__registers__closed": register,
        "signals__bridge": "{ signal = 'closed', on = 4 }",
    }
    async with driven(4, **state) as one:
        one.peer.state = 0xFFFF
        one.port.send(SAFE_COMMAND)
        await one.is_told(0, 0)
        await one.asks(12)
        assert one.ear.readings[-1].bridge
        why = "bridge: input 5 (address from 0) holds ffff, its word for no value"
        cause = one.port.explain_age()
        assert (cause.kind, why in cause.text) == (TripKind.VALUE_REFUSED, True)
        one.peer.state = 0
        await one.hears(2)
        assert not one.ear.readings[-1].bridge


async def test_a_drive_that_reports_its_stop_beside_refused_values_is_not_driven_on() -> None:
    async with driven(1, **REPORTED) as one:
        one.peer.speed, one.peer.state = math.nan, 0
        await one.asks(4)
        known = len(one.peer.writes)
        await one.asks(8)
        assert (one.ear.readings[-1].bridge, one.ear.readings[-1].whole) == (False, False)
        one.peer.speed = 3.25
        await one.hears(2)
        assert one.peer.writes[known:] == []
        one.port.send(SAFE_COMMAND)
        await one.is_told(0, 0)
        assert one.port.trip_cause is None


@pytest.mark.parametrize("stops_unseen", [True, False])
async def test_a_drive_that_came_on_beside_refused_values_and_stopped_is_not_driven_on(
    *, stops_unseen: bool
) -> None:
    async with benched(**REPORTED) as one:
        one.peer.state = 0
        await one.hears(2)
        one.peer.speed, one.peer.state = math.nan, 1
        await one.runs_until(lambda: bool(one.peer.writes))
        await one.asks(4)
        if not stops_unseen:
            one.peer.state = 0
            await one.asks(4)
        known, one.peer.state, one.peer.speed = len(one.ear.readings), 0, 3.25
        await one.hears(known + 1)
        bridges = [reading.bridge for reading in one.ear.readings]
        assert [on for on, _ in groupby(bridges)][-3:] == [False, True, False]
        written = len(one.peer.writes)
        await one.asks(4)
        assert one.peer.writes[written:] == []
        one.port.send(SAFE_COMMAND)
        await one.is_told(0, 0)
        assert one.port.trip_cause is None


@pytest.mark.parametrize("stops", [False, True])
async def test_a_drive_whose_heartbeat_stands_still_gets_no_old_command(*, stops: bool) -> None:
    """Its polls are answered, and give no reading: nothing is decided anew."""
    async with driven(None, **ON_OF_TWO, bus__heartbeat__drive='"state"') as one:
        one.port.send(SAFE_COMMAND)
        one.peer.voltage &= ~4
        await until(lambda: not one.ear.readings[-1].bridge)
        one.port.send(RUN)
        one.peer.voltage |= 4
        await until(lambda: one.ear.readings[-1].bridge)
        one.peer.state = 1
        await one.asks(8)
        if stops:
            one.peer.voltage = 30008
            await one.asks(2)
        known = len(one.peer.writes)
        await one.asks(8)
        assert one.peer.writes[known:] == []
        one.peer.state = None
        await one.hears(2)
        if stops:
            assert not one.ear.readings[-1].bridge
            assert one.peer.writes[known:] == []
        else:
            await until(lambda: len(one.peer.writes) > known)
            assert one.port.trip_cause is None


@pytest.mark.parametrize("kind", ["tcp", "rtu"])
async def test_a_drive_that_answers_slowly_gets_its_commands(kind: str) -> None:
    """Each reply takes less than its time-out, and the four of a poll more than two polls."""
    async with benched(kind, **SCATTERED) as one:
        one.peer.spoil = lambda reply: [(0.7 * TIMEOUT_s, reply)]
        for voltage_V in (250.0, 260.0):
            one.port.send(Command(0.0, voltage_V, bridge=True))
            await one.hears(2)
            assert one.told() == [round(100.0 * voltage_V), 1]


async def test_a_poll_that_missed_its_time_is_not_followed_by_a_pause() -> None:
    """Four exchanges take over two polls: the next poll begins at once, not at the third."""
    async with benched(**SCATTERED) as one:
        one.peer.spoil = lambda reply: [(0.5 * POLL_s, reply)]
        one.port.send(Command(0.0, 250.0, bridge=True))
        await one.hears(3)
        known = len(one.ear.readings)
        await one.hears(20)
        ends = [reading.arrival_s for reading in one.ear.readings[known - 1 :]]
        assert median([end - begin for begin, end in pairwise(ends)]) < 2.7 * POLL_s
