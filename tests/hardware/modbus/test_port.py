"""The port against a drive that answers as it should."""

from __future__ import annotations

import asyncio
import math
import time
from itertools import groupby, pairwise
from pathlib import Path
from statistics import median

import pytest

from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.errors import BusError
from adaptdrive.hardware.port import Reading
from tests.hardware.bench import Ear, until
from tests.hardware.modbus.bench import (
    FUNCTION_23,
    RUN,
    Bench,
    Pieces,
    TcpPeer,
    TIMEOUT_s,
    Wire,
    build,
    judged,
    reported,
    serial,
    untouched,
)

POLL_s = 6 / 120.0
LOST = 2
"""Requests without a reply after which a drive may have stopped by its own time-out."""
FROZEN_POLLS = 4.0

SCATTERED: dict[str, str | None] = {
    "bus__max_gap": "0",
    "bus__registers__line": "{ address = 5, table = 'holding', scale = 0.1 }",
    "bus__registers__speed": "{ address = 3, table = 'holding', type = 'float32' }",
}
"""Four blocks that are read one by one."""

REPORTED = {
    "bus__registers__on": "{ address = 5, table = 'input', bit = 0 }",
    "signals__bridge": '"on"',
}
"""The bridge is a bit of the peer's state."""


async def test_a_reading_holds_what_the_drive_measured(wire: Wire) -> None:
    async with wire.bench() as one:
        await one.hears(5)
        one.check_honesty()
        reading = one.ear.readings[-1]
        assert reading.boost_voltage_V == pytest.approx(300.12)
        assert reading.line_voltage_V == pytest.approx(120.4)
        assert reading.output == 3.25
        assert (reading.counter, reading.fault, reading.bridge) == (None, 0, False)
        assert one.ear.bus == []


async def test_whoever_only_listens_writes_nothing(wire: Wire) -> None:
    for changes in ({}, FUNCTION_23):
        async with wire.bench(**changes) as one:
            await one.hears(3)
        assert one.peer.writes == []


async def test_the_newest_command_goes_out_with_each_poll_and_a_heartbeat(wire: Wire) -> None:
    async with wire.bench() as one:
        for voltage in (250.0, 260.0, 287.65):
            assert one.port.send(Command(0.0, voltage, bridge=True))
        await until(lambda: len(one.peer.writes) >= 4)
    addresses = {address for address, _ in one.peer.writes}
    assert addresses == {0}
    assert [words[:2] for _, words in one.peer.writes[:4]] == [[28765, 1]] * 4
    beats = [words[2] for _, words in one.peer.writes]
    assert beats == list(range(beats[0], beats[0] + len(beats)))
    assert one.port.statistics.send_drops == 0


async def test_function_23_carries_both_ways_and_a_new_command_does_not_wait(wire: Wire) -> None:
    async with wire.bench(**FUNCTION_23) as one:
        one.port.send(RUN)
        await until(lambda: bool(one.peer.writes))
        known = len(one.peer.requests)
        await one.hears(5)
        assert {request[0] for request in one.peer.requests[known:]} == {23}
        one.check_honesty()
        told = Command(0.0, 290.0, bridge=True)
        one.port.send(told)
        await one.asks(3)
        assert one.told() == [29000, 1]


async def test_the_safe_command_does_not_wait_for_the_next_poll(wire: Wire) -> None:
    slow = {
        "bus__poll_ticks": "120",
        "load__latency_ticks": "120",
        "load__period_s": "2.0",
        "interlocks__stale_s": "2.0",
    }
    async with wire.bench(**slow) as one:
        one.port.send(RUN)
        await until(lambda: bool(one.peer.writes))
        await one.hears(1)
        await until(lambda: one.port.statistics.sent >= 2)
        polled = len(one.ear.readings)
        one.port.send(SAFE_COMMAND)
        await until(lambda: one.told() == [0, 0])
        assert len(one.ear.readings) == polled
        one.port.send(SAFE_COMMAND)
        writes = len(one.peer.writes)
        await one.hears(1)
        assert len(one.peer.writes) <= writes + 1


async def test_a_port_that_is_closed_leaves_the_drive_safe(wire: Wire) -> None:
    async with wire.bench() as one:
        one.port.send(RUN)
        await until(lambda: bool(one.peer.writes))
    assert one.told() == [0, 0]


