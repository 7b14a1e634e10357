"""A drive that was commanded on, and of which nothing is heard for longer than it may stay on."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from adaptdrive.app.settings import daemon_settings
from adaptdrive.devices.canopen.profile import (
    DISABLE_VOLTAGE,
    ENABLE_OPERATION,
    SWITCH_ON,
    DriveControl,
)
from adaptdrive.safety.timing import Timing
from tests.unit.devices.bench import until
from tests.unit.devices.canopen.bench import CHARGE, RUN, running
from tests.unit.devices.canopen.documents import bus_of, flaws, parse
from tests.unit.devices.canopen.peer import ENABLED, READY, REST, SWITCHED_ON, Peer
from tests.unit.runtime.bench import FAST, running_bench

HALF_CYCLE_S = 1.0 / 120.0
TIMEOUT_S = 0.1
TIMING = Timing(HALF_CYCLE_S, stale_s=0.05, command_timeout_s=TIMEOUT_S)


class Drive:
    """A control on a clock that only the test moves."""

    def __init__(self) -> None:
        self.control = DriveControl(TIMING.reported_seldom_s)
        self.now_s = 0.0
        for statusword in (REST, READY, SWITCHED_ON):
            self.report(statusword)
            self.word = self.command()

    def report(self, statusword: int, after_s: float = HALF_CYCLE_S) -> None:
        self.now_s += after_s
        self.control.follow(statusword, self.now_s)

    def command(self, after_s: float = 0.0) -> int:
        self.now_s += after_s
        return self.control.controlword(RUN, self.now_s)


def test_a_drive_that_may_have_come_on_and_stopped_in_a_silence_is_not_commanded_on_again() -> None:
    drive = Drive()
    assert drive.word == ENABLE_OPERATION
    drive.report(SWITCHED_ON, after_s=0.12)
    assert drive.command() == DISABLE_VOLTAGE
    assert "nothing was heard of it for 120 ms" in str(drive.control.fallen)


def test_it_gets_no_command_to_come_on_before_it_has_reported() -> None:
    drive = Drive()
    assert drive.command(after_s=0.12) == DISABLE_VOLTAGE


@pytest.mark.parametrize("missing", [1, 2, 4])
def test_a_drive_that_is_slow_to_come_on_may_lose_reports(missing: int) -> None:
    drive = Drive()
    for _ in range(30):
        drive.report(SWITCHED_ON, after_s=(1 + missing) * HALF_CYCLE_S)
        assert drive.command() == ENABLE_OPERATION
    drive.report(ENABLED)
    assert drive.control.fallen is None


def test_a_drive_that_is_on_after_a_silence_goes_on() -> None:
    drive = Drive()
    drive.report(ENABLED, after_s=0.12)
    assert drive.command() == ENABLE_OPERATION


def test_a_silence_before_it_is_commanded_on_stops_nothing() -> None:
    control = DriveControl(TIMING.reported_seldom_s)
    for number, statusword in enumerate((REST, READY, SWITCHED_ON)):
        control.follow(statusword, 10.0 * number)
        control.controlword(CHARGE, 10.0 * number + 5.0)
    assert control.controlword(CHARGE, 25.0) == SWITCH_ON


async def test_the_port_complains_of_a_drive_that_was_silent_while_it_was_commanded_on() -> None:
    peer = Peer()
    try:
        async with running(peer, heartbeat_timeout_s=1.0, heartbeat_s=0.1) as bench:
            await bench.ready()
            bench.ear.command = CHARGE
            await until(lambda: peer.statusword == SWITCHED_ON)
            peer.obeys = False  # it is slow to come on
            bench.ear.command = RUN
            await until(lambda: peer.words[-1:] == [ENABLE_OPERATION])
            peer.silent = {1}
            await asyncio.sleep(1.2)
            peer.silent = set()
            assert "nothing was heard of it for" in await bench.complains("nothing was heard")
            await until(lambda: peer.words[-1:] == [DISABLE_VOLTAGE])
    finally:
        peer.close()


def test_the_time_out_from_a_command_on_is_that_of_a_heartbeat_sent_long_before() -> None:
    bus = bus_of(parse({"bus/heartbeat_s": 0.03, "bus/heartbeat_timeout_s": 0.1}))
    assert bus.command_timeout_s == pytest.approx(0.07)


def test_three_heartbeats_in_a_row_may_be_lost_unless_the_file_says_otherwise() -> None:
    bus = bus_of(parse({"bus/heartbeat_s": None, "bus/heartbeat_timeout_s": None}))
    assert bus.heartbeat_timeout_s > 4.0 * bus.heartbeat_s


def test_a_time_out_that_ends_between_two_commands_is_refused() -> None:
    found = flaws({"bus/heartbeat_s": 0.01, "bus/heartbeat_timeout_s": 0.02})
    assert "must be at least 0.0225 s" in found["bus.heartbeat_timeout_s"]
    assert not flaws({"bus/heartbeat_s": 0.01, "bus/heartbeat_timeout_s": 0.0225})


async def test_a_daemon_that_slept_for_longer_than_the_drive_misses_its_heartbeat_waits() -> None:
    """A single command ends a quick stop, into which the drive may have gone meanwhile."""
    watched = {"bus/heartbeat_s": 0.01, "bus/heartbeat_timeout_s": 0.04}
    timing = daemon_settings(parse({**watched, "interlocks/stale_s": 0.1})).fast.timing
    async with running_bench(replace(FAST, timing=timing), frames=10) as bench:
        deadline_s, known = bench.around.deadline_s, len(bench.sent)
        bench.around.now = deadline_s + 0.04
        bench.loop.on_deadline(deadline_s)
        assert bench.sent[known:] == []
        bench.frame(0.0, bridge=True)
        assert bench.sent[-1].bridge
