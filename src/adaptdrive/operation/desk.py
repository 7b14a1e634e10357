"""Processing of commands: refuse, repeat or carry out, and always record.

`disable` is carried out as it arrives, before its payload, the queue of commands or the log is
looked at. Every other command that arrived before it and still waits is refused: an `enable` that
waits for a slow disk must not undo the stop that came after it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime

from msgspec.structs import replace

from adaptdrive.errors import AdaptdriveError, RefusedError
from adaptdrive.lines import Level, log
from adaptdrive.operation.clock import WallClock
from adaptdrive.operation.commands import LONGEST_ID, PING, STOP, Payload
from adaptdrive.operation.memory import ReplyMemory
from adaptdrive.operation.messages import Reply
from adaptdrive.operation.pace import LogRation
from adaptdrive.operation.payloads import printable
from adaptdrive.runtime.hub import Keep
from adaptdrive.runtime.reports import CommandReport, State
from adaptdrive.runtime.requests import Host, Request

INTERRUPTED = "the daemon stopped while it carried this out; it may or may not have taken effect"
OVERTAKEN = "a disable arrived after this command and before it was carried out"
RETAINED = "retained commands are not carried out; publish without retain"
UNREADABLE = "id: not readable; give each command an id of 1 to 128 characters"
LONGEST_REASON = 500


@dataclass(frozen=True, slots=True)
class OperatorCommand:
    """A command as it arrived.

    Attributes:
        verb: Last part of the topic.
        raw: Payload as it came.
        retained: Whether it was published as a retained message, by the broker's flag.
        stops: Stops carried out until it arrived, its own included.
        stopped: State after the stop that it asked for; None for every verb but `disable`.
    """

    verb: str
    raw: bytes
    retained: bool
    stops: int
    stopped: State | None

    @property
    def remains_on_broker(self) -> bool:
        """True if the broker retains it; a retained message without a payload is a deletion."""
        return self.retained and bool(self.raw)


class Desk:
    """Answers commands, one after another, but stops at once."""

    def __init__(  # noqa: PLR0913 - it joins the parts of the service
        self,
        host: Host,
        memory: ReplyMemory,
        present_state: Callable[[], State | None],
        wall: WallClock,
        ration: LogRation,
        *,
        report: Callable[[CommandReport], None],
        kept: Keep,
        shutting_down: Callable[[], bool],
    ) -> None:
        """Prepare to answer.

        Args:
            host: Carries requests out.
            memory: Replies by id.
            present_state: Returns the state of the drive.
            wall: Wall clock.
            ration: Bounds the lines of the log.
            report: Takes a report of each command that was answered for the first time.
            kept: Waits until the report is recorded, before the command is answered.
            shutting_down: Returns whether the daemon ends.
        """
        self._kept = kept
        self._shutting_down = shutting_down
        self._report = report
        self._host = host
        self._memory = memory
        self._present_state = present_state
        self._wall = wall
        self._ration = ration
        self._turn = asyncio.Lock()
        self._stops = 0

    async def run(self) -> None:
        """Own the commands under way until cancelled: a lost broker leaves none half done."""
        async with asyncio.TaskGroup() as self._tasks:
            await asyncio.Event().wait()

    async def ask(self, command: OperatorCommand) -> Reply:
        """Answer a command in a task that outlives its caller."""
        return await asyncio.shield(self._tasks.create_task(self.answer(command)))

    def receive(self, verb: str, raw: bytes, *, retained: bool) -> OperatorCommand:
        """Take a command as it arrives; `disable` is carried out here, whatever its payload."""
        stopped = None
        if verb == STOP:
            stopped = self._host.stop()
            self._stops += 1
        return OperatorCommand(_clean(verb), raw, retained, self._stops, stopped)

    async def answer(self, command: OperatorCommand) -> Reply:
        """Carry out a command unless a rule forbids it.

        Returns:
            The reply; its id is None where the command has no readable one.
        """
        payload = Payload(command.raw)
        if payload.id is None:
            self._log_unreadable(command)
        if command.stopped is not None:
            reply = self._confirm(command, payload, command.stopped)
        elif payload.id is None:
            return self._refused(command, payload, self._flaw(command, payload) or UNREADABLE)
        elif command.verb == PING:
            reply = self._acknowledge(command, payload)
        else:
            async with self._turn:
                reply = self._repeated(command, payload) or await self._decide(command, payload)
        await self._kept()
        self._log_reply(reply)
        return reply

    def refuse(self, command: OperatorCommand, reason: str) -> Reply:
        """Refuse a command without looking further than its id."""
        payload = Payload(command.raw)
        reply = self._refused(command, payload, reason)
        if payload.id is None:
            self._log_unreadable(command)
        else:
            self._report(_report_of(payload, reply))
            self._log_reply(reply)
        return reply

    def _refused(self, command: OperatorCommand, payload: Payload, reason: str) -> Reply:
        refusal = _refusal(command, payload)
        return replace(refusal, reason=_clean(reason), state=self._present_state())

    def _acknowledge(self, command: OperatorCommand, payload: Payload) -> Reply:
        """Return the reply to a command that changes nothing and is not recorded."""
        if command.retained:
            return self._refused(command, payload, RETAINED)
        try:
            self._refuse_expired(payload.expires)
        except RefusedError as problem:
            return self._refused(command, payload, problem.reason)
        return replace(_refusal(command, payload), accepted=True, state=self._present_state())

    def _confirm(self, command: OperatorCommand, payload: Payload, state: State) -> Reply:
        """Return the reply to a stop; it is accepted whatever is wrong with its payload."""
        flaw = self._flaw(command, payload)
        reason = _clean(f"carried out, although: {flaw}") if flaw else ""
        reply = replace(_refusal(command, payload), accepted=True, reason=reason, state=state)
        if _memorable(payload.id) and self._other_use(command, payload) is None:
            self._memory.note(str(payload.id), reply)
        self._report(_report_of(payload, reply))
        return reply

    def _flaw(self, command: OperatorCommand, payload: Payload) -> str:
        if command.retained:
            return "it is retained; publish without retain"
        if command.verb == PING:
            return ""
        try:
            self._read(command, payload)
        except AdaptdriveError as problem:
            return str(problem)
        return self._other_use(command, payload) or ""

    def _withheld_lines(self) -> int | None:
        """Return how many lines were withheld before this one, None when this one is withheld.

        A daemon that ends withholds none: it may have no time left for its session.
        """
        if self._shutting_down():
            self._ration.lift()
        return self._ration.take()

    def _log_unreadable(self, command: OperatorCommand) -> None:
        size, stopped = len(command.raw), command.stopped is not None
        facts = {"verb": command.verb, "size": size, "carried_out": stopped}
        self._log("warning", "command without a readable id", facts)

    def _log_reply(self, reply: Reply) -> None:
        facts = {"id": reply.id, "verb": reply.verb, "accepted": reply.accepted}
        self._log("info", "command", facts | {"reason": reply.reason or None})

    def _log(self, level: Level, event: str, facts: Mapping[str, object]) -> None:
        if (withheld := self._withheld_lines()) is not None:
            log(level, event, **facts, withheld_lines=withheld)

    def _repeated(self, command: OperatorCommand, payload: Payload) -> Reply | None:
        """Return the reply to a command whose id is known, None for a new one."""
        flaw = self._other_use(command, payload)
        return self._recall(payload) if flaw is None else self._refused(command, payload, flaw)

    def _other_use(self, command: OperatorCommand, payload: Payload) -> str | None:
        """Return what else the id of a command was used for, None where it was not."""
        known = self._recall(payload)
        if known is None:
            return None
        asked = self._memory.asked(str(payload.id))
        if known.verb != command.verb:
            use = f"by {known.verb!r}"
        elif asked is not None and asked != payload.asked(command.verb):
            use = "with another value"
        else:
            return None
        return _clean(f"id {payload.id!r} was used {use}; give each command its own id")

    def _recall(self, payload: Payload) -> Reply | None:
        """Return the reply to the first command with this id; only text identifies one."""
        return self._memory.recall(str(payload.id)) if _memorable(payload.id) else None

    async def _decide(self, command: OperatorCommand, payload: Payload) -> Reply:
        reply = _refusal(command, payload)
        try:
            request, expires = self._read(command, payload)
            state = await self._carry_out(request, expires, command, payload)
        except AdaptdriveError as problem:
            reply = replace(reply, reason=_clean(str(problem)), state=self._present_state())
        else:
            reply = replace(reply, accepted=True, state=state)
        if _memorable(payload.id):
            self._memory.note(str(payload.id), reply, payload.asked(command.verb))
        self._report(_report_of(payload, reply))
        return reply

    def _read(self, command: OperatorCommand, payload: Payload) -> tuple[Request, datetime | None]:
        if command.retained:
            raise RefusedError(RETAINED)
        request, expires = payload.request(command.verb)
        self._refuse_expired(expires)
        return request, expires

    async def _carry_out(
        self,
        request: Request,
        expires: datetime | None,
        command: OperatorCommand,
        payload: Payload,
    ) -> State:
        self._refuse_overtaken(command)
        doubt = replace(_refusal(command, payload), reason=INTERRUPTED)
        # Written first: a daemon that dies in between must not act a second time on a repeat.
        self._memory.note(str(doubt.id), doubt, payload.asked(command.verb))
        await self._kept()
        self._refuse_overtaken(command)
        self._refuse_expired(expires)
        return await self._host.execute(request)

    def _refuse_overtaken(self, command: OperatorCommand) -> None:
        if command.stops != self._stops:
            raise RefusedError(OVERTAKEN)

    def _refuse_expired(self, expires: datetime | None) -> None:
        now = self._wall()
        if expires is not None and expires <= now:
            raise RefusedError(
                f"expired at {expires.isoformat()}; the daemon's clock says {now.isoformat()}"
            )


def _refusal(command: OperatorCommand, payload: Payload) -> Reply:
    return Reply(id=payload.id, verb=command.verb, accepted=False, reason="", state=None)


def _report_of(payload: Payload, reply: Reply) -> CommandReport:
    return CommandReport(
        id="" if reply.id is None else str(reply.id),
        verb=reply.verb,
        value=_clean(payload.value),
        user=payload.user,
        accepted=reply.accepted,
        reason=reply.reason,
    )


def _memorable(identity: str | int | None) -> bool:
    return isinstance(identity, str) and 1 <= len(identity) <= LONGEST_ID


def _clean(reason: str) -> str:
    """Return one line that any terminal and any JSON reader takes."""
    return printable(reason)[:LONGEST_REASON]