class FailingEar(Ear):
    """Takes no reading once the drive has had a command."""

    def __init__(self, peer: TcpPeer) -> None:
        super().__init__()
        self.peer = peer

    def on_reading(self, reading: Reading) -> None:
        if self.peer.writes:
            assert self.peer.writes[-1][1][1], "the drive was to run"
            raise ZeroDivisionError
        super().on_reading(reading)


async def test_a_port_that_fails_leaves_the_drive_safe(free_tcp_port: int) -> None:
    peer, port = TcpPeer(free_tcp_port), build(bus__port=str(free_tcp_port))
    await peer.start()
    port.send(RUN)
    try:
        with pytest.raises(ZeroDivisionError):
            await port.run(FailingEar(peer), lambda: None)
        assert peer.writes[-1][1][:2] == [0, 0]
    finally:
        await peer.stop()


async def test_what_a_register_cannot_hold_is_not_sent(wire: Wire) -> None:
    async with wire.bench() as one:
        for voltage in (float("nan"), -1.0, 700.0):
            with pytest.raises(ValueError, match=r"outside|cannot hold"):
                one.port.send(Command(0.0, voltage, bridge=True))
        await one.hears(3)
        assert one.peer.writes == []


async def test_a_serial_port_that_is_not_there_ends_the_start(tmp_path: Path) -> None:
    port = build(**serial(tmp_path / "none"))
    with pytest.raises(BusError, match="no such serial port"):
        await port.run(Ear(), lambda: None)


async def test_a_drive_on_tcp_that_is_switched_off_is_waited_for(free_tcp_port: int) -> None:
    port, peer, ear = build(bus__port=str(free_tcp_port)), TcpPeer(free_tcp_port), Ear()
    opened: list[bool] = []
    task = asyncio.create_task(port.run(ear, lambda: opened.append(True)))
    await until(lambda: bool(ear.bus))
    assert opened == [True]
    assert ear.bus[0][0] is False
    assert not port.send(RUN)
    await peer.start()
    await until(lambda: bool(ear.readings))
    assert ear.bus[-1][0] is True
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    await peer.stop()


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


async def test_a_link_that_dies_under_an_urgent_command_is_not_hammered(
    free_tcp_port: int,
) -> None:
    port, mute = build(bus__port=str(free_tcp_port), **FUNCTION_23), Mute()
    async with await asyncio.start_server(mute.serve, "127.0.0.1", free_tcp_port):
        task = asyncio.create_task(port.run(Ear(), lambda: None))
        port.send(RUN)
        await until(lambda: mute.connections == 1)
        while mute.connections == 1:
            await asyncio.sleep(0.005)
            port.send(SAFE_COMMAND)
        await until(lambda: mute.connections >= 3)
        known, began_s = mute.connections, time.monotonic()
        await asyncio.sleep(1.0)
        grown, elapsed_s = mute.connections - known, time.monotonic() - began_s
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
    assert grown <= 4.0 * elapsed_s


async def test_a_port_that_is_closed_while_it_waits_for_the_drive_opens_no_link(
    free_tcp_port: int,
) -> None:
    port, ear, mute = build(bus__port=str(free_tcp_port)), Ear(), Mute()
    task = asyncio.create_task(port.run(ear, lambda: None))
    await until(lambda: bool(ear.bus))
    async with await asyncio.start_server(mute.serve, "127.0.0.1", free_tcp_port):
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        await asyncio.sleep(0.05)
    assert mute.connections == 0


