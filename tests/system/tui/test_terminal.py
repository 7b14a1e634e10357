"""`adaptdrive watch` in real terminals, and its commands under way over a real broker."""

from __future__ import annotations

import asyncio
import os
import pty
import signal
import sys
import time
import uuid
from pathlib import Path

import pytest

from adaptdrive.control.signals import Mode
from adaptdrive.mqtt import connection
from adaptdrive.runtime.requests import Disable, Enable, Reset, SetMode
from adaptdrive.tui import CommandsUnderWay, over_mqtt
from adaptdrive.tui.record import WatchRecord
from adaptdrive.tui.terminal import DELIBERATE_S, REFRESH_S, KeyCommand
from tests.support import Broker, acting
from tests.unit.commissioning.answering_drive import answering_drive
from tests.unit.mqtt.peers import PATIENCE_S, Bench, commands, drive_report, serving

AROUND = {"TERM": "xterm", "LINES": "40", "COLUMNS": "120"}
HELD_S = 0.5
"""Time for which the answer is kept back after the last signal."""

ENDS = {
    "q, then Ctrl-C": ("q", [signal.SIGINT]),
    "SIGHUP and SIGTERM": ("", [signal.SIGHUP, signal.SIGTERM]),
}


async def until_heard(bench: Bench, request: object) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while request not in bench.host.asked:  # noqa: ASYNC110 - the host has no event
            await asyncio.sleep(0.02)


async def test_nothing_that_was_asked_before_a_stop_acts_after_it(
    mosquitto: Broker, tmp_path: Path
) -> None:
    """An `enable` waits for telemetry to learn the clock, a `disable` does not."""
    record = WatchRecord("overtaken", time.monotonic)
    settings = connection.Broker(host=mosquitto.host, port=mosquitto.port)
    under_way = CommandsUnderWay(over_mqtt(settings, record.drive, PATIENCE_S), record)
    async with serving(mosquitto, "overtaken", tmp_path) as bench:
        under_way.send(KeyCommand("enable"))
        under_way.send(KeyCommand("disable"))
        await until_heard(bench, Disable())
        under_way.send(KeyCommand("reset"))
        bench.hub.publish(drive_report(600))
        await until_heard(bench, Reset())
        await under_way.end()
    assert bench.host.asked == [Disable(), Reset()]


async def test_a_command_is_called_accepted_when_it_was_answered_and_not_before(
    mosquitto: Broker, tmp_path: Path
) -> None:
    record = WatchRecord("awaited", time.monotonic)
    settings = connection.Broker(host=mosquitto.host, port=mosquitto.port)
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


class Terminal:
    """`adaptdrive watch` in a pseudo-terminal."""

    def __init__(self, file: int, process: asyncio.subprocess.Process) -> None:
        self.process = process
        self._file = file
        self._seen = ""
        self._more = asyncio.Event()
        asyncio.get_running_loop().add_reader(file, self._read)

    def _read(self) -> None:
        try:
            self._seen += os.read(self._file, 65536).decode(errors="replace")
        except OSError:  # the other end is closed
            asyncio.get_running_loop().remove_reader(self._file)
        self._more.set()

    async def shows(self, text: str) -> None:
        async with asyncio.timeout(PATIENCE_S):
            while text not in self._seen:
                self._more.clear()
                await self._more.wait()

    def press(self, keys: str) -> None:
        os.write(self._file, keys.encode())

    def hang_up(self) -> None:
        asyncio.get_running_loop().remove_reader(self._file)
        os.close(self._file)

    async def close(self) -> None:
        if self.process.returncode is None:
            self.process.kill()
            await self.process.wait()
        self.hang_up()


async def terminal(broker: Broker, drive: str, *more: str) -> Terminal:
    own, other = pty.openpty()
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "adaptdrive.cli", "watch", drive),
        *("--broker", f"{broker.host}:{broker.port}", *more),
        stdin=other,
        stdout=other,
        stderr=other,
        env=os.environ | AROUND | {"PYTHONPATH": os.pathsep.join(sys.path)},
    )
    os.close(other)
    return Terminal(own, process)


async def until_asked(bench: Bench, *wanted: object) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while bench.host.asked != list(wanted):  # noqa: ASYNC110 - the host has no event
            await asyncio.sleep(0.02)


