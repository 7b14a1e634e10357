"""Each fault of the wire: what is counted, what is said, what the drive gets, and how it ends.

In every case no reading is older than it says or holds what was never measured, a safe command
reaches a drive that can still hear, and readings come again once the fault has gone.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
from collections.abc import AsyncIterator, Callable
from unittest.mock import ANY

import pytest

from adaptdrive.control.signals import SAFE_COMMAND
from adaptdrive.safety.interlocks import Limits, find_cause
from adaptdrive.safety.trips import Trip, TripKind
from adaptdrive.util.quantity import Display
from tests.unit.devices import memory
from tests.unit.devices.bench import until
from tests.unit.devices.modbus.bench import (
    FUNCTION_23,
    RUN,
    Bench,
    Peer,
    Pieces,
    TIMEOUT_s,
    benched,
    driven,
    framed,
    untouched,
)
from tests.unit.devices.modbus.spoils import (
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

pytestmark = pytest.mark.usefixtures("memory")
Fault = dict[str, object]
"""Attributes of the peer."""

APART: dict[str, str | None] = {"bus__registers__control": "{ address = 9, table = 'holding' }"}
"""A command of two writes."""

HEALTHY: Fault = {
    "speed": 3.25,
    "voltage": 30012,
    "state": None,
    "spoil": untouched,
    "answer": lambda pdu: pdu,
}

FAULTS: dict[str, tuple[Fault, str]] = {
    "tcp exception": ({"answer": exception}, "exceptions"),
    "tcp busy": ({"answer": busy}, "exceptions"),
    "rtu silence": ({"spoil": silence}, "timeouts"),
    "tcp late": ({"spoil": late}, "foreign"),
    "rtu late": ({"spoil": late}, "foreign"),
    "tcp cut": ({"spoil": cut}, "timeouts"),
    "rtu cut": ({"spoil": cut}, "wrong_length"),
    "rtu checksum": ({"spoil": flipped}, "wrong_checksum"),
    "rtu noise": ({"spoil": noisy}, "timeouts"),
    "rtu other device": ({"spoil": foreign_device}, "timeouts"),
    "tcp transaction": ({"spoil": other_transaction}, "foreign"),
    "tcp transaction 0": ({"spoil": no_transaction}, "foreign"),
    "tcp protocol": ({"spoil": other_protocol}, "timeouts"),
    "tcp fewer registers": ({"answer": fewer}, "foreign"),
    "rtu fewer registers": ({"answer": fewer}, "foreign"),
    "rtu other function": ({"answer": other_function}, "foreign"),
    "tcp NaN": ({"speed": math.nan}, "out_of_range"),
    "tcp infinite": ({"speed": math.inf}, "out_of_range"),
    "tcp out of range": ({"voltage": 60001}, "out_of_range"),
    "tcp not available": ({"voltage": 0xFFFF}, "out_of_range"),
    "tcp heartbeat stuck": ({"state": 0}, "counter_stuck"),
}


def make(peer: Peer, fault: Fault) -> None:
    for name, value in fault.items():
        setattr(peer, name, value)


@contextlib.asynccontextmanager
async def watched(kind: str = "tcp") -> AsyncIterator[Bench]:
    """A drive that shows a heartbeat and has been told to run."""
    async with driven(None, kind, bus__heartbeat__drive='"state"') as one:
        await one.hears(3)
        yield one


async def heals(one: Bench) -> None:
    """End a fault, and wait for honest readings."""
    make(one.peer, HEALTHY)
    await one.hears(3)
    one.check_honesty()


@pytest.mark.parametrize("name", FAULTS)
async def test_no_bad_value_is_used_and_the_drive_can_be_made_safe(name: str) -> None:
    fault, count = FAULTS[name]
    async with watched(name.partition(" ")[0]) as one:
        make(one.peer, fault)
        await one.asks(2)  # one that was under way, and the first that is spoiled
        heard = sum(reading.whole for reading in one.ear.readings)
        await until(lambda: getattr(one.port.statistics, count) >= 3)
        assert sum(reading.whole for reading in one.ear.readings) <= heard + 1
        one.port.send(SAFE_COMMAND)
        await one.is_told(0, 0)
        await heals(one)
        assert one.told() == [0, 0]


def kind_of(one: Bench) -> TripKind:
    """Return the kind of trip for which the values are old."""
    return one.port.explain_age().kind


EXPLAINED: dict[str, tuple[Fault, str]] = {
    "device": (
        {"spoil": lambda reply: [(0.0, reply[:6] + b"\xff" + reply[7:])]},
        "device 255 replied, asked was device 1",
    ),
    "transaction": ({"spoil": other_transaction}, "one to another transaction came"),
    "protocol": ({"spoil": other_protocol}, "one of protocol 1 came"),
    "cut": ({"spoil": cut}, "bytes of one came whose header says"),
    "range": ({"voltage": 60001}, "boost_voltage_V: input"),
    "no value": ({"voltage": 0xFFFF}, "holds ffff, its word for no value"),
    "not finite": ({"speed": math.nan}, "holds 7fc0 0000, nan: no finite number"),
}


@pytest.mark.parametrize("name", EXPLAINED)
async def test_what_came_in_place_of_a_value_is_named_with_its_place(name: str) -> None:
    fault, expected = EXPLAINED[name]
    async with watched() as one:
        make(one.peer, fault)
        await until(lambda: expected in str(one.port.explain_age()))
        limits = Limits(430.0, 5.0, Display("V"))
        cause = find_cause(None, math.inf, limits, 0.05, one.port.explain_age)
    assert cause is not None
    answered = name in {"range", "no value", "not finite"}
    assert cause.kind is (TripKind.VALUE_REFUSED if answered else TripKind.NO_REPLY)


@pytest.mark.parametrize(
    ("kind", "delay"), [("tcp", 1.5), ("rtu", 1.05), ("rtu", 1.5), ("rtu", 2.5)]
)
async def test_a_reply_that_is_late_never_answers_the_next_request(kind: str, delay: float) -> None:
    numbers = itertools.count()

    def now_and_then(reply: bytes) -> Pieces:
        return [(delay * TIMEOUT_s if next(numbers) % 5 == 0 else 0.0, reply)]

    async with benched(kind) as one:
        one.peer.spoil = now_and_then
        await until(lambda: one.port.statistics.timeouts >= 5)
        assert one.port.statistics.foreign >= 3
        await one.hears(3)
        one.check_honesty()


async def test_a_drive_that_does_not_answer_is_reported_and_its_return_too() -> None:
    async with watched("rtu") as one:
        one.peer.spoil = silence
        await one.hears_of_bus(up=False)
        make(one.peer, HEALTHY)
        await one.hears_of_bus(up=True)
        down, up = one.ear.bus
        assert "no reply within 0.04 s" in down[1]
        assert up[0]
        one.peer.spoil = lambda _: [(0.0, bytes((0, 1, 4)))]
        shown = "no reply within 0.04 s; bytes that are no reply: 00 01 04"
        await until(lambda: shown in str(one.port.explain_age()))
        assert kind_of(one) is TripKind.NO_REPLY


@pytest.mark.parametrize("kind", ["tcp", "rtu"])
async def test_a_reply_that_cannot_be_decoded_raises_nothing_in_the_event_loop(kind: str) -> None:
    raised: list[object] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, found: raised.append(found))
    async with watched(kind) as one:
        one.peer.answer = lambda _: b"\x80\x02"
        await until(lambda: one.port.statistics.timeouts >= 2)
        await heals(one)
    assert raised == []


@pytest.mark.parametrize("answer", [other_address, nothing_written])
async def test_a_reply_that_repeats_another_write_confirms_no_stop(
    answer: Callable[[bytes], bytes],
) -> None:
    async with watched() as one:
        one.peer.answer = answer
        one.port.send(SAFE_COMMAND)
        await until(lambda: one.port.trip_cause is not None)
        assert "a reply that belongs to another request" in str(one.port.trip_cause)
        assert one.port.monitor.safe_s == math.inf
        make(one.peer, HEALTHY)
        await until(lambda: one.port.monitor.safe_s < math.inf)


@pytest.mark.parametrize("kind", ["tcp", "rtu"])
async def test_commands_that_are_not_taken_for_reasons_in_turn_are_a_complaint(kind: str) -> None:
    async with watched(kind) as one:
        causes: list[Trip | None] = []

        def in_turn(pdu: bytes) -> bytes:
            if pdu[0] != 16:
                return pdu
            causes.append(one.port.trip_cause)
            return busy(pdu) if len(causes) % 2 == 1 else nothing_written(pdu)

        one.peer.answer = in_turn
        await one.runs_until(lambda: one.port.trip_cause is not None)
        assert causes.count(None) <= 6
        make(one.peer, HEALTHY)
        await one.runs_until(lambda: one.port.trip_cause is None)


async def test_a_busy_read_between_does_not_excuse_commands_that_are_not_taken() -> None:
    numbers = itertools.count()

    def sometimes_busy(pdu: bytes) -> bytes:
        if pdu[0] == 16:
            return nothing_written(pdu)
        return busy(pdu) if next(numbers) % 4 == 0 else pdu

    async with watched() as one:
        one.peer.answer = sometimes_busy
        await one.runs_until(lambda: one.port.trip_cause is not None)


async def test_a_half_open_connection_is_given_up_and_made_anew() -> None:
    """What the drive has not received is dropped with the connection."""
    async with watched() as one:
        one.peer.spoil = silence
        await until(lambda: one.peer.connections >= 2 and one.peer.dropped >= 1)
        assert "no reply" in one.ear.bus[0][1]
        await heals(one)
        assert one.ear.bus[-1][0] is True
        assert one.port.statistics.reconnects >= 1


async def test_a_gateway_that_wakes_its_line_before_its_first_reply_keeps_its_connection() -> None:
    asked_s: dict[int, float] = {}
    clock = asyncio.get_running_loop().time

    async with watched() as one:

        def asleep(reply: bytes) -> Pieces:
            woken_s = asked_s.setdefault(one.peer.connections, clock()) + 0.8
            return untouched(reply) if clock() > woken_s else []

        one.peer.spoil = asleep
        one.peer.hang_up()
        await until(lambda: one.peer.connections >= 2)
        await one.hears(3)
        assert one.peer.connections == 2
        one.check_honesty()


@pytest.mark.parametrize("kind", ["tcp", "rtu"])
async def test_a_restarted_server_and_an_adapter_put_back_are_found_again(kind: str) -> None:
    async with watched(kind) as one:
        one.peer.stop()
        await one.hears_of_bus(up=False)
        assert not one.port.send(SAFE_COMMAND)
        heard = len(one.ear.readings)
        await asyncio.sleep(0.1)
        assert len(one.ear.readings) == heard
        one.peer.writes.clear()
        one.peer.start()
        await one.hears(3)
        assert one.ear.bus[-1][0] is True
        assert {tuple(words[:2]) for _, words in one.peer.writes} == {(0, 0)}
        one.check_honesty()


async def test_a_device_that_closes_each_connection_at_once_is_found_again() -> None:
    """A gateway all of whose connections are in use takes each one, and closes it."""
    closed: list[asyncio.StreamWriter] = []

    async def close(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        closed.append(writer)
        writer.close()

    async with watched() as one:
        one.peer.stop()
        assert isinstance(one.peer.address, int)
        with memory.serving(one.peer.address, close):
            await until(lambda: len(closed) == 3)
        assert one.ear.bus[-1] == (False, ANY)
        one.peer.start()
        await one.hears(3)
        assert one.ear.bus[-1][0] is True


@pytest.mark.parametrize("delay_s", [0.0, 0.02])
async def test_a_repeated_reply_is_not_taken_for_that_to_the_next_read_for_long(
    delay_s: float,
) -> None:
    """Two blocks of the same length; the repetition comes before the reply to the second."""
    blocks = {"bus__max_block": "3", "bus__heartbeat__drive": '"state"'}
    async with driven(None, "rtu", **blocks) as one:
        one.peer.spoil = lambda reply: [(delay_s, reply), (0.01, reply)]
        await until(lambda: one.port.statistics.foreign >= 20)
        assert one.mixed_up() <= 1
        await until(lambda: "two devices with the same id" in str(one.port.explain_age()))
        assert kind_of(one) is TripKind.POLL_REFUSED
        make(one.peer, HEALTHY)
        await one.hears(2)
        one.ear.readings.clear()
        await one.hears(3)
        one.check_honesty()


@pytest.mark.parametrize("delay_s", [0.0, 0.002], ids=["with the reply", "before the reply"])
async def test_an_adapter_that_hears_what_it_sends_answers_no_request(delay_s: float) -> None:
    """A request for the one register 0x302 is a reply of three bytes, too."""
    kinds = {"voltage": ", scale = 0.01", "line": ", scale = 0.1", "power": "", "state": ""}
    kinds["speed"] = ", type = 'float32'"
    places = {"voltage": 0x300, "line": 0x301, "power": 0x302, "speed": 0x303, "state": 0x305}
    registers: dict[str, str | None] = {
        f"bus__registers__{name}": f"{{ address = {at}, table = 'input'{kinds[name]} }}"
        for name, at in places.items()
    }
    async with benched("rtu", **registers, bus__max_block="2") as one:

        def echoed(reply: bytes) -> Pieces:
            echo = framed(b"\x01" + one.peer.requests[-1])
            return [(0.0, echo), (delay_s, reply)] if delay_s else [(0.0, echo + reply)]

        one.peer.spoil = echoed
        await one.runs_until(lambda: one.told() == [28765, 1])
        await one.hears(5)
        one.check_honesty()


async def test_a_line_that_is_never_silent_gives_no_readings_and_still_takes_the_safe_command() -> (
    None
):
    async with watched("rtu") as one:

        async def babble() -> None:
            while True:
                one.peer.put(b"\x55")
                await asyncio.sleep(0.004)

        task = asyncio.create_task(babble())
        await until(lambda: one.port.statistics.foreign >= 10)
        heard = len(one.ear.readings)
        one.port.send(SAFE_COMMAND)
        await one.is_told(0, 0)
        assert len(one.ear.readings) == heard
        task.cancel()
        await one.hears(3)
        one.check_honesty()


async def test_a_command_that_waits_for_silence_gives_way_to_the_safe_command() -> None:
    async with watched("rtu") as one:
        one.peer.spoil = silence
        await until(lambda: one.port.statistics.timeouts >= 1)
        known = len(one.peer.writes)
        one.port.send(SAFE_COMMAND)
        await until(lambda: len(one.peer.writes) >= known + 2)
        assert {tuple(registers[:2]) for _, registers in one.peer.writes[known:]} == {(0, 0)}


@pytest.mark.parametrize("changes", [{}, FUNCTION_23])
async def test_a_late_reply_to_another_command_confirms_no_stop(
    changes: dict[str, str | None],
) -> None:
    async with driven(None, "rtu", **changes) as one:

        def late_to_run(reply: bytes) -> Pieces:
            if reply[1] == 4:
                return untouched(reply)
            return late(reply) if one.told()[1] == 1 else silence(reply)

        one.peer.spoil = late_to_run
        await until(lambda: one.port.statistics.timeouts >= 1)
        one.port.send(SAFE_COMMAND)
        await one.is_told(0, 0)
        await one.asks(6)
        assert one.port.monitor.safe_s == math.inf
        one.peer.spoil = untouched
        await until(lambda: one.port.monitor.safe_s < math.inf)
        one.check_honesty()


async def test_the_rest_of_a_command_gives_way_to_the_safe_command() -> None:
    async with benched(**APART) as one:

        def stop(reply: bytes) -> bytes:
            if (0, [28765]) in one.peer.writes:
                one.port.send(SAFE_COMMAND)
            return reply

        one.peer.answer = stop
        one.port.send(RUN)
        await one.hears(3)
        assert (0, [28765]) in one.peer.writes
        assert (9, [1]) not in one.peer.writes


async def test_a_stop_reaches_a_drive_that_hangs_up_at_a_write_of_its_set_point() -> None:
    async with benched(**APART) as one:
        peer = one.peer

        def hang_up(reply: bytes) -> bytes:
            if one.told() == [0] and peer.writes[-1][0] == 0:
                peer.writes.clear()
                peer.hang_up()
            return reply

        await one.runs_until(lambda: (9, [1]) in peer.writes)
        peer.answer = hang_up
        one.port.send(SAFE_COMMAND)
        await until(lambda: (9, [0]) in peer.writes)


@pytest.mark.parametrize("connects_anew", [True, False])
async def test_a_heartbeat_may_be_slower_than_the_polls_where_that_is_said(
    *, connects_anew: bool
) -> None:
    """One that stands still shows no life on a new connection."""
    slow = {"bus__heartbeat__drive": '"state"', "bus__heartbeat__drive_timeout_s": "0.4"}
    async with benched(**slow) as one:
        one.peer.state = 7
        if connects_anew:
            one.peer.stop()
            await one.hears_of_bus(up=False)
            one.peer.start()
            heard = len(one.ear.readings)
            await one.asks(6)
        else:
            await one.hears(4)
            await until(lambda: one.port.statistics.counter_stuck >= 2)
            assert kind_of(one) is TripKind.HEARTBEAT_STANDS
            heard = len(one.ear.readings)
            await one.asks(6)
        assert len(one.ear.readings) == heard
        one.peer.state = 8
        await one.hears(2)
