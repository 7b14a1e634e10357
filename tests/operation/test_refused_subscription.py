"""A broker whose access list keeps the commands from the daemon."""

from __future__ import annotations

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


def rights(drive: str) -> dict[str, Any]:
    """Rights of everybody: all but to hear the commands and the requests for the history."""
    refused = [
        {"acltype": "subscribeLiteral", "topic": f"adaptdrive/{drive}/{name}", "allow": False}
        for name in ("command/#", "ask/history")
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
    """A broker that refuses the subscription to the commands of the drive `deaf`."""
    plugin = next(Path("/usr/lib").glob(f"**/{PLUGIN}"), None)
    if plugin is None:
        pytest.skip(f"{PLUGIN} is not installed")
    file = tmp_path / "rights.json"
    file.write_text(json.dumps(rights("deaf")), encoding="utf-8")
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
