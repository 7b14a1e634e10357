"""The newest command of a polled drive, on a link without a wire: what is written, and when."""

from __future__ import annotations

import math
from collections import Counter

import pytest

from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.devices.polled.commander import Commander
from adaptdrive.devices.polled.link import ExchangeError, OvertakenError, PolledLink, Void, never
from adaptdrive.devices.polled.registers import Exchange
from adaptdrive.devices.polled.reports import PollHistory
from adaptdrive.safety.monitor import Monitor
from adaptdrive.safety.timing import Timing
from tests.unit.devices.modbus.bench import plan, reported

RUN = Command(current_scale_S=0.0, boost_reference_V=287.65, bridge=True)
VOLTAGE, CONTROL = 0, 4
APART = reported({
    "bus__registers__control": "{ address = 4, table = 'holding' }",
    "bus__command_interval_s": "0.4",
})  # fmt: skip
REFUSAL = 4


class Link(PolledLink):
    """Writes to a drive that may refuse some registers.

    Attributes:
        written: Address and registers of each write.
        refused: Addresses that the drive refuses.
    """

    def __init__(self, now_s: list[float]) -> None:
        super().__init__("memory", 0.1, Counter(), lambda: now_s[0])
        self.written: list[tuple[int, list[int]]] = []
        self.refused: set[int] = set()

    async def _connect(self) -> None:
        """Connect nothing."""

    def suspect(self) -> None:
        """Suspect nothing."""

    async def exchange(
        self, exchange: Exchange, words: list[int], void: Void | None = never
    ) -> list[int]:
        if void is not None and void():
            raise OvertakenError("not sent")
        if exchange.write is None:
            return [0]
        self.written.append((exchange.write.address, words))
        if exchange.write.address in self.refused:
            raise ExchangeError("refused", REFUSAL)
        return []


class Bench:
    """A commander whose drive has reported its bridge off."""

    def __init__(self, slack_s: float | None = 0.0) -> None:
        self.now_s = [100.0]
        self.link = Link(self.now_s)
        poll, timing = plan(**APART), Timing(1.0 / 120.0, 0.25, 12)
        self.drive = Monitor(timing, lambda: self.now_s[0], slack_s=slack_s)
        self.history = PollHistory(self.drive, timing, 0.3, lambda: self.now_s[0])
        self.commander = Commander(poll, self.drive, self.history, Counter(), lambda: self.now_s[0])
        self.commander.begin()

    async def polled(self, *, powered: bool) -> None:
        """One poll, in which the drive reports its bridge."""
        self.now_s[0] += 0.1
        self.history.note_step()
        self.commander.begin_poll()
        self.history.reported_s = self.now_s[0]
        self.commander.note_read(answered=True)
        self.history.note_bridge(powered=powered)
        await self.commander.write(self.link)

    async def give(self, command: Command, *, powered: bool) -> list[int]:
        """Decide on a command, and poll; return the addresses that were written, in order."""
        self.commander.set(command)
        self.link.written.clear()
        await self.polled(powered=powered)
        return [address for address, _ in self.link.written]


async def test_a_stop_begins_with_the_switch_of_the_bridge() -> None:
    bench = Bench()
    assert await bench.give(RUN, powered=False) == [VOLTAGE, CONTROL]
    assert await bench.give(SAFE_COMMAND, powered=True) == [CONTROL, VOLTAGE]


async def test_a_refused_register_does_not_end_the_safe_command() -> None:
    bench = Bench()
    await bench.give(RUN, powered=False)
    bench.link.refused = {CONTROL}
    assert await bench.give(SAFE_COMMAND, powered=True) == [CONTROL, VOLTAGE]
    assert bench.commander.monitor.safe_s == math.inf
    bench.link.refused = {VOLTAGE}
    assert await bench.give(RUN, powered=True) == [VOLTAGE]  # what energises ends there


async def test_a_new_link_has_acknowledged_nothing() -> None:
    bench = Bench()
    await bench.give(SAFE_COMMAND, powered=False)
    assert bench.commander.monitor.safe_s == bench.now_s[0]
    assert not bench.commander.urgent
    bench.commander.begin()
    assert bench.commander.monitor.safe_s == math.inf
    assert bench.commander.urgent
    bench.link.written.clear()
    await bench.commander.leave_safe(bench.link)
    assert [address for address, _ in bench.link.written] == [CONTROL, VOLTAGE]


@pytest.mark.parametrize("powered", [True, False])
async def test_the_safe_command_is_written_anew_while_the_drive_is_on(powered: bool) -> None:
    bench = Bench()
    await bench.give(RUN, powered=False)
    await bench.give(SAFE_COMMAND, powered=True)
    bench.commander.set(SAFE_COMMAND)
    bench.link.written.clear()
    await bench.polled(powered=powered)
    assert bool(bench.link.written) == powered


async def test_a_command_from_before_a_standstill_is_void() -> None:
    """Nothing shows whether a drive that never reports its bridge has stopped meanwhile."""
    bench = Bench(slack_s=None)
    await bench.give(RUN, powered=True)
    bench.link.written.clear()
    bench.now_s[0] += 0.5
    await bench.commander.write(bench.link)
    assert bench.link.written == []
    bench.history.note_step()
    bench.commander.set(RUN)
    bench.now_s[0] += 0.1
    await bench.commander.write(bench.link)
    assert [address for address, _ in bench.link.written] == [VOLTAGE, CONTROL]
