"""Reports reach those who asked for them; whoever is slow loses the oldest."""

from __future__ import annotations

import asyncio

from adaptdrive.runtime.hub import Hub
from adaptdrive.runtime.reports import Event, LoadReport, Severity
from tests.runtime.bench import decision, snapshot


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


async def test_taking_waits_for_the_first_report() -> None:
    hub = Hub()
    events = hub.subscribe(Event, size=9)
    taking = asyncio.create_task(events.take())
    await asyncio.sleep(0)
    assert not taking.done()
    hub.publish(event(7))
    assert await taking == (event(7),)
    assert events.drain() == ()


def test_reports_that_nobody_wants_are_no_trouble() -> None:
    Hub().publish(event(1))
