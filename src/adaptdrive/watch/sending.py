"""Commands of the live view that are under way; a stop withdraws all that were sent before it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from adaptdrive.config.services import Mqtt
from adaptdrive.operation.conversation import NoAnswerError
from adaptdrive.operation.messages import Reply
from adaptdrive.operation.sender import disturb, send_command
from adaptdrive.operation.simulator import DeviceReply
from adaptdrive.watch.keys import KeyCommand
from adaptdrive.watch.record import WatchRecord

_WITHDRAWN = "the view ended before the answer; whether it took effect is not known"


Ask = Callable[[KeyCommand], Awaitable[Reply | DeviceReply]]
"""Sends a command and returns its answer, or raises `NoAnswerError`."""


def over_mqtt(broker: Mqtt, drive: str, timeout_s: float) -> Ask:
    """Return how commands reach a drive.

    Args:
        broker: Where the broker is.
        drive: Name of the drive.
        timeout_s: Longest wait for the answer to a command.
    """

    async def ask(command: KeyCommand) -> Reply | DeviceReply:
        if command.disturbance is not None:
            return await disturb(broker, drive, dict(command.disturbance), timeout_s)
        return await send_command(broker, drive, command.verb, command.value, timeout_s)

    return ask


class CommandsUnderWay:
    """Sends each command in a separate task, and shows what came of it."""

    def __init__(self, ask: Ask, record: WatchRecord) -> None:
        """Prepare to send.

        Args:
            ask: Sends a command.
            record: Takes the answers.
        """
        self._ask = ask
        self._record = record
        self._tasks: dict[asyncio.Task[str], KeyCommand] = {}

    def send(self, command: KeyCommand) -> None:
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

    async def _send(self, command: KeyCommand) -> str:
        """Send a command, and show its answer when it is there, never what was hoped for.

        Returns:
            What came of it, empty where the command was accepted.
        """
        self._record.answer = f"{command.text}: sending…"
        try:
            reply = await self._ask(command)
        except NoAnswerError as problem:
            outcome, accepted = problem.problem, False
        else:
            outcome, accepted = "accepted" if reply.accepted else reply.reason, reply.accepted
        self._record.answer = f"{command.text}: {outcome}"
        return "" if accepted else self._record.answer
