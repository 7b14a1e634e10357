"""A broker whose access list refuses messages of the daemon."""

from __future__ import annotations

import asyncio
import os
import shutil
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from adaptdrive.config.services import Mqtt
from adaptdrive.operation.profile import Profile
from adaptdrive.operation.service import MqttService, ServiceSurroundings
from adaptdrive.runtime.reports import Event, Severity
from tests.operation.peers import RememberingHost
from tests.runtime.bench import until
from tests.support import Spawn


@pytest.fixture
def refusing(tmp_path: Path, free_tcp_port: int, spawn: Spawn) -> Mqtt:
    """Settings of a broker that takes no events of the drive `refused`."""
    program = shutil.which("mosquitto", path=f"{os.environ['PATH']}:/usr/sbin")
    if program is None:
        pytest.skip("mosquitto is not installed")
    rights, conf = tmp_path / "rights", tmp_path / "mosquitto.conf"
    rights.write_text("topic readwrite #\ntopic deny adaptdrive/refused/event\n")
    conf.write_text(
        f"listener {free_tcp_port} 127.0.0.1\nallow_anonymous true\nacl_file {rights}\nuser root\n"
    )
    spawn(program, "-c", conf)
    return Mqtt(port=free_tcp_port)


async def test_messages_that_the_broker_refuses_are_logged_once(
    refusing: Mqtt, tmp_path: Path
) -> None:
    host = RememberingHost()
    surroundings = ServiceSurroundings(tmp_path, uniform=lambda low, _: 0.1 * low)
    service = MqttService(Profile("refused"), refusing, host, host.hub, surroundings)
    with capture_logs() as lines:

        def refused() -> list[str]:
            found = [str(line) for line in lines if "refuses to deliver" in line["event"]]
            host.hub.publish(Event("trip", Severity.ALARM, "stale", len(found)))
            return found

        running = asyncio.create_task(service.run())
        await until(lambda: bool(refused()))
        for _ in range(20):
            refused()
            await asyncio.sleep(0.02)
        assert len(refused()) == 1
        assert "Not authorized" in refused()[0]
    running.cancel()
    await asyncio.wait([running])