async def test_after_a_freeze_nothing_energising_is_written(
    wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The process stands still between a reading and the command that goes with it."""
    async with wire.bench() as one:
        one.port.send(RUN)
        await until(lambda: bool(one.peer.writes) and one.told()[1] == 1)
        take, thawed = one.ear.on_reading, asyncio.Event()

        def freeze(reading: Reading) -> None:
            take(reading)
            if not thawed.is_set():
                time.sleep(FROZEN_POLLS * POLL_s)
                written.append(len(one.peer.writes))
                thawed.set()
            else:
                one.port.send(SAFE_COMMAND)

        written: list[int] = []
        monkeypatch.setattr(one.ear, "on_reading", freeze)
        await until(lambda: thawed.is_set() and one.told()[1] == 0)
        await one.hears(3)
        assert not any(registers[1] for _, registers in one.peer.writes[written[0] :])


@pytest.mark.parametrize("changes", [{}, FUNCTION_23], ids=["apart", "function-23"])
async def test_a_drive_that_was_on_when_its_link_was_lost_is_read_before_it_is_driven_on(
    wire: Wire, changes: dict[str, str | None]
) -> None:
    """Its map has no bridge: it may have started anew, and cannot tell."""
    async with wire.bench(**changes) as one:
        one.port.send(RUN)
        await until(lambda: bool(one.ear.readings) and one.ear.readings[-1].bridge)
        await one.peer.stop()
        await until(lambda: bool(one.ear.bus) and not one.ear.bus[-1][0])
        written = len(one.peer.writes)
        one.port.send(RUN)
        await one.peer.start()
        await until(lambda: one.ear.bus[-1][0])
        assert "the bus was lost meanwhile" in str(one.port.complaint)
        assert not any(registers[1] for _, registers in one.peer.writes[written:])
        one.port.send(SAFE_COMMAND)
        assert one.port.complaint is None
        await until(lambda: len(one.peer.writes) > written and one.told()[1] == 0)


@pytest.mark.parametrize("changes", [{}, FUNCTION_23], ids=["apart", "function-23"])
async def test_a_drive_whose_reply_to_its_first_energising_command_is_lost_is_read_first(
    tcp: Wire, changes: dict[str, str | None]
) -> None:
    """It has executed the command, and may have started anew before the next connection."""
    async with tcp.bench(**changes) as one:
        await one.hears(2)
        assert isinstance(one.peer, TcpPeer)
        peer = one.peer
        asked: list[int] = []

        def cut(reply: bytes) -> list[tuple[float, bytes]]:
            if not asked and peer.writes and peer.writes[-1][1][1]:
                asked.append(len(peer.requests))
                peer.hang_up()
                return []
            return [(0.0, reply)]

        peer.spoil = cut
        one.port.send(RUN)
        await until(lambda: peer.connections == 2 and len(peer.requests) > asked[0])
        assert peer.requests[asked[0]][0] in {3, 4}


@pytest.mark.parametrize(("timeout_s", "silent"), [(None, LOST), ("0.1", 1)])
@pytest.mark.parametrize("changes", [{}, FUNCTION_23], ids=["apart", "function-23"])
async def test_a_drive_that_was_silent_is_read_before_it_is_driven_on(
    wire: Wire, changes: dict[str, str | None], timeout_s: str | None, silent: int
) -> None:
    """Replies are lost, and the connection is kept: it may have stopped by its own time-out."""
    changes = {**changes, "bus__command_timeout_s": timeout_s}
    async with wire.bench(**changes) as one:
        one.port.send(RUN)
        await until(lambda: bool(one.ear.readings) and one.ear.readings[-1].bridge)
        peer = one.peer
        lost: list[int] = []

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
        assert one.port.complaint is None
        assert all(up for up, _ in one.ear.bus)


@pytest.mark.parametrize("changes", [{}, FUNCTION_23], ids=["apart", "function-23"])
async def test_a_drive_that_stopped_while_it_was_silent_is_not_driven_on(
    wire: Wire, changes: dict[str, str | None]
) -> None:
    async with wire.bench(**reported(changes)) as one:
        one.peer.state = 1
        one.port.send(RUN)
        await until(lambda: bool(one.peer.writes))
        await one.hears(3)
        assert one.ear.readings[-1].bridge
        one.peer.dead = {1}
        await one.reads(LOST)  # a write of the poll under way may be lost, too
        known, one.peer.state = len(one.peer.writes), 0
        one.peer.dead = set()
        await one.hears(2)
        assert "a read had no answer meanwhile" in str(one.port.complaint)
        assert len(one.peer.writes) == known
        assert one.port.statistics.withheld_commands == 1  # one was given, and waits since
        one.port.send(SAFE_COMMAND)
        assert one.port.complaint is None


@pytest.mark.parametrize("changes", [{}, FUNCTION_23], ids=["apart", "function-23"])
async def test_a_drive_one_of_whose_reports_is_lost_is_read_before_it_is_driven_on(
    wire: Wire, changes: dict[str, str | None]
) -> None:
    """It may have started anew: what energises is not written before it has reported again."""
    async with wire.driven(1, **reported(changes)) as one:
        peer = one.peer
        lost: list[int] = []

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


async def test_a_command_from_before_the_bridge_went_off_is_not_written_again(
    wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever decides may hold the next one back: a drive that has just come on may bounce."""
    async with wire.driven(1, **reported({})) as one:
        await until(lambda: one.told()[1] == 1)
        await one.hears(2)
        take, written = one.ear.on_reading, []

        def note(reading: Reading) -> None:
            take(reading)
            written.append((reading.bridge, len(one.peer.writes)))

        monkeypatch.setattr(one.ear, "on_reading", note)
        one.peer.state = 0
        await until(lambda: [bridge for bridge, _ in written].count(False) == 4)
        known = next(count for bridge, count in written if not bridge)
        assert len(one.peer.writes) == known
        one.port.send(RUN)
        await until(lambda: len(one.peer.writes) > known)


async def test_a_command_follows_the_read_of_the_bridge(wire: Wire) -> None:
    """Of several reads that of the bridge is the last: no slow one gives it time to stop."""
    bridge = {
        "bus__registers__on": "{ address = 0, table = 'input', bit = 2 }",
        "signals__bridge": '"on"',
    }
    async with wire.driven(1, **SCATTERED, **bridge) as one:
        await until(lambda: len(one.peer.writes) > 3)
        read = {before for before, after in pairwise(one.peer.requests) if after[0] == 16}
        assert {request[:3] for request in read} == {b"\x04\0\0"}


async def test_a_safe_command_that_no_poll_has_carried_is_written_at_the_end(wire: Wire) -> None:
    """A drive may be on since the process before; with a heartbeat the first poll is no reading."""
    port, peer = wire.parts()
    await peer.start()
    ending = asyncio.create_task(port.run(Ear(), lambda: None))
    await until(lambda: bool(peer.requests))
    port.send(SAFE_COMMAND)
    ending.cancel()
    await asyncio.gather(ending, return_exceptions=True)
    await peer.stop()
    assert [registers[:2] for _, registers in peer.writes][-1:] == [[0, 0]]


def refuses_writes(pdu: bytes) -> bytes:
    """A reply, or exception 6 in place of an acknowledgement."""
    return pdu if pdu[0] in {3, 4} else bytes((pdu[0] | 0x80, 6))


@pytest.mark.parametrize("register", ["2", "9"], ids=["same-block", "own-block"])
async def test_a_drive_that_refuses_the_safe_command_gets_no_heartbeat(
    wire: Wire, register: str
) -> None:
    """Its own watchdog is what is left to switch it off; a drive that obeys is fed again."""
    alive = {"bus__registers__alive": f"{{ address = {register}, table = 'holding' }}"}
    async with wire.bench(**alive) as one:
        one.port.send(RUN)
        await until(lambda: bool(one.peer.writes))
        one.peer.answer = refuses_writes
        one.port.send(SAFE_COMMAND)
        await asyncio.sleep(1.5)
        known = len(one.peer.writes)
        await until(lambda: len(one.peer.writes) > known + 10)
        assert len(set(beats(one, int(register), known))) <= (register == "2")
        assert [0, 0] in [words[:2] for _, words in one.peer.writes[known:]]
        one.peer.answer = lambda pdu: pdu
        known = len(one.peer.writes)
        await until(lambda: len(set(beats(one, int(register), known))) > 3)


async def test_a_drive_whose_stop_may_take_long_is_fed_meanwhile(tcp: Wire) -> None:
    """Its own watchdog would end a stop as a fault."""
    changes = {**REPORTED, "interlocks__stop_s": "5.0"}
    async with tcp.driven(1, **changes) as one:
        one.port.send(SAFE_COMMAND)
        await asyncio.sleep(1.5)
        known = len(one.peer.writes)
        await until(lambda: len(set(beats(one, 2, known))) > 3)


async def test_a_drive_that_was_on_gets_no_heartbeat_on_new_connections_without_readings(
    tcp: Wire,
) -> None:
    """It acknowledges the safe command and does not obey it; one that reports off is fed again,
    also beside values that are refused.
    """
    async with tcp.driven(1, **REPORTED) as one:
        peer = one.peer
        assert isinstance(peer, TcpPeer)
        peer.answer = lambda pdu: bytes((0x84, 4)) if pdu[0] == 4 else pdu
        one.port.send(SAFE_COMMAND)
        for _ in range(4):
            await asyncio.sleep(0.4)
            peer.hang_up()
        known = len(peer.writes)
        await until(lambda: len(peer.writes) > known + 10)
        assert len(set(beats(one, 2, known))) == 1
        peer.answer, peer.state, peer.speed = (lambda pdu: pdu), 2, math.nan
        known = len(peer.writes)
        await until(lambda: len(set(beats(one, 2, known))) > 3)


async def test_a_drive_that_never_reports_its_bridge_is_fed_at_rest_beside_refused_values(
    tcp: Wire,
) -> None:
    async with tcp.driven(1) as one:
        peer = one.peer
        assert isinstance(peer, TcpPeer)
        peer.speed = math.nan
        one.port.send(SAFE_COMMAND)
        for _ in range(4):  # the connections only pass the time in which it must obey
            await asyncio.sleep(0.4)
            peer.hang_up()
        known = len(peer.writes)
        await until(lambda: len(set(beats(one, 2, known))) > 3)


async def test_a_drive_at_rest_confirms_its_stop_by_the_bridge_beside_refused_values(
    wire: Wire,
) -> None:
    """All ones are no bridge."""
    fault = {
        "bus__registers__fault": "{ address = 5, table = 'input', bit = 1 }",
        "signals__fault": '"fault"',
    }
    async with wire.driven(1, **REPORTED, **fault) as one:
        one.peer.speed = math.nan
        await one.asks(12)
        good = one.ear.readings[-1]
        one.port.send(SAFE_COMMAND)
        one.peer.state = 0xFFFF
        await until(lambda: one.told() == [0, 0])
        await one.asks(12)
        assert one.ear.readings[-1].bridge_reported_s < one.port.safe_s
        one.peer.state = 2
        await one.hears(2)
        assert "output: " in one.port.explain_age()
        reading = one.ear.readings[-1]
    assert (reading.output, reading.oldest_s) == (good.output, good.oldest_s)
    assert (reading.bridge, reading.fault) == (False, 1)
    assert one.port.safe_s < reading.bridge_reported_s <= reading.arrival_s


@pytest.mark.parametrize("coded", ["uint16", "int16"])
async def test_a_register_without_a_value_confirms_no_stop(wire: Wire, coded: str) -> None:
    """A gateway gives all ones for a module that it does not reach; the other values are right."""
    register = f"{{ address = 5, table = 'input', type = '{coded}' }}"
    state = {
        "bus__registers__state": register,
        "bus__registers__closed": register,
        "signals__bridge": "{ signal = 'closed', on = 4 }",
    }
    async with wire.driven(4, **state) as one:
        one.peer.state = 0xFFFF
        one.port.send(SAFE_COMMAND)
        await until(lambda: one.told() == [0, 0])
        await one.asks(12)
        assert one.ear.readings[-1].bridge
        why = "bridge: input 5 (address from 0) holds ffff, its word for no value"
        assert why in one.port.explain_age()
        one.peer.state = 0
        await one.hears(2)
        assert not one.ear.readings[-1].bridge


async def test_a_drive_that_reports_its_stop_beside_refused_values_is_not_driven_on(
    wire: Wire,
) -> None:
    async with wire.driven(1, **REPORTED) as one:
        one.peer.speed, one.peer.state = math.nan, 0
        await one.asks(4)
        known = len(one.peer.writes)
        await one.asks(8)
        assert one.peer.writes[known:] == []
        assert (one.ear.readings[-1].bridge, one.ear.readings[-1].whole) == (False, False)
        one.peer.speed = 3.25
        await one.hears(2)
        assert one.peer.writes[known:] == []
        one.port.send(SAFE_COMMAND)
        await until(lambda: one.told() == [0, 0])
        assert one.port.complaint is None


@pytest.mark.parametrize("stops_unseen", [True, False])
async def test_a_drive_that_came_on_beside_refused_values_and_stopped_is_not_driven_on(
    wire: Wire, *, stops_unseen: bool
) -> None:
    async with wire.bench(**REPORTED) as one:
        one.peer.state = 0
        await one.hears(2)
        one.peer.speed, one.peer.state = math.nan, 1
        one.port.send(RUN)
        await until(lambda: bool(one.peer.writes))
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
        await until(lambda: one.told() == [0, 0])
        assert one.port.complaint is None


STANDING: dict[str, str | None] = {
    "bus__heartbeat__drive": '"state"',
    "bus__registers__on": "{ address = 0, table = 'input', bit = 2 }",
    "signals__bridge": '"on"',
}
"""Its heartbeat may stand; the bridge is a bit of the word of the voltage, here on."""
OFF = 30008


async def test_a_drive_whose_heartbeat_stands_still_gets_no_old_command(wire: Wire) -> None:
    """Its polls are answered, and give no reading: nothing is decided anew."""
    async with wire.driven(None, **STANDING) as one:
        one.peer.state = 1
        await one.asks(8)
        known = len(one.peer.writes)
        await one.asks(8)
        assert one.peer.writes[known:] == []
        one.peer.state = None
        await until(lambda: len(one.peer.writes) > known)
        assert one.port.complaint is None


async def test_a_drive_that_reports_its_stop_beside_a_standing_heartbeat_is_not_driven_on(
    wire: Wire,
) -> None:
    async with wire.driven(None, **STANDING) as one:
        one.peer.state = 1
        await one.asks(2)
        one.peer.voltage = OFF
        await one.asks(2)
        known = len(one.peer.writes)
        one.peer.state = None
        await one.hears(2)
        assert not one.ear.readings[-1].bridge
        assert one.peer.writes[known:] == []


async def test_a_drive_without_values_confirms_its_stop_over_a_new_link(wire: Wire) -> None:
    async with wire.bench(**REPORTED) as one:
        one.peer.state = 1
        one.port.send(RUN)
        await until(lambda: bool(one.ear.readings) and one.ear.readings[-1].bridge)
        await one.peer.stop()
        await until(lambda: bool(one.ear.bus) and not one.ear.bus[-1][0])
        good = one.ear.readings[-1]
        one.port.send(SAFE_COMMAND)
        one.peer.speed, one.peer.state = math.nan, 0
        await one.peer.start()
        await one.hears(2)
        reading = one.ear.readings[-1]
    assert (reading.output, reading.oldest_s) == (good.output, good.oldest_s)
    assert not reading.bridge
    assert one.port.safe_s < reading.bridge_reported_s


def beats(one: Bench, register: int, known: int) -> list[int]:
    """Heartbeats among the writes after the first so many."""
    return [
        words[register - address]
        for address, words in one.peer.writes[known:]
        if address <= register < address + len(words)
    ]


def slow(reply: bytes) -> Pieces:
    """A reply just before its time-out."""
    return [(0.7 * TIMEOUT_s, reply)]


async def test_a_drive_that_answers_slowly_gets_its_commands(wire: Wire) -> None:
    """Each reply takes less than its time-out, and the four of a poll more than two polls."""
    async with wire.bench(**SCATTERED) as one:
        one.peer.spoil = slow
        for voltage_V in (250.0, 260.0):
            told = [round(100.0 * voltage_V), 1]
            # a command that waits for too long on a busy machine is discarded: send it again
            while not one.peer.writes or one.told() != told:
                one.port.send(Command(0.0, voltage_V, bridge=True))
                await one.hears(1)


async def test_a_poll_that_missed_its_time_is_not_followed_by_a_pause(tcp: Wire) -> None:
    """Four exchanges take over two polls: the next poll begins at once, not at the third."""
    async with tcp.bench(**SCATTERED) as one, judged(0.1 * POLL_s):
        one.peer.spoil = lambda reply: [(0.5 * POLL_s, reply)]
        one.port.send(Command(0.0, 250.0, bridge=True))
        await one.hears(3)
        known = len(one.ear.readings)
        await one.hears(20)
        ends = [reading.arrival_s for reading in one.ear.readings[known - 1 :]]
        intervals_s = [end - begin for begin, end in pairwise(ends)]
        assert median(intervals_s) < 2.7 * POLL_s
