"""Commands of the live view under way to a daemon, over a real broker."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

from adaptdrive.config.services import Mqtt
from adaptdrive.runtime.requests import Disable, Reset
from adaptdrive.watch.keys import KeyCommand
from adaptdrive.watch.main import CommandsUnderWay, over_mqtt
from adaptdrive.watch.record import WatchRecord
from tests.operation.peers import PATIENCE_S, Bench, drive_report, serving
from tests.support import Broker


async def until_asked(bench: Bench, request: object) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while request not in bench.host.asked:  # noqa: ASYNC110 - the host has no event
            await asyncio.sleep(0.02)


async def test_nothing_that_was_asked_before_a_stop_acts_after_it(
    mosquitto: Broker, tmp_path: Path
) -> None:
    """An `enable` waits for telemetry to learn the clock, a `disable` does not."""
    record = WatchRecord("overtaken", time.monotonic)
    settings = Mqtt(host=mosquitto.host, port=mosquitto.port)
    under_way = CommandsUnderWay(over_mqtt(settings, record.drive, PATIENCE_S), record)
    async with serving(mosquitto, "overtaken", tmp_path) as bench:
        under_way.send(KeyCommand("enable"))
        under_way.send(KeyCommand("disable"))
        await until_asked(bench, Disable())
        under_way.send(KeyCommand("reset"))
        bench.hub.publish(drive_report(600))
        await until_asked(bench, Reset())
        await under_way.end()
    assert bench.host.asked == [Disable(), Reset()]


async def test_a_command_is_called_accepted_when_it_was_answered_and_not_before(
    mosquitto: Broker, tmp_path: Path
) -> None:
    record = WatchRecord("awaited", time.monotonic)
    settings = Mqtt(host=mosquitto.host, port=mosquitto.port)
    under_way = CommandsUnderWay(over_mqtt(settings, record.drive, PATIENCE_S), record)
    async with serving(mosquitto, "awaited", tmp_path) as bench:
        under_way.send(KeyCommand("enable"))
        under_way.send(KeyCommand("disable"))
        await asyncio.sleep(0)
        assert record.answer == "disable: sending…"
        ended = await under_way.end()
        assert record.answer == "disable: accepted"
    assert bench.host.asked == [Disable()]
    assert [line.split(": ")[:2] for line in ended] == [["awaited", "enable"]]
