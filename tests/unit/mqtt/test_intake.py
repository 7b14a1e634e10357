"""Reports on their way to the broker: recorded first, stamped, and counted where they overflow."""

from __future__ import annotations

import asyncio
from datetime import UTC, datetime

import pytest

from adaptdrive.mqtt.contract import Output
from adaptdrive.mqtt.publisher import REPORTS_HELD, History, Intake, Outbox, StateBoard
from adaptdrive.runtime.reports import Event, Hub, Severity
from tests.unit.mqtt.memory_broker import MemoryBroker
from tests.unit.mqtt.peers import STANDBY, Bench, listening, profile

NOW = datetime(2026, 1, 1, tzinfo=UTC)
TRIP = Event("trip", Severity.ALARM, "over-speed", 7)


def make_intake(hub: Hub) -> Intake:
    wall = lambda: NOW  # noqa: E731
    board = StateBoard(wall, profile("motor"), None)
    outbox, history = Outbox((), lambda: None), History(lambda: 0.0)
    return Intake(hub, board, outbox, history, wall, Output("speed", "V"))


@pytest.fixture
def hub() -> Hub:
    return Hub()


async def test_an_event_reaches_no_client_before_it_is_recorded(
    broker: MemoryBroker, bench: Bench
) -> None:
    recorded = asyncio.Event()
    bench.hub.kept = recorded.wait  # type: ignore[assignment]
    async with listening(broker, bench.topic("event")) as ear:
        hearing = asyncio.create_task(ear.on(bench.topic("event")))
        bench.hub.publish(TRIP)
        await asyncio.sleep(5.0)
        assert not hearing.done()
        recorded.set()
        assert (await hearing).content["tick"] == 7


async def test_an_event_whose_record_is_awaited_at_the_end_is_not_lost(hub: Hub) -> None:
    hub.kept = asyncio.Event().wait  # type: ignore[assignment]
    intake = make_intake(hub)
    running = asyncio.create_task(intake.run())
    hub.publish(TRIP)
    await asyncio.sleep(0)
    hub.publish(TRIP)
    running.cancel()
    await asyncio.wait([running])
    intake.catch_up()
    assert len(intake.outbox) == 2


async def test_reports_that_overflowed_are_told(broker: MemoryBroker, bench: Bench) -> None:
    """With the next event, once."""
    async with listening(broker, bench.topic("event")) as ear:
        for _ in range(REPORTS_HELD + 44):
            bench.hub.publish(STANDBY)
        bench.hub.publish(TRIP)
        told = await ear.until(lambda message: message.content["kind"] == "outbox")
        bench.hub.publish(TRIP)
        bench.hub.publish(Event("state", Severity.INFO, "last", 9))
        await ear.until(lambda message: message.content["tick"] == 9)
    assert told.content["severity"] == "warning"
    assert told.content["detail"].startswith("45 events or other reports were discarded: at most ")
    assert [message.content["kind"] for message in ear.heard].count("outbox") == 1