@pytest.mark.proof
async def test_a_drive_is_watched_and_commanded_from_a_terminal(
    mosquitto: Broker, tmp_path: Path
) -> None:
    async with serving(mosquitto, "watched", tmp_path) as bench:
        seen = await terminal(mosquitto, "watched")
        try:
            await seen.shows("standby")
            seen.press("s")
            await until_asked(bench, Disable())
            await seen.shows("disable: accepted")
            seen.press("e")
            await seen.shows("press e again")
            seen.press("eee")
            await asyncio.sleep(1.5 * DELIBERATE_S)
            seen.press("e")
            await until_asked(bench, Disable(), Enable())
            seen.press("a")
            await until_asked(bench, Disable(), Enable(), SetMode(Mode.ADAPTIVE))
            await seen.shows("mode adaptive: accepted")
            seen.press("q")
            async with asyncio.timeout(PATIENCE_S):
                assert await seen.process.wait() == 0
        finally:
            await seen.close()


@pytest.mark.proof
async def test_a_terminal_without_a_cursor_gets_no_view_and_arms_no_key(
    mosquitto: Broker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(AROUND, "TERM", "dumb")
    async with serving(mosquitto, "dumb", tmp_path) as bench:
        seen = await terminal(mosquitto, "dumb")
        try:
            seen.press("s")
            await seen.shows("adaptdrive: TERM: dumb: a terminal of this kind shows no picture")
            async with asyncio.timeout(PATIENCE_S):
                assert await seen.process.wait() == 2
        finally:
            await seen.close()
    assert bench.host.asked == []


@pytest.mark.proof
async def test_a_stop_that_nobody_answers_is_told_at_the_end(mosquitto: Broker) -> None:
    async with commands(mosquitto, "deaf") as heard:
        seen = await terminal(mosquitto, "deaf", "--timeout", "2")
        try:
            await seen.shows("waiting for the drive")
            seen.press("sq")
            await seen.shows("adaptdrive: deaf: disable: no answer")
            async with asyncio.timeout(PATIENCE_S):
                assert await seen.process.wait() == 3
                assert (await heard.get())[1]["value"] is None
        finally:
            await seen.close()


async def outcome(seen: Terminal) -> int:
    async with asyncio.timeout(PATIENCE_S):
        return await seen.process.wait()


async def started(broker: Broker, drive: str, *more: str) -> Terminal:
    with acting(signal.SIGINT), acting(signal.SIGTERM), acting(signal.SIGHUP):
        return await terminal(broker, drive, *more)


@pytest.mark.proof
@pytest.mark.parametrize("end", ENDS)
async def test_a_signal_does_not_withdraw_a_stop(mosquitto: Broker, end: str) -> None:
    key, signals = ENDS[end]
    async with answering_drive(mosquitto, f"ended-{uuid.uuid4()}") as drive:
        drive.state = "running"
        seen = await started(mosquitto, drive.name, "--timeout", f"{PATIENCE_S}")
        try:
            await seen.shows("running")
            seen.press("s" + key)
            await asyncio.wait_for(drive.stopped.wait(), PATIENCE_S)
            for number in signals:
                seen.process.send_signal(number)
                await asyncio.sleep(HELD_S)
            assert seen.process.returncode is None
            drive.answers_stop.set()
            assert await outcome(seen) == (0 if key else 130)
        finally:
            await seen.close()
    assert drive.verbs == ["disable"]


@pytest.mark.proof
async def test_a_stopped_terminal_keeps_no_command_and_no_signal(mosquitto: Broker) -> None:
    """Ctrl-S stops the terminal's output, not its input."""
    async with answering_drive(mosquitto, f"ended-{uuid.uuid4()}") as drive:
        drive.state = "running"
        drive.answers_stop.set()
        seen = await started(mosquitto, drive.name)
        try:
            await seen.shows("running")
            seen.press("\x13")
            await asyncio.sleep(4 * REFRESH_S)
            seen.press("s")
            await asyncio.wait_for(drive.stopped.wait(), PATIENCE_S)
            seen.process.send_signal(signal.SIGTERM)
            assert await outcome(seen) == 130
        finally:
            await seen.close()
