"""A healthy drive whose line loses or repeats replies, or whose daemon stands still.

The drive stops by itself without commands. Everything is judged by counts of thousands of polls.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
import random
from collections.abc import AsyncIterator, Callable, Mapping

import pytest

from adaptdrive.config.root import ModbusRtuSensors
from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.devices.modbus import build_modbus_sensors
from adaptdrive.safety.facts import Reading
from tests.unit.devices.modbus.bench import (
    FUNCTION_23,
    Bench,
    Peer,
    Pieces,
    build,
    framed,
    ran,
    reported,
    stand_still,
    untouched,
)
from tests.unit.devices.modbus.spoils import nothing_written
from tests.unit.devices.modbus.test_sensors import COMMON as SENSORS

pytestmark = pytest.mark.usefixtures("memory")
Changes = dict[str, str | None]
BOTH_WAYS = pytest.mark.parametrize("changes", [{}, FUNCTION_23], ids=["apart", "function-23"])

POLLS = 1500
LOST_SHARE = 0.05
STARVED = 8
"""Reads without a command in between: five replies in a row are lost before, or it is held back."""

REPEATED = 20
"""The request whose reply is repeated, or one soon after."""

APART_s = 0.0015
"""Time after a reply at which its copy comes, before the next request."""

TIMEOUT_s = 0.15
STANDSTILL_s = 0.3
SHORTEST_s = 0.077
"""A time-out little above the shortest that is accepted, one and a half polls."""

SLOW_s = 0.005
"""Delay of each reply with which the five exchanges of a poll take most of its time."""

UNSEEN_s = 0.1
"""Time since a stop at which no report of a bridge that is on is good any more."""

INSTANTS = 60
"""Looks at the clock after which the daemon stands still, one run each: a few polls."""

LATE_s = 0.03
"""Delay of each reply with which a reply and the silence before it take more than two polls."""

COMMANDS = 3
"""Commands after which the looks are counted: the drive has reported its bridge on."""


class HealthyDrive(Peer):
    """A drive that reports its bridge on; it counts for how many reads it was not fed.

    Attributes:
        longest: The highest of those counts.
    """

    def __init__(self, kind: str, first: int) -> None:
        super().__init__(kind, first)
        self.state = 1
        self._unfed = self.longest = 0

    def reply(self, request: bytes) -> bytes:
        self._unfed = 0 if request[0] in {16, 23} else self._unfed + 1
        self.longest = max(self.longest, self._unfed)
        return super().reply(request)


@contextlib.asynccontextmanager
async def commanded(kind: str, changes: Changes) -> AsyncIterator[tuple[Bench, HealthyDrive]]:
    """Command a healthy drive on with each reading; no reading may come with a cause to trip."""
    peer = HealthyDrive(kind, 10 if changes else 0)
    one = Bench(build(**{**peer.link, **reported(changes)}), peer)

    def decide(reading: Reading) -> None:
        assert one.port.trip_cause is None
        assert reading.bridge
        one.port.send(Command(0.0, 250.0 + len(one.ear.readings) % 100, bridge=True))

    one.ear.decide = decide
    peer.start()
    async with ran(one):
        yield one, peer


async def enough(condition: Callable[[], bool]) -> None:
    """Look at a condition now and then until it holds."""
    async with asyncio.timeout(1000.0):
        while not condition():  # noqa: ASYNC110 - virtual time
            await asyncio.sleep(1.0)


@BOTH_WAYS
@pytest.mark.parametrize("kind", ["tcp", "rtu"])
async def test_five_lost_replies_in_a_hundred_neither_trip_nor_starve(
    kind: str, changes: Changes
) -> None:
    draw = random.Random(5)
    async with commanded(kind, changes) as (one, peer):
        peer.spoil = lambda reply: [] if draw.random() < LOST_SHARE else untouched(reply)
        await enough(lambda: len(one.ear.readings) > POLLS)
    assert one.port.statistics.timeouts > 0.5 * LOST_SHARE * POLLS
    assert one.port.statistics.reconnects == 0
    assert peer.longest < STARVED
    assert len({words[0] for _, words in peer.writes}) > 99


@BOTH_WAYS
@pytest.mark.parametrize("size", [1, 5, 8, 99])
async def test_an_adapter_that_hears_its_request_in_pieces_costs_no_reply(
    size: int, changes: Changes
) -> None:
    """The event loop wakes up at a byte, and reads what has come until then."""
    async with commanded("rtu", changes) as (one, peer):

        def echoed(reply: bytes) -> Pieces:
            sent = framed(b"\x01" + peer.requests[-1])
            echo = [(0.0001, sent[at : at + size]) for at in range(0, len(sent), size)]
            return [*echo, (0.0001, reply)]

        peer.spoil = echoed
        await enough(lambda: len(peer.requests) > POLLS // 3)
    counts = one.port.statistics
    assert (counts.timeouts, counts.wrong_checksum, counts.foreign, counts.send_drops) == (0,) * 4
    assert len(peer.writes) >= len(one.ear.readings) > POLLS // 10


async def test_a_drive_seen_before_a_line_that_repeats_fell_silent_is_read_again() -> None:
    """The command waits for the silence, and the drive's own time-out may end meanwhile."""
    spoiled: list[int] = []
    async with commanded("rtu", {}) as (_, peer):

        def repeated(reply: bytes) -> Pieces:
            if spoiled or len(peer.requests) < REPEATED or peer.requests[-1][0] == 16:
                return untouched(reply)
            spoiled.append(len(peer.requests))
            return [(0.0, reply), (APART_s, reply)]

        peer.spoil = repeated
        await enough(lambda: bool(spoiled) and len(peer.requests) > spoiled[0] + 3)
    functions = [request[0] for request in peer.requests[spoiled[0] :]]
    assert functions[0] in {3, 4}
    assert functions[1] == 16


