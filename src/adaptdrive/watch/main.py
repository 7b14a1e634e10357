"""`adaptdrive watch`: follow one drive, show it, and send the commands of the keys."""

from __future__ import annotations

import asyncio
import functools
import time

from adaptdrive.config.services import Mqtt
from adaptdrive.operation.conversation import NoAnswerError
from adaptdrive.operation.listener import follow
from adaptdrive.operation.payloads import printable
from adaptdrive.watch.ending import ended_once, whole
from adaptdrive.watch.keys import QUIT, KeyReader, pressed_keys
from adaptdrive.watch.record import WatchRecord
from adaptdrive.watch.sending import CommandsUnderWay
from adaptdrive.watch.telling import tell_last
from adaptdrive.watch.view import draw, screen

_RETRY_S = 2.0


async def watch(broker: Mqtt, drive: str, timeout_s: float) -> bool:
    """Show a drive until `q` is pressed or a signal comes; a stop under way is waited for.

    Args:
        broker: Where the broker is.
        drive: Name of the drive.
        timeout_s: Longest wait for the answer to a command.

    Returns:
        False where a command that was under way at the end is not known to be carried out; a line
        after the view names each.
    """
    record, ended = WatchRecord(drive, time.monotonic), asyncio.Event()
    unanswered: list[str] = []
    reader, under_way = KeyReader(record), CommandsUnderWay(broker, record, timeout_s)

    def on_keys(keys: str) -> None:
        for key in keys:
            if key == QUIT:
                ended.set()
            elif (command := reader.press(key, alone=len(keys) == 1)) is not None:
                under_way.send(command)

    async def leave() -> None:
        unanswered.extend(await under_way.end())
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)
        if unanswered:
            tell_last("\n".join(f"adaptdrive: {drive}: {printable(one)}" for one in unanswered))

    services = (_follow(broker, record), draw(functools.partial(screen, record)), ended.wait())
    tasks = [asyncio.ensure_future(service) for service in services]
    with ended_once():
        try:
            with pressed_keys(on_keys):
                done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            await whole(leave(), complete=True)
    for task in done:
        await task  # a service that has failed ends the view with its error
    return not unanswered


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
