"""The slow loop, the hub of reports, and the line that the service manager shows."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from types import SimpleNamespace
from typing import cast

import pytest

from adaptdrive.control.signals import Decision, Mode, Snapshot
from adaptdrive.runtime.accounts import Announcer, status_line
from adaptdrive.runtime.daemon import Daemon
from adaptdrive.runtime.fast_loop import FastLoop
from adaptdrive.runtime.program import Programs
from adaptdrive.runtime.reports import (
    Event,
    Hub,
    LoadReport,
    Severity,
    State,
    StateReport,
    StopWord,
)
from adaptdrive.runtime.state_machine import Machine
from adaptdrive.runtime.tick_support import ServiceManager
from adaptdrive.safety.trips import Trip, TripKind
from tests.unit.runtime.bench import (
    MACHINE,
    MotorController,
    decision,
    idle_daemon,
    snapshot,
    until,
)

Decided = list[tuple[Snapshot, Decision]]


class Decider(MotorController):
    """Answers each snapshot with its own number."""

    def decide(self, snapshot: Snapshot) -> Decision:
        if snapshot.k < 0:
            raise ArithmeticError("k is negative")
        return decision(snapshot.k, 200.0 + snapshot.k)


@contextlib.asynccontextmanager
async def deciding(daemon: Daemon) -> AsyncIterator[None]:
    task = asyncio.create_task(daemon._decide_for_ever())
    try:
        yield
    finally:
        task.cancel()
        await asyncio.wait([task])


@pytest.fixture
def delivered() -> Decided:
    return []


@pytest.fixture
def slow(delivered: Decided) -> Daemon:
    fast = SimpleNamespace(deliver=lambda *pair: delivered.append(pair))
    machine = Machine(MACHINE)
    return idle_daemon(machine, cast(FastLoop, fast), lambda: 0.0, Decider())


async def test_snapshots_are_decided_in_their_order(slow: Daemon, delivered: Decided) -> None:
    async with deciding(slow):
        for k in range(1, 10):
            assert slow.snapshot_taken(snapshot(k))
            await asyncio.sleep(0)
        await until(lambda: len(delivered) == 9)
    assert [taken.k for taken, _ in delivered] == list(range(1, 10))
    assert [made.boost_reference_V for _, made in delivered] == [201.0 + k for k in range(9)]


async def test_offering_never_waits_and_says_when_it_is_hopeless(slow: Daemon) -> None:
    taken = [slow.snapshot_taken(snapshot(k)) for k in range(5)]
    assert taken == [True, True, True, False, False]


async def test_what_is_forgotten_is_never_decided(slow: Daemon, delivered: Decided) -> None:
    async with deciding(slow):
        await asyncio.sleep(0)
        slow.snapshot_taken(snapshot(1))
        slow.run_ended()
        slow.snapshot_taken(snapshot(2))
        await until(lambda: bool(delivered))
    assert [taken.k for taken, _ in delivered] == [2]


async def test_a_failing_decision_ends_the_loop(slow: Daemon) -> None:
    slow.snapshot_taken(snapshot(-1))
    with pytest.raises(ArithmeticError):
        await slow._decide_for_ever()


def event(number: int) -> Event:
    return Event("test", Severity.INFO, f"number {number}", number)


LOAD = LoadReport(snapshot(1), decision(1, 300.0))


async def test_each_subscriber_gets_every_report_of_its_kinds() -> None:
    hub = Hub()
    events, everything = hub.subscribe(Event, size=9), hub.subscribe(Event, LoadReport, size=9)
    hub.publish(event(1))
    hub.publish(LOAD)
    hub.publish(event(2))
    assert await events.take() == (event(1), event(2))
    assert await everything.take() == (event(1), LOAD, event(2))


async def test_a_full_queue_loses_its_oldest_and_counts() -> None:
    hub = Hub()
    slow, quick = hub.subscribe(Event, size=2), hub.subscribe(Event, size=9)
    for number in range(5):
        hub.publish(event(number))
    assert slow.drain() == (event(3), event(4))
    assert slow.dropped == 3
    assert (len(quick.drain()), quick.dropped) == (5, 0)


TRIP = "over-voltage: v_bst = 431.0 V, limit 430 V"
LOST = "socketcan can0: [Errno 100] Network is down"
STALE = Trip(TripKind.STALE, "stale: measurement is 1272 ms old, limit 50 ms")


@pytest.mark.parametrize(
    ("state", "bus_problem", "cause", "line"),
    [
        (State.STANDBY, None, None, "standby, waiting for enable"),
        (State.STANDBY, None, STALE, "standby, waiting for the drive (stale)"),
        (State.STANDBY, LOST, STALE, f"standby, waiting for the drive ({LOST})"),
        (State.STARTING, None, None, "starting, waiting for the boost voltage"),
        (State.TRIPPED, None, None, f"tripped, waiting for reset: {TRIP}"),
        (State.TRIPPED, None, STALE, f"tripped, waiting for its cause to go (stale): {TRIP}"),
        (State.RUNNING, None, None, "running, fixed controller: warming up"),
    ],
)
def test_it_says_what_is_awaited(
    state: State, bus_problem: str | None, cause: Trip | None, line: str
) -> None:
    report = StateReport(
        state=state,
        mode=Mode.ADAPTIVE,
        controller=Mode.FIXED,
        reason="warming up",
        enabled=state in (State.STARTING, State.RUNNING),
        setpoint=3.0,
        waveform=None,
        pole=0.7,
        trip=TRIP if state is State.TRIPPED else None,
    )
    assert status_line(report, bus_problem, cause) == line


@pytest.mark.parametrize(("recorded", "rest"), [(True, ""), (False, "; recording has failed")])
def test_it_says_that_recording_has_failed(recorded: bool, rest: str) -> None:
    shown: list[str] = []
    fast = SimpleNamespace(stopping=SimpleNamespace(status=StopWord.AWAITED), cause=None)
    manager, programs = SimpleNamespace(status=shown.append), Programs(Machine(MACHINE), MACHINE)
    announcer = Announcer(
        programs, cast(FastLoop, fast), Hub(), cast(ServiceManager, manager), lambda: recorded
    )
    announcer.update_manager()
    assert shown == [f"standby, waiting for enable{rest}"]