class SensorEar:
    """Counts the values of two registers that are those of the other one."""

    def __init__(self) -> None:
        self.mixed_up = 0

    def on_values(self, values: Mapping[str, float], _: float) -> None:
        own = {"number": values.get("number") != 30012, "voltage": values.get("voltage") == 300.12}
        self.mixed_up += not all(own[name] for name in own.keys() & values.keys())

    def on_bus(self, up: bool, detail: str) -> None:
        """Take note of nothing."""


async def test_a_sensor_line_that_repeats_each_reply_mixes_up_one_value() -> None:
    """The copy comes when the next cycle has begun: it passed for the reply to its first read."""
    peer, ear = Peer("rtu"), SensorEar()
    peer.spoil = lambda reply: [(0.002, reply), (0.02, reply)]
    line = {"type": "modbus-rtu", "device": peer.address, "baud": 115200, "form": "8N1"}
    cycle = {"cycle_s": 0.05, "timeout_s": 0.024, "max_gap": 0, "max_block": 2}
    config = ModbusRtuSensors.model_validate(SENSORS | line | cycle)
    port = build_modbus_sensors(config, "sensor_bus.0", asyncio.get_running_loop().time)
    peer.start()
    task = asyncio.create_task(port.run(ear))
    await asyncio.sleep(60.0)
    task.cancel()
    await asyncio.wait([task])
    assert port.statistics.foreign > 100
    assert ear.mixed_up <= 1


