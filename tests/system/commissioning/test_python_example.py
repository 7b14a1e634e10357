"""The example of docs/python.md that commands a running drive."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from adaptdrive.mqtt import connection
from tests.support import Broker
from tests.unit.analysis.test_python_page import examples
from tests.unit.mqtt.peers import load_report, serving

pytestmark = pytest.mark.proof


async def test_the_example_on_a_running_drive_runs(mosquitto: Broker, tmp_path: Path) -> None:
    names: dict[str, Any] = {}
    exec(examples()[1], names)
    broker = connection.Broker(host=mosquitto.host, port=mosquitto.port)
    async with serving(mosquitto, "motor", tmp_path) as bench, asyncio.TaskGroup() as group:
        stepping = group.create_task(names["step"](broker))
        while not stepping.done():
            bench.hub.publish(load_report(7))
            await asyncio.sleep(0.05)
        assert isinstance(stepping.result(), float)
