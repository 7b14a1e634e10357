"""`adaptdrive watch`: follow one drive, show it, and send the commands of the keys."""

from __future__ import annotations

import asyncio
import functools
import time

from adaptdrive.config.services import Mqtt
from adaptdrive.operation.conversation import NoAnswerError
from adaptdrive.operation.listener import follow
from adaptdrive.operation.messages import Reply
from adaptdrive.operation.sender import disturb, send_command
from adaptdrive.operation.simulator import DeviceReply
from adaptdrive.watch.keys import QUIT, KeyCommand, KeyReader, pressed_keys
from adaptdrive.watch.record import WatchRecord
from adaptdrive.watch.view import draw, screen

_RETRY_S = 2.0


async def watch(broker: Mqtt, drive: str, timeout_s: float) -> None:
    """Show a drive until `q` is pressed.

    Args:
        broker: Where the broker is.
        drive: Name of the drive.
        timeout_s: Longest wait for the answer to a command.
    """
    record, ended = WatchRecord(drive, time.monotonic), asyncio.Event()
    reader, sending = KeyReader(record), set[asyncio.Task[None]]()

    def on_key(key: str) -> None:
        if key == QUIT:
            ended.set()
        elif (command := reader.press(key)) is not None:
            task = asyncio.create_task(_send(broker, record, command, timeout_s))
            sending.add(task)
            task.add_done_callback(sending.discard)

    services = (_follow(broker, record), draw(functools.partial(screen, record)), ended.wait())
    tasks = [asyncio.ensure_future(service) for service in services]
    try:
        with pressed_keys(on_key):
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in (*tasks, *sending):
            task.cancel()
        await asyncio.wait([*tasks, *sending])
    for task in done:
        await task  # a service that has failed ends the view with its error


async def _follow(broker: Mqtt, record: WatchRecord) -> None:
    """Take messages, and connect again after each loss of the broker."""
    while True:
        try:
            async for name, content in follow(broker, record.drive):
                record.problem = ""
                record.take(name, content)
        except NoAnswerError as problem:
            record.problem = problem.problem
        record.availability = "unknown"
        await asyncio.sleep(_RETRY_S)


async def _send(broker: Mqtt, record: WatchRecord, command: KeyCommand, timeout_s: float) -> None:
    """Send a command; show that it was sent, then the answer, never what was hoped for."""
    value = "" if command.value is None else f" {command.value}"
    asked = f"{command.verb}{value}"
    record.answer = f"{asked}: sent"
    try:
        reply = await _reply(broker, record.drive, command, timeout_s)
    except NoAnswerError as problem:
        record.answer = f"{asked}: {problem.problem}"
    else:
        record.answer = f"{asked}: accepted" if reply.accepted else f"{asked}: {reply.reason}"


async def _reply(
    broker: Mqtt, drive: str, command: KeyCommand, timeout_s: float
) -> Reply | DeviceReply:
    if command.disturbance is not None:
        return await disturb(broker, drive, dict(command.disturbance), timeout_s)
    return await send_command(broker, drive, command.verb, command.value, timeout_s)
