"""Each fault of the wire: what is counted, what is said, what the drive gets, and how it ends.

In every case no reading is older than it says or holds what was never measured, a safe command
reaches a drive that can still hear, and readings come again once the fault has gone.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
import socket
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from unittest.mock import ANY

import pytest

from adaptdrive.control.signals import SAFE_COMMAND
from adaptdrive.runtime.interlocks import Limits, find_cause
from adaptdrive.runtime.trips import remedy
from tests.hardware.bench import PATIENCE_S, until
from tests.hardware.modbus.bench import (
    FUNCTION_23,
    RUN,
    Bench,
    Peer,
    Pieces,
    QUIET_s,
    RtuPeer,
    Spoil,
    TcpPeer,
    TIMEOUT_s,
    Wire,
    framed,
    judged,
    untouched,
)
from tests.hardware.modbus.spoils import (
    busy,
    cut,
    exception,
    fewer,
    flipped,
    foreign_device,
    late,
    no_transaction,
    noisy,
    nothing_written,
    other_address,
    other_function,
    other_protocol,
    other_transaction,
    silence,
)

Fault = Callable[[Peer], None]
HELD_UP_s = 0.002
REPEATED_s = 0.04
"""Time from a reply to its repetition: only a standstill for as long lets both come at once."""
FLOAT = ", type = 'float32'"
SLOW: dict[str, str | None] = {
    "bus__poll_ticks": "24",
    "bus__timeout_s": "0.15",
    "load__latency_ticks": "24",
    "load__period_s": "1.0",
    "interlocks__stale_s": "1.0",
}


def spoiled(spoil: Spoil) -> Fault:
    def set_in(peer: Peer) -> None:
        peer.spoil = spoil

    return set_in


def answered(answer: Callable[[bytes], bytes]) -> Fault:
    def set_in(peer: Peer) -> None:
        peer.answer = answer

    return set_in


def measuring(**values: object) -> Fault:
    def set_in(peer: Peer) -> None:
        for name, value in values.items():
            setattr(peer, name, value)

    return set_in


FAULTS: dict[str, tuple[str, Fault, str]] = {
    "tcp exception": ("tcp", answered(exception), "exceptions"),
    "rtu exception": ("rtu", answered(exception), "exceptions"),
    "tcp busy": ("tcp", answered(busy), "exceptions"),
    "rtu silence": ("rtu", spoiled(silence), "timeouts"),
    "tcp late": ("tcp", spoiled(late), "foreign"),
    "rtu late": ("rtu", spoiled(late), "foreign"),
    "tcp cut": ("tcp", spoiled(cut), "timeouts"),
    "rtu cut": ("rtu", spoiled(cut), "wrong_length"),
    "rtu checksum": ("rtu", spoiled(flipped), "wrong_checksum"),
    "rtu noise": ("rtu", spoiled(noisy), "timeouts"),
    "rtu other device": ("rtu", spoiled(foreign_device), "timeouts"),
    "tcp transaction": ("tcp", spoiled(other_transaction), "foreign"),
    "tcp transaction 0": ("tcp", spoiled(no_transaction), "foreign"),
    "tcp protocol": ("tcp", spoiled(other_protocol), "timeouts"),
    "tcp fewer registers": ("tcp", answered(fewer), "foreign"),
    "rtu fewer registers": ("rtu", answered(fewer), "foreign"),
    "tcp other function": ("tcp", answered(other_function), "foreign"),
    "rtu other function": ("rtu", answered(other_function), "foreign"),
    "tcp NaN": ("tcp", measuring(speed=float("nan")), "out_of_range"),
    "rtu infinite": ("rtu", measuring(speed=float("inf")), "out_of_range"),
    "tcp out of range": ("tcp", measuring(voltage=60001), "out_of_range"),
    "rtu not available": ("rtu", measuring(voltage=0xFFFF), "out_of_range"),
    "tcp heartbeat stuck": ("tcp", measuring(state=0), "counter_stuck"),
    "rtu heartbeat stuck": ("rtu", measuring(state=0), "counter_stuck"),
}
HEALTHY = measuring(
    speed=3.25, voltage=30012, state=None, spoil=lambda reply: [(0.0, reply)], answer=lambda a: a
)


@contextlib.asynccontextmanager
async def watched(wire: Wire) -> AsyncIterator[Bench]:
    """A drive that shows a heartbeat and has been told to run."""
    async with wire.bench(bus__heartbeat__drive='"state"') as one:
        one.port.send(RUN)
        await one.hears(3)
        await one.runs_until(lambda: bool(one.peer.writes))
        yield one


def whole_readings(one: Bench) -> int:
    """Return how many readings had no older value in place of a bad one."""
    return sum(reading.whole for reading in one.ear.readings)


@pytest.mark.parametrize("name", FAULTS)
async def test_no_bad_value_is_used_and_the_drive_can_be_made_safe(
    name: str, tmp_path: Path, free_tcp_port: int
) -> None:
    kind, fault, count = FAULTS[name]
    async with watched(Wire(kind, tmp_path, free_tcp_port)) as one, judged(QUIET_s):
        fault(one.peer)
        await one.asks(2)  # one that was under way, and the first that is spoiled
        heard = whole_readings(one)
        await until(
            lambda: getattr(one.port.statistics, count) >= 3 or whole_readings(one) > heard + 1
        )
        assert whole_readings(one) <= heard + 1  # looked at once, while a standstill is known
        one.port.send(SAFE_COMMAND)
        await until(lambda: one.told() == [0, 0])
        HEALTHY(one.peer)
        await one.hears(3)
        one.check_honesty()
        assert one.told() == [0, 0]


def tcp_device(number: int) -> Spoil:
    return lambda reply: [(0.0, reply[:6] + bytes((number,)) + reply[7:])]


EXPLAINED: dict[str, tuple[Fault, str]] = {
    "device": (spoiled(tcp_device(255)), "device 255 replied, asked was device 1"),
    "transaction": (spoiled(other_transaction), "one to another transaction came"),
    "protocol": (spoiled(other_protocol), "one of protocol 1 came"),
    "cut": (spoiled(cut), "bytes of one came whose header says"),
    "range": (measuring(voltage=60001), "boost_voltage_V: input"),
    "no value": (measuring(voltage=0xFFFF), "holds ffff, its word for no value"),
    "not finite": (measuring(speed=float("nan")), "holds 7fc0 0000, nan: no finite number"),
}


@pytest.mark.parametrize("name", EXPLAINED)
async def test_what_came_in_place_of_a_value_is_named_with_its_place(tcp: Wire, name: str) -> None:
    fault, expected = EXPLAINED[name]
    async with watched(tcp) as one:
        fault(one.peer)
        await until(lambda: expected in one.port.explain_age())
        limits = Limits(430.0, 5.0, "V")
        cause = find_cause(None, math.inf, limits, 0.05, one.port.explain_age)
    assert cause is not None
    assert remedy(cause).startswith("check the register map")


@pytest.mark.parametrize("delay", [1.05, 1.5, 2.5])
async def test_a_reply_that_is_late_never_answers_the_next_request(
    wire: Wire, delay: float
) -> None:
    numbers = itertools.count()

    def now_and_then(reply: bytes) -> Pieces:
        return [(delay * TIMEOUT_s if next(numbers) % 5 == 0 else 0.0, reply)]

    permitted_s = QUIET_s - delay * TIMEOUT_s if wire.kind == "rtu" else math.inf
    async with wire.bench() as one, judged(permitted_s):
        one.peer.spoil = now_and_then

        def enough() -> bool:
            one.check_honesty()  # looked at once, while a standstill is known
            return one.port.statistics.timeouts >= 5 and one.port.statistics.foreign >= 3

        await until(enough)
        await one.hears(3)
        one.check_honesty()


@pytest.mark.parametrize("delay", [1.2, 1.8, 2.4])
async def test_replies_that_are_always_late_are_never_taken_for_later_ones(
    rtu: Wire, delay: float
) -> None:
    """Each comes while the next request would be waiting, if the port did not wait for silence."""
    permitted_s = QUIET_s - delay * TIMEOUT_s
    async with rtu.bench() as one, judged(permitted_s):
        one.peer.spoil = lambda reply: [(delay * TIMEOUT_s, reply)]
        await one.asks(2)
        heard = len(one.ear.readings)

        def enough() -> bool:
            one.check_honesty()  # looked at once, while a standstill is known
            assert len(one.ear.readings) <= heard + 1
            return one.port.statistics.timeouts >= 5

        await until(enough)
        HEALTHY(one.peer)
        await one.hears(3)
        one.check_honesty()


async def test_bytes_that_are_no_reply_are_shown(rtu: Wire) -> None:
    async with watched(rtu) as one:
        one.peer.spoil = lambda _: [(0.0, bytes((0, 1, 4)))]
        shown = "no reply within 0.04 s; bytes that are no reply: 00 01 04"
        await until(lambda: shown in one.port.explain_age())
        HEALTHY(one.peer)
        await one.hears(1)


async def test_a_drive_that_does_not_answer_is_reported_and_its_return_too(rtu: Wire) -> None:
    async with watched(rtu) as one:
        one.peer.spoil = silence
        await until(lambda: bool(one.ear.bus))
        HEALTHY(one.peer)
        await until(lambda: len(one.ear.bus) == 2)
        down, up = one.ear.bus
        assert down[0] is False
        assert "no reply within 0.04 s" in down[1]
        assert up[0] is True


async def test_a_reply_that_cannot_be_decoded_raises_nothing_in_the_event_loop(wire: Wire) -> None:
    raised: list[object] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, found: raised.append(found))
    async with watched(wire) as one:
        one.peer.answer = lambda _: b"\x80\x02"
        await until(lambda: one.port.statistics.timeouts >= 2)
        HEALTHY(one.peer)
        await one.hears(3)
    assert raised == []


@pytest.mark.parametrize("answer", [other_address, nothing_written])
async def test_a_reply_that_repeats_another_write_confirms_no_stop(
    wire: Wire, answer: Callable[[bytes], bytes]
) -> None:
    async with watched(wire) as one:
        one.peer.answer = answer
        one.port.send(SAFE_COMMAND)
        await until(lambda: one.port.complaint is not None)
        assert "a reply that belongs to another request" in str(one.port.complaint)
        assert one.port.safe_s == math.inf
        HEALTHY(one.peer)
        await until(lambda: one.port.safe_s < math.inf)


async def test_commands_that_are_not_taken_for_reasons_in_turn_are_a_complaint(wire: Wire) -> None:
    async with watched(wire) as one, judged(QUIET_s):
        complaints: list[str | None] = []

        def in_turn(pdu: bytes) -> bytes:
            if pdu[0] != 16:
                return pdu
            complaints.append(one.port.complaint)
            return busy(pdu) if len(complaints) % 2 == 1 else nothing_written(pdu)

        one.peer.answer = in_turn
        await one.runs_until(lambda: one.port.complaint is not None)
        assert complaints.count(None) <= 6
        HEALTHY(one.peer)
        await one.runs_until(lambda: one.port.complaint is None)


async def test_a_busy_read_between_does_not_excuse_commands_that_are_not_taken(tcp: Wire) -> None:
    numbers = itertools.count()

    def sometimes_busy(pdu: bytes) -> bytes:
        if pdu[0] == 16:
            return nothing_written(pdu)
        return busy(pdu) if next(numbers) % 4 == 0 else pdu

    async with watched(tcp) as one:
        one.peer.answer = sometimes_busy
        await one.runs_until(lambda: one.port.complaint is not None)


async def test_an_exception_is_named(tcp: Wire) -> None:
    async with watched(tcp) as one:
        one.peer.answer = exception
        await until(lambda: bool(one.ear.bus))
        assert "exception reply 2 to function 4 (illegal address), input " in one.ear.bus[0][1]
        refused = [line for line in one.port.details() if line.startswith("refused: ")]
        assert "illegal address" in refused[0]


async def test_a_half_open_connection_is_given_up_and_made_anew(tcp: Wire) -> None:
    async with watched(tcp) as one:
        peer = one.peer
        assert isinstance(peer, TcpPeer)
        peer.spoil = silence
        await until(lambda: peer.connections >= 2 and peer.resets >= 1)
        assert "no reply" in one.ear.bus[0][1]
        HEALTHY(one.peer)
        await one.hears(3)
        assert one.ear.bus[-1][0] is True
        assert one.port.statistics.reconnects >= 1
        one.check_honesty()


async def test_a_gateway_that_wakes_its_line_before_its_first_reply_keeps_its_connection(
    tcp: Wire,
) -> None:
    asked_s: dict[int, float] = {}

    async with watched(tcp) as one:
        peer = one.peer
        assert isinstance(peer, TcpPeer)

        def asleep(reply: bytes) -> Pieces:
            woken_s = asked_s.setdefault(peer.connections, time.monotonic()) + 0.8
            return untouched(reply) if time.monotonic() > woken_s else []

        peer.spoil = asleep
        peer.hang_up()
        await until(lambda: peer.connections >= 2)
        await one.hears(3)
        assert peer.connections == 2
        one.check_honesty()


async def test_a_restarted_server_and_an_adapter_put_back_are_found_again(wire: Wire) -> None:
    async with watched(wire) as one:
        await one.peer.stop()
        await until(lambda: bool(one.ear.bus))
        assert one.ear.bus[0][0] is False
        assert not one.port.send(SAFE_COMMAND)
        heard = len(one.ear.readings)
        await asyncio.sleep(0.1)
        assert len(one.ear.readings) == heard
        one.peer.writes.clear()
        await one.peer.start()
        await one.hears(3)
        assert one.ear.bus[-1][0] is True
        assert {tuple(words[:2]) for _, words in one.peer.writes} == {(0, 0)}
        one.check_honesty()


async def test_a_device_that_closes_each_connection_at_once_is_found_again(tcp: Wire) -> None:
    async with watched(tcp) as one, sluggish_loop():
        assert isinstance(one.peer, TcpPeer)
        await one.peer.stop()
        await asyncio.to_thread(close_at_once, tcp.tcp_port, 3)
        assert one.ear.bus[-1] == (False, ANY)
        await one.peer.start()
        await one.hears(3)
        assert one.ear.bus[-1][0] is True
        one.check_honesty()


def close_at_once(port: int, times: int) -> None:
    """Be a gateway all of whose connections are in use: take each one, and close it."""
    with socket.create_server(("127.0.0.1", port)) as server:
        server.settimeout(PATIENCE_S)
        for _ in range(times):
            server.accept()[0].close()


@contextlib.asynccontextmanager
async def sluggish_loop() -> AsyncIterator[None]:
    """Let the far end of a connection act in the middle of each step of this process."""

    async def hold_up() -> None:
        while True:
            time.sleep(HELD_UP_s)  # noqa: ASYNC251 - it is to hold up the event loop
            await asyncio.sleep(0)

    task = asyncio.create_task(hold_up())
    try:
        yield
    finally:
        task.cancel()


async def test_a_repeated_reply_is_not_taken_for_that_to_the_next_read_for_long(rtu: Wire) -> None:
    """Two blocks of the same length; the repetition comes before the reply to the second."""
    blocks = {"bus__max_block": "3", "bus__heartbeat__drive": '"state"', **SLOW}
    async with rtu.bench(**blocks) as one, judged(REPEATED_s):
        await one.runs_until(lambda: bool(one.peer.writes))

        def is_mixed_up() -> bool:
            begun = 1 + one.port.statistics.timeouts  # one without a reply begins anew
            return one.mixed_up() > begun

        one.peer.spoil = lambda reply: [(1.5 * REPEATED_s, reply), (REPEATED_s, reply)]
        await until(lambda: one.port.statistics.foreign >= 20 or is_mixed_up())
        assert not is_mixed_up()  # looked at once, while a standstill is known
        await until(lambda: "two devices with the same id" in one.port.explain_age())
        HEALTHY(one.peer)
        await one.hears(2)
        one.ear.readings.clear()
        await one.hears(3)
        one.check_honesty()


@pytest.mark.parametrize("at_once", [False, True], ids=["before the reply", "with the reply"])
async def test_an_adapter_that_hears_what_it_sends_answers_no_request(
    rtu: Wire, at_once: bool
) -> None:
    """A request for the one register 0x302 is a reply of three bytes, too."""
    names = {"voltage": ", scale = 0.01", "line": ", scale = 0.1", "power": "", "speed": FLOAT}
    registers: dict[str, str | None] = {
        f"bus__registers__{name}": f"{{ address = {0x300 + at}, table = 'input'{rest} }}"
        for at, (name, rest) in enumerate(names.items())
    }
    registers["bus__registers__state"] = "{ address = 0x305, table = 'input' }"
    apart = {"bus__max_block": "2", **SLOW, **registers}
    async with rtu.bench(**apart) as one:

        def echoed(reply: bytes) -> Pieces:
            echo = framed(b"\x01" + one.peer.requests[-1])
            return [(0.0, echo + reply)] if at_once else [(0.0, echo), (0.002, reply)]

        one.peer.spoil = echoed
        one.port.send(RUN)
        await one.hears(5)
        assert one.told() == [28765, 1]
        one.check_honesty()


async def test_noise_between_the_exchanges_is_waited_out(rtu: Wire) -> None:
    async with watched(rtu) as one:
        assert isinstance(one.peer, RtuPeer)
        for _ in range(10):
            one.peer.put(b"\x01\x04\x0c\x75\x30")
            await asyncio.sleep(0.02)
        await one.hears(3)
        assert one.port.statistics.foreign >= 1
        one.check_honesty()


async def test_a_line_that_is_never_silent_gives_no_readings_and_still_takes_the_safe_command(
    rtu: Wire,
) -> None:
    async with watched(rtu) as one:
        peer = one.peer
        assert isinstance(peer, RtuPeer)

        async def babble() -> None:
            while True:
                peer.put(b"\x55")
                await asyncio.sleep(0.004)

        task = asyncio.create_task(babble())
        await until(lambda: one.port.statistics.foreign >= 10)
        one.port.send(SAFE_COMMAND)
        await until(lambda: one.told() == [0, 0])
        task.cancel()
        await one.hears(3)
        one.check_honesty()


async def test_a_command_that_waits_for_silence_gives_way_to_the_safe_command(rtu: Wire) -> None:
    async with watched(rtu) as one:
        await until(lambda: one.told()[1] == 1)
        one.peer.spoil = silence
        await until(lambda: one.port.statistics.timeouts >= 1)
        known = len(one.peer.writes)
        one.port.send(SAFE_COMMAND)
        await until(lambda: len(one.peer.writes) >= known + 2)
        assert {tuple(registers[:2]) for _, registers in one.peer.writes[known:]} == {(0, 0)}


@pytest.mark.parametrize("changes", [{}, FUNCTION_23])
async def test_a_late_reply_to_another_command_confirms_no_stop(
    rtu: Wire, changes: dict[str, str | None]
) -> None:
    async with rtu.bench(**changes) as one:
        await one.runs_until(lambda: bool(one.peer.writes) and one.told()[1] == 1)

        def late_to_run(reply: bytes) -> Pieces:
            if reply[1] == 4:
                return untouched(reply)
            return late(reply) if one.told()[1] == 1 else silence(reply)

        one.peer.spoil = late_to_run
        await until(lambda: one.port.statistics.timeouts >= 1)
        one.port.send(SAFE_COMMAND)
        await until(lambda: one.told()[1] == 0)
        await one.asks(6)
        assert one.port.safe_s == math.inf
        one.peer.spoil = untouched
        await until(lambda: one.port.safe_s < math.inf)
        one.check_honesty()


async def test_the_rest_of_a_command_gives_way_to_the_safe_command(tcp: Wire) -> None:
    apart = {"bus__registers__control": "{ address = 9, table = 'holding' }"}
    async with tcp.bench(**apart) as one:
        known = len(one.peer.writes)

        def stop(reply: bytes) -> bytes:
            if any(registers[0] == 28765 for _, registers in one.peer.writes[known:]):
                one.port.send(SAFE_COMMAND)
            return reply

        one.peer.answer = stop
        one.port.send(RUN)
        await one.hears(3)
        assert (0, 28765) in [(at, registers[0]) for at, registers in one.peer.writes[known:]]
        assert (9, [1]) not in one.peer.writes


async def test_a_stop_reaches_a_drive_that_hangs_up_at_a_write_of_its_set_point(tcp: Wire) -> None:
    apart = {"bus__registers__control": "{ address = 9, table = 'holding' }"}
    async with tcp.bench(**apart) as one:
        peer = one.peer
        assert isinstance(peer, TcpPeer)

        def hang_up(reply: bytes) -> bytes:
            if peer.writes and peer.writes[-1] == (0, [0]):
                peer.writes.clear()
                peer.hang_up()
            return reply

        await one.runs_until(lambda: (9, [1]) in peer.writes)
        peer.answer = hang_up
        one.port.send(SAFE_COMMAND)
        await until(lambda: (9, [0]) in peer.writes)


async def test_a_heartbeat_that_stands_still_shows_no_life_on_a_new_connection(tcp: Wire) -> None:
    slow = {"bus__heartbeat__drive": '"state"', "bus__heartbeat__drive_timeout_s": "2.0"}
    async with tcp.bench(**slow) as one:
        assert isinstance(one.peer, TcpPeer)
        one.peer.state = 7
        await one.peer.stop()
        await until(lambda: bool(one.ear.bus))
        heard = len(one.ear.readings)
        await one.peer.start()
        await one.asks(6)
        assert len(one.ear.readings) == heard
        one.peer.state = 8
        await one.hears(2)


async def test_a_heartbeat_may_be_slower_than_the_polls_where_that_is_said(tcp: Wire) -> None:
    slow = {"bus__heartbeat__drive": '"state"', "bus__heartbeat__drive_timeout_s": "0.4"}
    async with tcp.bench(**slow) as one:
        one.peer.state = 7
        await one.hears(4)
        await until(lambda: one.port.statistics.counter_stuck >= 2)
        heard = len(one.ear.readings)
        one.peer.state = 8
        await one.hears(2)
        assert len(one.ear.readings) >= heard + 2
