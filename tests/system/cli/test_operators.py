"""Operators at the command line, each command a process, with a real broker."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from pathlib import Path

import pytest

from adaptdrive.runtime.requests import Enable
from tests.support import Broker, MosquittoLauncher, acting, stop_process
from tests.unit.mqtt.peers import Bench, drive_report, listening, publish, serving


async def start(*words: str) -> asyncio.subprocess.Process:
    return await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "adaptdrive.cli", *words),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "COLUMNS": "200"},
    )


async def told(broker: Broker, *words: str, live: Bench | None = None) -> tuple[int, str, str]:
    """Status, output and errors of a command, while a daemon publishes telemetry."""
    process = await start(*words, "--broker", f"{broker.host}:{broker.port}")
    ending = asyncio.create_task(process.communicate())
    while not ending.done():
        if live is not None:
            live.hub.publish(drive_report(600))
        await asyncio.sleep(0.05)
    output, errors = await ending
    assert process.returncode is not None
    return process.returncode, output.decode(), errors.decode()


async def test_an_operator_sees_and_commands_the_drives_of_a_broker(
    mosquitto_launcher: MosquittoLauncher, free_tcp_port: int, tmp_path: Path
) -> None:
    process = mosquitto_launcher.start(free_tcp_port)
    broker = Broker("127.0.0.1", free_tcp_port)
    try:
        status, _, errors = await told(broker, "list")
        assert (status, "no drive is on 127.0.0.1" in errors) == (3, True)
        await publish(broker, "adaptdrive/broken/state", "[]", "-r")
        await publish(broker, "adaptdrive/remembered/availability", "online", "-r")
        await publish(broker, "adaptdrive/remembered/state", '{"state": "running"}', "-r")
        async with serving(broker, "alpha", tmp_path) as alpha:
            accepted = await told(broker, "enable", "alpha")
            assert accepted == (0, "alpha: enable accepted, running\n", "")
            assert alpha.host.asked == [Enable()]
            status, _, errors = await told(broker, "setpoint", "alpha", "9")
            assert (status, errors.count("\n"), "outside" in errors) == (1, 1, True)
            status, output, _ = await told(broker, "status", "alpha", "--json", live=alpha)
            assert (status, json.loads(output)["live"]) == (0, True)
            status, output, _ = await told(broker, "list", live=alpha)
        head, *rows, doubt = output.splitlines()
        assert (status, head.split()[0]) == (0, "drive")
        assert [row.split()[0] for row in rows] == ["alpha", "remembered"]
        assert "  3.1 V  " in rows[0]
        assert doubt.startswith("remembered is online by the broker, but no telemetry came")
        status, output, _ = await told(broker, "status", "alpha")
        assert (status, output.startswith("alpha is offline\n  last state")) == (3, True)
    finally:
        stop_process(process)


@pytest.mark.proof
async def test_an_interrupted_command_is_quiet(mosquitto: Broker) -> None:
    where = ("--broker", f"{mosquitto.host}:{mosquitto.port}")
    async with listening(mosquitto, "adaptdrive/nobody/command/ping") as ear:
        with acting(signal.SIGINT):
            process = await start("enable", "nobody", "--timeout", "60", *where)
        await ear.on("adaptdrive/nobody/command/ping")
    process.send_signal(signal.SIGINT)
    output, errors = await process.communicate()
    assert (process.returncode, output, errors) == (130, b"", b"")


@pytest.mark.proof
async def test_the_panel_is_served_while_a_browser_in_the_terminal_runs(
    outside: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The browser ends when it has the page; the command must not wait for that."""
    browser, seen = tmp_path / "browser", tmp_path / "seen"
    browser.write_text(
        f"#!{sys.executable}\n"
        "import sys, urllib.request\n"
        "urllib.request.urlopen(sys.argv[1]).read()\n"
        f"open({str(seen)!r}, 'xb').close()\n",
        encoding="utf-8",
    )
    browser.chmod(0o755)
    monkeypatch.setenv("BROWSER", f"{browser} %s")
    with acting(signal.SIGINT):
        process = await start("panel", "--port", "0")
    assert process.stdout is not None
    assert (await process.stdout.readline()).startswith(b"panel: http://127.0.0.1:")
    while not seen.exists():  # noqa: ASYNC110 - a file sets no event
        await asyncio.sleep(0.05)
    process.send_signal(signal.SIGINT)
    await process.communicate()
    assert process.returncode == 130
