"""The end of a view by a signal while its stop is under way, in a real terminal."""

from __future__ import annotations

import asyncio
import signal
import uuid

import pytest

from adaptdrive.watch.terminal import REFRESH_S
from tests.commission.answering_drive import answering_drive
from tests.operation.peers import PATIENCE_S, commands
from tests.support import Broker, acting
from tests.watch.test_watch import Terminal, terminal

HELD_S = 0.5
"""Time for which the answer is kept back after the last signal."""

ENDS = {
    "q, then Ctrl-C": ("q", [signal.SIGINT]),
    "Ctrl-C twice": ("", [signal.SIGINT, signal.SIGINT]),
    "SIGTERM": ("", [signal.SIGTERM]),
    "SIGHUP and SIGTERM": ("", [signal.SIGHUP, signal.SIGTERM]),
}


async def outcome(seen: Terminal) -> int:
    async with asyncio.timeout(PATIENCE_S):
        return await seen.process.wait()


async def started(broker: Broker, drive: str, *more: str) -> Terminal:
    with acting(signal.SIGINT), acting(signal.SIGTERM), acting(signal.SIGHUP):
        return await terminal(broker, drive, *more)


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


async def test_a_stop_without_an_answer_is_named_after_a_signal(mosquitto: Broker) -> None:
    async with answering_drive(mosquitto, f"ended-{uuid.uuid4()}") as drive:
        drive.state = "running"
        seen = await started(mosquitto, drive.name, "--timeout", "2")
        try:
            await seen.shows("running")
            seen.press("s")
            await asyncio.wait_for(drive.stopped.wait(), PATIENCE_S)
            seen.process.send_signal(signal.SIGTERM)
            await seen.shows(f"adaptdrive: {drive.name}: disable: no answer")
            assert await outcome(seen) == 130
        finally:
            await seen.close()


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


async def test_a_stopped_terminal_keeps_no_last_word_from_ending(mosquitto: Broker) -> None:
    """What was not answered is told to a terminal that takes output, and to no other."""
    name = f"ended-{uuid.uuid4()}"
    async with commands(mosquitto, name) as heard:
        seen = await started(mosquitto, name, "--timeout", "2")
        try:
            await seen.shows("waiting for the drive")
            seen.press("\x13")
            await asyncio.sleep(4 * REFRESH_S)
            seen.press("s")
            assert (await asyncio.wait_for(heard.get(), PATIENCE_S))[1]["value"] is None
            seen.press("q")
            assert await outcome(seen) == 3
        finally:
            await seen.close()
