"""`adaptdrive watch`: follow one drive, show it, and send the commands of the keys."""

from __future__ import annotations

import asyncio
import functools
import time
from collections.abc import Callable, Coroutine, Iterable
from contextlib import nullcontext
from typing import Any

from rich.layout import Layout

from adaptdrive.config.services import Mqtt
from adaptdrive.operation.conversation import NoAnswerError
from adaptdrive.operation.listener import follow
from adaptdrive.operation.payloads import printable
from adaptdrive.watch.ending import ended_once, whole
from adaptdrive.watch.keys import QUIT, KeyCommand, KeyReader, pressed_keys
from adaptdrive.watch.record import WatchRecord
from adaptdrive.watch.sending import Ask, CommandsUnderWay, over_mqtt
from adaptdrive.watch.telling import tell_last
from adaptdrive.watch.terminal import draw
from adaptdrive.watch.view import WATCH, Surroundings, Takes, screen

_RETRY_S = 2.0

Show = Callable[[tuple[int, int]], Layout]


async def watch(
    broker: Mqtt,
    drive: str,
    timeout_s: float,
    around: Surroundings = WATCH,
    services: Iterable[Coroutine[Any, Any, None]] = (),
) -> bool:
    """Show a drive until `q` is pressed or a signal comes; a stop under way is waited for.

    Args:
        broker: Where the broker is.
        drive: Name of the drive.
        timeout_s: Longest wait for the answer to a command.
        around: What is shown around the drive.
        services: Run for as long as the view does; the end of one ends it.

    Returns:
        False where a command that was under way at the end is not known to be carried out; a line
        after the view names each.
    """
    record = WatchRecord(drive, time.monotonic)
    show = functools.partial(screen, record, around=around)
    ask = over_mqtt(broker, drive, timeout_s)
    return await run_view(
        record, ask, [follow_drive(broker, record), *services], show, around.takes
    )


async def run_view(
    record: WatchRecord,
    ask: Ask,
    services: Iterable[Coroutine[Any, Any, None]],
    show: Show | None,
    takes: Takes,
) -> bool:
    """Draw a view and heed its keys until `q`, a signal, or the end of a service.

    Args:
        record: What is heard of the drive.
        ask: Sends the commands of the keys.
        services: Run for as long as the view does; one that fails ends it with its error.
        show: Returns the screen for a terminal of some width and height; without it nothing is
            drawn, and no key is heeded.
        takes: Sees each key first.

    Returns:
        False where a command is not known to be carried out; a line names each.
    """
    under_way, reader = CommandsUnderWay(ask, record), KeyReader(record)
    ended, unanswered = asyncio.Event(), list[str]()

    def on_keys(keys: str) -> None:
        for key in keys:
            if key == QUIT:
                ended.set()
                continue
            command = takes(key) or reader.press(key, alone=len(keys) == 1)
            if isinstance(command, KeyCommand):
                under_way.send(command)

    async def leave() -> None:
        unanswered.extend(await under_way.end())
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)
        if unanswered:
            tell_last("\n".join(f"adaptdrive: {printable(one)}" for one in unanswered))

    seen = [] if show is None else [draw(show)]
    tasks = [asyncio.ensure_future(one) for one in (*services, *seen, ended.wait())]
    with ended_once():
        try:
            with nullcontext() if show is None else pressed_keys(on_keys):
                done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            await whole(leave(), complete=True)
    for task in done:
        await task
    return not unanswered


async def follow_drive(broker: Mqtt, record: WatchRecord) -> None:
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
