"""A `disable` acts whatever its payload says, and is examined afterwards."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import Disable, Enable, Request, SetSetpoint
from tests.operation.peers import (
    PATIENCE_S,
    Bench,
    RememberingHost,
    ask,
    listening,
    publish,
    serving,
)
from tests.support import Broker

EXPIRED = '{"id": "x", "expires": "2001-01-01T00:00:00Z"}'


@pytest.fixture
async def bench(
    mosquitto: Broker, tmp_path: Path, request: pytest.FixtureRequest
) -> AsyncIterator[Bench]:
    async with serving(mosquitto, f"stop-{abs(hash(request.node.nodeid))}", tmp_path) as running:
        yield running


async def asked(bench: Bench, *wanted: Request) -> None:
    """Wait until the host was asked for exactly this."""
    async with asyncio.timeout(PATIENCE_S):
        while bench.host.asked != list(wanted):  # noqa: ASYNC110 - the host has no event
            await asyncio.sleep(0.01)


@pytest.mark.parametrize(
    "payload",
    ["", "{}", "OFF", "0", "[]", b"\xff\x00\xfe", '{"id": null}', "{" * 9000, b"\x00" * 100_000],
)
async def test_a_stop_without_an_id_acts(bench: Bench, payload: str | bytes) -> None:
    reply = await ask(bench, "disable", payload)
    assert (reply["id"], reply["accepted"]) == (None, True)
    await asked(bench, Disable())


@pytest.mark.parametrize(
    ("payload", "flaw"),
    [
        ('{"id": "x"}', ""),
        (EXPIRED, "expired"),
        ('{"id": "x", "value": 3}', "Expected `null`"),
        ('{"id": "x", "force": true}', "unknown field"),
        ('{"id": "x", ', "not JSON"),
        ('{"id": "x", "value": "%s"}' % ("v" * 9000), "at most 8192"),
    ],
)
async def test_a_stop_acts_and_then_hears_its_flaw(bench: Bench, payload: str, flaw: str) -> None:
    await ask(bench, "enable", '{"id": "on"}')
    reply = await ask(bench, "disable", payload)
    assert flaw in reply["reason"]
    assert bool(flaw) is bool(reply.pop("reason"))
    assert reply == {"id": "x", "verb": "disable", "accepted": True, "state": "standby"}
    await asked(bench, Enable(), Disable())


async def test_a_stop_with_a_used_id_acts_each_time(bench: Bench) -> None:
    await ask(bench, "enable", '{"id": "a"}')
    reply = await ask(bench, "disable", '{"id": "a"}')
    assert (reply["accepted"], reply["state"]) == (True, State.STANDBY)
    assert "was used by 'enable'" in reply["reason"]
    await ask(bench, "disable", '{"id": "b"}')
    await ask(bench, "disable", '{"id": "b"}')
    await asked(bench, Enable(), Disable(), Disable(), Disable())


async def test_an_id_of_another_verb_is_refused(mosquitto: Broker, tmp_path: Path) -> None:
    async with serving(mosquitto, "verbs", tmp_path) as bench:
        await ask(bench, "setpoint", '{"id": "a", "value": 1}')
        await ask(bench, "disable", '{"id": "b"}')
        for verb, identity in (("enable", "a"), ("enable", "b"), ("reset", "b")):
            reply = await ask(bench, verb, json.dumps({"id": identity}))
            assert (reply["verb"], reply["accepted"]) == (verb, False)
            assert f"id '{identity}' was used by" in reply["reason"]
        await asked(bench, SetSetpoint(1.0), Disable())
    async with serving(mosquitto, "verbs", tmp_path) as bench:
        assert "'setpoint'" in (await ask(bench, "enable", '{"id": "a"}'))["reason"]
        assert "'disable'" in (await ask(bench, "enable", '{"id": "b"}'))["reason"]
        assert bench.host.asked == []


@pytest.mark.parametrize("live", [False, True])
@pytest.mark.parametrize("payload", ["OFF", '{"id": "a"}'])
async def test_a_retained_stop_acts_once_and_is_deleted(
    mosquitto: Broker, tmp_path: Path, payload: str, *, live: bool
) -> None:
    drive = f"kept-{live}-{len(payload)}"
    topic = f"adaptdrive/{drive}/command/disable"
    if not live:
        await publish(mosquitto, topic, payload, "-r")
    async with (
        listening(mosquitto, f"adaptdrive/{drive}/event") as ear,
        serving(mosquitto, drive, tmp_path) as bench,
    ):
        if live:
            await publish(mosquitto, topic, payload, "-r")
        event = await ear.on(bench.topic("event"))
        assert event.content["kind"] == "command"
        assert "a retained disable" in event.content["detail"]
        await ask(bench, "setpoint", '{"id": "later", "value": 1}')
        await asked(bench, Disable(), SetSetpoint(1.0))
    async with serving(mosquitto, drive, tmp_path) as bench:
        await ask(bench, "setpoint", '{"id": "again", "value": 1}')
        await asked(bench, SetSetpoint(1.0))


async def test_an_operator_who_deletes_a_retained_stop_stops(bench: Bench) -> None:
    await publish(bench.broker, bench.topic("command/disable"), "", "-r")
    await ask(bench, "setpoint", '{"id": "a", "value": 1}')
    await asked(bench, Disable(), SetSetpoint(1.0))


async def test_a_stop_acts_while_the_disk_hangs(
    mosquitto: Broker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    host = RememberingHost()
    async with serving(mosquitto, "hung", tmp_path, host) as bench:

        async def hang(_log: object, patience_s: float) -> None:
            await asyncio.sleep(patience_s)

        monkeypatch.setattr("adaptdrive.recording.log.Log.kept", hang)
        await publish(mosquitto, bench.topic("command/enable"), '{"id": "a"}')
        assert (await ask(bench, "disable", '{"id": "b"}'))["accepted"]
        assert host.asked == [Disable()]
