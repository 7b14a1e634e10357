"""A broker whose access list keeps the commands from the daemon."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.operation.peers import ask, listening, publish, serving
from tests.support import Broker, MosquittoLauncher, stop_process

PLUGIN = "mosquitto_dynamic_security.so"
ALLOWED = dict.fromkeys(
    ("publishClientSend", "publishClientReceive", "subscribe", "unsubscribe"), True
)


def rights() -> dict[str, Any]:
    """Rights of everybody: `deaf` hears no commands or requests, `untried` no probe."""
    refused = [
        {"acltype": "subscribeLiteral", "topic": f"adaptdrive/{name}", "allow": False}
        for name in ("deaf/command/#", "deaf/ask/history", "untried/command/probe")
    ]
    return {
        "defaultACLAccess": ALLOWED,
        "roles": [{"rolename": "deaf", "acls": refused}],
        "groups": [{"groupname": "everybody", "roles": [{"rolename": "deaf"}]}],
        "anonymousGroup": "everybody",
        "clients": [],
    }


@pytest.fixture
def strict(
    mosquitto_launcher: MosquittoLauncher, tmp_path: Path, free_tcp_port: int
) -> Iterator[Broker]:
    """A broker that refuses subscriptions of the drives `deaf` and `untried`."""
    plugin = next(Path("/usr/lib").glob(f"**/{PLUGIN}"), None)
    if plugin is None:
        pytest.skip(f"{PLUGIN} is not installed")
    file = tmp_path / "rights.json"
    file.write_text(json.dumps(rights()), encoding="utf-8")
    more = f"plugin {plugin}\nplugin_opt_config_file {file}\nuser root\n"
    launcher = MosquittoLauncher(mosquitto_launcher.program, tmp_path, more)
    process = launcher.start(free_tcp_port)
    yield Broker("127.0.0.1", free_tcp_port)
    stop_process(process)


async def test_a_daemon_that_hears_no_commands_raises_an_alarm_once(
    strict: Broker, tmp_path: Path
) -> None:
    async with (
        listening(strict, "adaptdrive/deaf/event") as ear,
        serving(strict, "deaf", tmp_path) as bench,
    ):
        alarm = (await ear.on(bench.topic("event"))).content
        await publish(strict, bench.topic("event"), '{"kind": "end"}')
        assert (await ear.on(bench.topic("event"))).content == {"kind": "end"}
    assert (alarm["kind"], alarm["severity"]) == ("broker", "alarm")
    assert "no commands" in alarm["detail"]
    assert "adaptdrive/deaf/command/#" in alarm["detail"]


async def test_a_daemon_that_hears_its_commands_raises_none(strict: Broker, tmp_path: Path) -> None:
    async with (
        listening(strict, "adaptdrive/hearing/event") as ear,
        serving(strict, "hearing", tmp_path) as bench,
    ):
        assert (await ask(bench, "disable", '{"id": "a"}'))["accepted"]
        await publish(strict, bench.topic("event"), '{"kind": "end"}')
        assert (await ear.on(bench.topic("event"))).content == {"kind": "end"}


async def test_a_refused_subscription_to_the_probe_alone_raises_none(
    strict: Broker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("adaptdrive.operation.probe.PATIENCE_S", 0.5)
    async with (
        listening(strict, "adaptdrive/untried/event") as ear,
        serving(strict, "untried", tmp_path) as bench,
    ):
        await asyncio.sleep(1.5)
        assert (await ask(bench, "disable", '{"id": "a"}'))["accepted"]
        await publish(strict, bench.topic("event"), '{"kind": "end"}')
        assert (await ear.on(bench.topic("event"))).content == {"kind": "end"}
