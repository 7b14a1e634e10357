"""The live view of one drive in a terminal, `adaptdrive watch`: follow, show, send what keys ask.

A stop withdraws all commands that were sent before it.
"""

import asyncio
import functools
import time
from collections.abc import Awaitable, Callable, Coroutine, Iterable
from contextlib import nullcontext
from typing import Any

from rich.layout import Layout

from adaptdrive.mqtt import client, commands, contract
from adaptdrive.mqtt.connection import Broker
from adaptdrive.tui import terminal, view
from adaptdrive.tui.record import WatchRecord

_RETRY_S = 2.0
_WITHDRAWN = "the view ended before the answer; whether it took effect is not known"

Show = Callable[[tuple[int, int]], Layout]

Ask = Callable[[terminal.KeyCommand], Awaitable[contract.Reply | contract.DeviceReply]]
"""Sends a command and returns its answer, or raises `NoAnswerError`."""


async def watch(
    broker: Broker,
    drive: str,
    timeout_s: float,
    around: view.ViewExtras = view.WATCH,
    services: Iterable[Coroutine[Any, Any, object]] = (),
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
    show = functools.partial(view.screen, record, around=around)
    ask = over_mqtt(broker, drive, timeout_s)
    every = [follow_drive(broker, record), *services]
    return await run_view(record, ask, every, show, around.takes)


async def run_view(
    record: WatchRecord,
    ask: Ask,
    services: Iterable[Coroutine[Any, Any, object]],
    show: Show | None,
    takes: view.Takes,
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
    under_way, reader = CommandsUnderWay(ask, record), terminal.KeyReader(record)
    ended, unanswered = asyncio.Event(), list[str]()

    def on_keys(keys: str) -> None:
        for key in keys:
            if key == terminal.QUIT:
                ended.set()
                continue
            command = takes(key) or reader.press(key, alone=len(keys) == 1)
            if isinstance(command, terminal.KeyCommand):
                under_way.send(command)

    async def leave() -> None:
        unanswered.extend(await under_way.end())
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)
        if unanswered:
            lines = (f"adaptdrive: {commands.printable(one)}" for one in unanswered)
            terminal.print_last("\n".join(lines))

    seen = [] if show is None else [terminal.draw(show)]
    tasks = [asyncio.ensure_future(one) for one in (*services, *seen, ended.wait())]
    with terminal.ended_once():
        try:
            with nullcontext() if show is None else terminal.pressed_keys(on_keys):
                done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            await terminal.whole(leave(), complete=True)
    for task in done:
        await task
    return not unanswered


async def follow_drive(broker: Broker, record: WatchRecord) -> None:
    """Take messages, and connect again after each loss of the broker."""
    while True:
        try:
            async for name, content in client.follow(broker, record.drive):
                record.problem = ""
                record.take(name, content)
        except client.NoAnswerError as problem:
            record.problem = problem.problem
        record.availability = "unknown"
        await asyncio.sleep(_RETRY_S)


def over_mqtt(broker: Broker, drive: str, timeout_s: float) -> Ask:
    """Return how commands reach a drive.

    Args:
        broker: Where the broker is.
        drive: Name of the drive.
        timeout_s: Longest wait for the answer to a command.
    """

    async def ask(command: terminal.KeyCommand) -> contract.Reply | contract.DeviceReply:
        if command.disturbance is not None:
            return await client.disturb(broker, drive, dict(command.disturbance), timeout_s)
        fields = {} if command.unit is None else {"unit": command.unit}
        return await client.send_command(
            broker, drive, command.verb, command.value, timeout_s, **fields
        )

    return ask


class CommandsUnderWay:
    """Sends each command in a separate task, and shows what came of it."""

    def __init__(self, ask: Ask, record: WatchRecord) -> None:
        self._ask = ask
        self._record = record
        self._tasks: dict[asyncio.Task[str], terminal.KeyCommand] = {}

    def send(self, command: terminal.KeyCommand) -> None:
        """Send a command; a stop first withdraws all others, which could arrive after it."""
        if command.stops:
            self._withdraw()
        task = asyncio.create_task(self._send(command))
        self._tasks[task] = command
        task.add_done_callback(self._tasks.pop)

    async def end(self) -> list[str]:
        """Withdraw all commands but stops, and wait for the answers to these.

        Returns:
            A line for each command that is not known to be carried out.
        """
        under_way = dict(self._tasks)
        self._withdraw()
        outcomes = await asyncio.gather(*under_way, return_exceptions=True)
        drive = self._record.drive
        return [
            f"{drive}: {outcome if isinstance(outcome, str) else f'{command.text}: {_WITHDRAWN}'}"
            for command, outcome in zip(under_way.values(), outcomes, strict=True)
            if outcome != ""
        ]

    def _withdraw(self) -> None:
        """Withdraw all commands but stops."""
        for task, command in self._tasks.items():
            if not command.stops:
                task.cancel()

    async def _send(self, command: terminal.KeyCommand) -> str:
        """Send a command, and show its answer when it is there, never what was hoped for.

        Returns:
            What came of it, empty where the command was accepted.
        """
        self._record.answer = f"{command.text}: sending…"
        try:
            reply = await self._ask(command)
        except client.NoAnswerError as problem:
            outcome, accepted = problem.problem, False
        else:
            outcome, accepted = "accepted" if reply.accepted else reply.reason, reply.accepted
        self._record.answer = f"{command.text}: {outcome}"
        return "" if accepted else self._record.answer
