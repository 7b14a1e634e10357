"""A broker whose access list refuses messages of the daemon, or delivers it no commands."""

from __future__ import annotations

import asyncio
import os
import shutil
import signal
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from adaptdrive.config.services import Mqtt
from adaptdrive.operation.messages import Profile
from adaptdrive.operation.service import MqttService, ServiceSurroundings
from adaptdrive.runtime.hub import Subscription
from adaptdrive.runtime.reports import Event, Severity
from tests.operation.peers import RememberingHost
from tests.runtime.bench import until
from tests.support import Spawn, captured_lines


class Strict:
    """A mosquitto with an access list for everybody."""

    def __init__(self, folder: Path, port: int, spawn: Spawn) -> None:
        self.settings = Mqtt(port=port)
        self._rights, self._conf = folder / "rights", folder / "mosquitto.conf"
        self._spawn = spawn

    def start(self, *rights: str) -> None:
        program = shutil.which("mosquitto", path=f"{os.environ['PATH']}:/usr/sbin")
        if program is None:
            pytest.skip("mosquitto is not installed")
        self._write(*rights)
        self._conf.write_text(
            f"listener {self.settings.port} 127.0.0.1\nallow_anonymous true\n"
            f"acl_file {self._rights}\nuser root\n"
        )
        self._process = self._spawn(program, "-c", self._conf)

    def change(self, *rights: str) -> None:
        """Let it read another list, as `systemctl reload mosquitto` does."""
        self._write(*rights)
        self._process.send_signal(signal.SIGHUP)

    def _write(self, *rights: str) -> None:
        self._rights.write_text("".join(f"topic {right}\n" for right in rights))


@pytest.fixture
def strict(tmp_path: Path, free_tcp_port: int, spawn: Spawn) -> Strict:
    return Strict(tmp_path, free_tcp_port, spawn)


@asynccontextmanager
async def serving(strict: Strict) -> AsyncIterator[RememberingHost]:
    """Serve the drive `refused`."""
    host = RememberingHost()
    surroundings = ServiceSurroundings(uniform=lambda low, _: 0.1 * low)
    service = MqttService(Profile("refused"), strict.settings, host, host.hub, surroundings)
    running = asyncio.create_task(service.run())
    try:
        yield host
    finally:
        running.cancel()
        await asyncio.wait([running])


async def test_messages_that_the_broker_refuses_are_logged_once(
    strict: Strict, tmp_path: Path
) -> None:
    strict.start("readwrite #", "deny adaptdrive/refused/event")
    with captured_lines() as lines:
        async with serving(strict) as host:

            def refused() -> list[str]:
                found = [str(line) for line in lines if "refuses to deliver" in line["event"]]
                host.hub.publish(Event("trip", Severity.ALARM, "stale", len(found)))
                return found

            await until(lambda: bool(refused()))
            for _ in range(20):
                refused()
                await asyncio.sleep(0.02)
            assert len(refused()) == 1
            assert "Not authorized" in refused()[0]


def broker_events(reports: Subscription) -> list[tuple[Severity, str]]:
    """Events of the broker since the last call."""
    events = [one for one in reports.drain() if isinstance(one, Event) and one.kind == "broker"]
    return [(one.severity, one.detail) for one in events]


async def test_a_daemon_whose_commands_are_not_delivered_raises_an_alarm(
    strict: Strict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """mosquitto accepts its subscription; the list is right at first, then wrong, then right."""
    monkeypatch.setattr("adaptdrive.operation.session.PROBE_EVERY_S", 0.1)
    monkeypatch.setattr("adaptdrive.operation.probe.PATIENCE_S", 2.0)
    strict.start("readwrite #")
    async with serving(strict) as host:
        reports, seen = host.hub.subscribe(Event, size=100), list[tuple[Severity, str]]()

        def grown(count: int) -> bool:
            seen.extend(broker_events(reports))
            return len(seen) >= count

        await asyncio.sleep(1.0)
        assert not grown(1)
        strict.change("write #")
        await until(lambda: grown(1))
        strict.change("readwrite #")
        await until(lambda: grown(2))
    (alarm, text), (end, again) = seen
    assert (alarm, end) == (Severity.ALARM, Severity.INFO)
    assert "no commands" in text
    assert "adaptdrive/refused/command/probe" in text
    assert again == "commands arrive again"


async def test_a_broker_that_refuses_the_probe_raises_no_alarm(
    strict: Strict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its access list is one of before the probe; the refusal loses nothing and is not logged."""
    monkeypatch.setattr("adaptdrive.operation.session.PROBE_EVERY_S", 0.1)
    monkeypatch.setattr("adaptdrive.operation.probe.PATIENCE_S", 0.5)
    strict.start("readwrite #", "deny adaptdrive/refused/command/probe")
    with captured_lines() as lines:
        async with serving(strict) as host:
            reports = host.hub.subscribe(Event, size=100)
            await until(lambda: any(line["event"] == "broker connected" for line in lines))
            await asyncio.sleep(2.0)
            assert broker_events(reports) == []
    assert not [line for line in lines if "refuses to deliver" in line["event"]]