class WatchedDrive(Peer):
    """A drive that obeys the level of its switch, and opens its bridge without commands.

    Attributes:
        revived_s: Times for which it had stopped by itself when it was switched on again.
        fed: Commands that it took while it was on.
    """

    def __init__(self, first: int, timeout_s: float) -> None:
        super().__init__("rtu", first)
        self._timeout_s = timeout_s
        self._fed_s = 0.0
        self._stopped_s: float | None = None
        self._clock = asyncio.get_running_loop().time
        self.state = 0
        self.revived_s: list[float] = []
        self.fed = 0

    def reply(self, request: bytes) -> bytes:
        if self.state and self._clock() - self._fed_s > self._timeout_s:
            self.state, self._stopped_s = 0, self._fed_s + self._timeout_s
        return super().reply(request)

    def _write(self, head: bytes, data: bytes) -> None:
        super()._write(head, data)
        now_s, on = self._clock(), self.writes[-1][1][1]
        self.fed += bool(self.state)
        if on and self._stopped_s is not None:
            self.revived_s.append(now_s - self._stopped_s)
        self._fed_s, self.state, self._stopped_s = now_s, on, None


class Rig(Bench):
    """A port whose drive watches its commands.

    Attributes:
        drive: The drive.
        stands_at: Number of the look at the clock at which the daemon stands still.
        decisions: Readings that are followed by a command.
    """

    def __init__(self, changes: Changes, timeout_s: float) -> None:
        self.drive = WatchedDrive(10 if "bus__write" in changes else 0, timeout_s)
        self._looks, self._been_on, self.stands_at, self.decisions = 0, False, -1, math.inf
        port = build(self._clock, **{**self.drive.link, **reported(changes)})
        super().__init__(port, self.drive)
        self.ear.decide = self._decide

    def _clock(self) -> float:
        self._looks += self.drive.fed >= COMMANDS
        if self._looks == self.stands_at:
            stand_still(STANDSTILL_s)
        return asyncio.get_running_loop().time()

    def _decide(self, reading: Reading) -> None:
        if len(self.ear.readings) > self.decisions:
            return
        stopped = self._been_on and not reading.bridge
        self._been_on = self._been_on or reading.bridge
        wanted = Command(0.0, 250.0 + len(self.ear.readings) // 50, bridge=True)
        self.port.send(SAFE_COMMAND if stopped or self.port.trip_cause else wanted)

    async def run(self, seconds: float) -> None:
        self.drive.start()
        async with ran(self):
            await asyncio.sleep(seconds)


@BOTH_WAYS
async def test_a_drive_that_stopped_in_a_standstill_is_not_energised_unseen(
    changes: Changes,
) -> None:
    """Wherever the daemon stood still, with the reply to a read or a write in its buffer, too."""
    revived = dict[int, list[float]]()
    for instant in range(1, INSTANTS):
        rig = Rig(changes, TIMEOUT_s)
        rig.stands_at = instant
        await rig.run(2.0)
        assert rig.drive.fed >= COMMANDS
        if any(unseen_s > UNSEEN_s for unseen_s in rig.drive.revived_s):
            revived[instant] = rig.drive.revived_s
    assert sorted(revived) == []


@BOTH_WAYS
async def test_the_shortest_time_out_lets_no_healthy_drive_stop(changes: Changes) -> None:
    """Commands that now go with the read, now after it, would be two polls apart."""
    scattered = {"bus__max_block": "2", "bus__max_gap": "0"}
    known = {**changes, **scattered, "bus__command_timeout_s": str(SHORTEST_s)}
    rig = Rig(known, SHORTEST_s)
    rig.drive.spoil = lambda reply: [(SLOW_s, reply)]
    await rig.run(20.0)
    assert rig.drive.revived_s == []
    assert rig.drive.fed > 300


async def test_a_wait_for_a_silent_line_is_no_standstill() -> None:
    """A command stays valid while the line must be silent, as after a reply to another request."""
    numbers = itertools.count(1)

    def sometimes_another(pdu: bytes) -> bytes:
        return nothing_written(pdu) if pdu[0] == 16 and next(numbers) % 4 == 0 else pdu

    rig = Rig({}, 1.0)
    rig.drive.spoil, rig.drive.answer = lambda reply: [(LATE_s, reply)], sometimes_another
    rig.decisions = 1
    await rig.run(2.0)
    assert next(numbers) > 12
