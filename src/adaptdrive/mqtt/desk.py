"""Processing of commands: refuse, repeat or carry out, and always record.

`disable` is carried out as it arrives, before its payload, the queue of commands or the log is
looked at. Every other command that arrived before it and still waits is refused: an `enable` that
waits for a slow disk must not undo the stop that came after it.
"""

import asyncio
import math
import sys
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import InitVar, dataclass, field
from datetime import datetime
from functools import cached_property

import msgspec

from adaptdrive.mqtt import commands, contract
from adaptdrive.runtime.reports import CommandReport, Keep, State
from adaptdrive.runtime.requests import Request
from adaptdrive.util.errors import NOT_JSON, AdaptdriveError, RefusedError
from adaptdrive.util.lines import Level, write_line

# Memory of the replies, so that a repeated command acts once and gets the same reply.

LIMIT = 1000
LIFETIME_S = 24 * 3600.0
FORGOTTEN = "the reply to the first command with this id cannot be read any more"

Recalled = tuple[str, float, bytes]
"""Id, age in seconds and contents of a reply of an earlier run."""


_Entry = tuple[contract.Reply, float, str | None]
"""A reply, when it was given (monotonic), and what its command asked for, None if not known."""


@dataclass
class ReplyMemory:
    """The last replies by id, across restarts.

    Ages run on the monotonic clock, so that a wall clock which is set right after start does not
    make the daemon forget.

    Attributes:
        recalled: Replies of an earlier run, the oldest first; an id whose reply cannot be read is
            refused when it comes again.
        post: Has the log keep the contents of a reply by its id.
        monotonic: Clock of the ages.
        limit: Most replies.
    """

    recalled: InitVar[Iterable[Recalled]]
    post: Callable[[str, bytes], None]
    monotonic: Callable[[], float]
    limit: int = LIMIT

    def __post_init__(self, recalled: Iterable[Recalled]) -> None:
        now_s = self.monotonic()
        self._entries = OrderedDict(
            (identity, _entry(identity, now_s - age_s, body)) for identity, age_s, body in recalled
        )

    def recall(self, identity: str) -> contract.Reply | None:
        """The first reply to a command with this id, None for a new one."""
        self._forget()
        entry = self._entries.get(identity)
        return entry[0] if entry else None

    def asked(self, identity: str) -> str | None:
        """Return the content of the first command with this id, None where it is not known."""
        entry = self._entries.get(identity)
        return entry[2] if entry else None

    def note(self, identity: str, reply: contract.Reply, asked: str | None = None) -> None:
        """Remember the reply to a command; returns at once, the disk follows.

        Args:
            identity: Id of the command.
            reply: The reply.
            asked: What the command asked for with its verb, None where nobody compares it.
        """
        self._entries.pop(identity, None)
        self._entries[identity] = reply, self.monotonic(), asked
        self.post(identity, msgspec.json.encode((reply, asked)))
        self._forget()

    def _forget(self) -> None:
        oldest_s = self.monotonic() - LIFETIME_S
        while self._entries:
            identity, (_, born_s, _) = next(iter(self._entries.items()))
            if len(self._entries) <= self.limit and born_s >= oldest_s:
                return
            del self._entries[identity]


def _entry(identity: str, born_s: float, body: bytes) -> _Entry:
    asked: str | None = None
    try:
        reply, asked = msgspec.json.decode(body, type=tuple[contract.Reply, str | None])
    except NOT_JSON:
        earlier = "an earlier command"
        reply = contract.Reply(identity, earlier, accepted=False, reason=FORGOTTEN, state=None)
    return reply, born_s, asked


# Lines on stderr, which are bounded.


@dataclass(slots=True)
class LineRation:
    """Lets so many lines out in each interval, and counts those that it withholds.

    Attributes:
        monotonic: Clock.
        lines: Lines in each interval.
        interval_s: Length of an interval.
        began_s: When the present interval began, on that clock.
        used: Lines written in it.
        withheld: Lines withheld since the last one that was written.
    """

    monotonic: Callable[[], float]
    lines: int = 20
    interval_s: float = 10.0
    began_s: float = -math.inf
    used: int = 0
    withheld: int = 0

    def take(self) -> int | None:
        """Return how many lines were withheld before this one, None when this one is withheld."""
        now_s = self.monotonic()
        if now_s - self.began_s >= self.interval_s:
            self.began_s, self.used = now_s, 0
        if self.used >= self.lines:
            self.withheld += 1
            return None
        self.used += 1
        withheld, self.withheld = self.withheld, 0
        return withheld


# Processing of commands: refuse, repeat or carry out, and always record.

INTERRUPTED = "the daemon stopped while it carried this out; it may or may not have taken effect"
OVERTAKEN = "a disable arrived after this command and before it was carried out"
RETAINED = "retained commands are not carried out; publish without retain"
UNREADABLE = "id: not readable; give each command an id of 1 to 128 characters"
LONGEST_REASON = 500


@dataclass(frozen=True)
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

    @cached_property
    def payload(self) -> commands.Payload:
        """Its payload, read when it is first looked at: a stop comes before that."""
        return commands.Payload(self.raw)

    @property
    def remains_on_broker(self) -> bool:
        """True if the broker retains it; a retained message without a payload is a deletion."""
        return self.retained and bool(self.raw)

    @property
    def memorable(self) -> bool:
        """True if its id can identify it: only text does."""
        identity = self.payload.id
        return isinstance(identity, str) and 1 <= len(identity) <= commands.LONGEST_ID

    def reply(
        self, state: State | None, reason: str = "", trip_kind: str = "", *, accepted: bool = False
    ) -> contract.Reply:
        """Return a reply to it."""
        rest = accepted, _clean(reason), state, trip_kind or None
        return contract.Reply(self.payload.id, self.verb, *rest)


@dataclass
class Desk:
    """Answers commands, one after another, but stops at once.

    Attributes:
        host: Carries requests out.
        memory: Replies by id.
        present_state: Returns the state of the drive.
        wall: Wall clock.
        ration: Bounds the lines on stderr.
        report: Takes a report of each command that was answered for the first time.
        kept: Waits until the report is recorded, before the command is answered.
        shutting_down: Returns whether the daemon ends.
    """

    host: commands.Host
    memory: ReplyMemory
    present_state: Callable[[], State | None]
    wall: Callable[[], datetime]
    ration: LineRation
    report: Callable[[CommandReport], None]
    kept: Keep
    shutting_down: Callable[[], bool]
    _turn: asyncio.Lock = field(default_factory=asyncio.Lock, init=False)
    _stops: int = field(default=0, init=False)

    async def run(self) -> None:
        """Own the commands under way until cancelled: a lost broker leaves none half done."""
        async with asyncio.TaskGroup() as self._tasks:
            await asyncio.Event().wait()

    async def ask(self, command: OperatorCommand) -> contract.Reply:
        """Answer a command in a task that outlives its caller."""
        return await asyncio.shield(self._tasks.create_task(self.answer(command)))

    def receive(self, verb: str, raw: bytes, *, retained: bool) -> OperatorCommand:
        """Take a command as it arrives; `disable` is carried out here, whatever its payload."""
        stopped = None
        if verb == commands.STOP:
            stopped = self.host.stop()
            self._stops += 1
        return OperatorCommand(_clean(verb), raw, retained, self._stops, stopped)

    async def answer(self, command: OperatorCommand) -> contract.Reply:
        """Carry out a command unless a rule forbids it.

        Returns:
            The reply; its id is None where the command has no readable one.
        """
        if command.payload.id is None:
            self._log_unreadable(command)
        if command.stopped is not None:
            reply = self._confirm(command, command.stopped)
        elif command.payload.id is None:
            return self._refused(command, self._flaw(command) or UNREADABLE)
        elif command.verb == commands.PING:
            reply = await self._outcome(command, self._acknowledge(command))
        else:
            async with self._turn:
                reply = self._repeated(command) or await self._decide(command)
        await self.kept()
        self._log_reply(reply)
        return reply

    def refuse(self, command: OperatorCommand, reason: str) -> contract.Reply:
        """Refuse a command without looking further than its id."""
        reply = self._refused(command, reason)
        if reply.id is None:
            self._log_unreadable(command)
        else:
            self._report_reply(command, reply)
            self._log_reply(reply)
        return reply

    def _refused(self, command: OperatorCommand, reason: str) -> contract.Reply:
        return command.reply(self.present_state(), reason)

    async def _outcome(
        self, command: OperatorCommand, work: Awaitable[State | None]
    ) -> contract.Reply:
        try:
            return command.reply(await work, accepted=True)
        except AdaptdriveError as problem:
            kind = problem.kind if isinstance(problem, RefusedError) else ""
            return command.reply(self.present_state(), str(problem), kind)

    async def _acknowledge(self, command: OperatorCommand) -> State | None:
        """Carry out a command that changes nothing and is not recorded."""
        self._refuse_retained(command)
        self._refuse_expired(command.payload.expires)
        return self.present_state()

    def _confirm(self, command: OperatorCommand, state: State) -> contract.Reply:
        """Return the reply to a stop; it is accepted whatever is wrong with its payload."""
        flaw = self._flaw(command)
        reason = f"carried out, although: {flaw}" if flaw else ""
        reply = command.reply(state, reason, accepted=True)
        if command.memorable and self._other_use(command) is None:
            self.memory.note(str(reply.id), reply)
        self._report_reply(command, reply)
        return reply

    def _flaw(self, command: OperatorCommand) -> str:
        if command.retained:
            return "it is retained; publish without retain"
        if command.verb == commands.PING:
            return ""
        try:
            self._read(command)
        except AdaptdriveError as problem:
            return str(problem)
        return self._other_use(command) or ""

    def _log_unreadable(self, command: OperatorCommand) -> None:
        size, stopped = len(command.raw), command.stopped is not None
        facts = {"verb": command.verb, "size": size, "carried_out": stopped}
        self._write("warning", "command without a readable id", facts)

    def _log_reply(self, reply: contract.Reply) -> None:
        facts = {"id": reply.id, "verb": reply.verb, "accepted": reply.accepted}
        self._write("info", "command", facts | {"reason": reply.reason or None})

    def _write(self, level: Level, event: str, facts: Mapping[str, object]) -> None:
        """Write a line, unless too many were written.

        A daemon that ends withholds none: it may have no time left for its session.
        """
        if self.shutting_down():
            self.ration.lines = sys.maxsize
        if (withheld := self.ration.take()) is not None:
            write_line(level, event, **facts, withheld_lines=withheld)

    def _repeated(self, command: OperatorCommand) -> contract.Reply | None:
        """Return the reply to a command whose id is known, None for a new one."""
        flaw = self._other_use(command)
        return self._recall(command) if flaw is None else self._refused(command, flaw)

    def _other_use(self, command: OperatorCommand) -> str | None:
        """Return what else the id of a command was used for, None where it was not."""
        known, identity = self._recall(command), command.payload.id
        if known is None:
            return None
        asked = self.memory.asked(str(identity))
        if known.verb != command.verb:
            use = f"by {known.verb!r}"
        elif asked is not None and asked != command.payload.asked(command.verb):
            use = "with another value"
        else:
            return None
        return _clean(f"id {identity!r} was used {use}; give each command its own id")

    def _recall(self, command: OperatorCommand) -> contract.Reply | None:
        """Return the reply to the first command with this id."""
        return self.memory.recall(str(command.payload.id)) if command.memorable else None

    async def _decide(self, command: OperatorCommand) -> contract.Reply:
        reply = await self._outcome(command, self._carry_out(command))
        if command.memorable:
            self._remember(command, reply)
        self._report_reply(command, reply)
        return reply

    def _remember(self, command: OperatorCommand, reply: contract.Reply) -> None:
        asked = command.payload.asked(command.verb)
        self.memory.note(str(command.payload.id), reply, asked)

    def _report_reply(self, command: OperatorCommand, reply: contract.Reply) -> None:
        identity, payload = "" if reply.id is None else str(reply.id), command.payload
        value, user = _clean(payload.value), payload.user
        self.report(CommandReport(identity, reply.verb, value, user, reply.accepted, reply.reason))

    def _read(self, command: OperatorCommand) -> tuple[Request, datetime | None]:
        self._refuse_retained(command)
        request, expires = command.payload.request(command.verb)
        self._refuse_expired(expires)
        return request, expires

    async def _carry_out(self, command: OperatorCommand) -> State:
        request, expires = self._read(command)
        self._refuse_overtaken(command)
        # Written first: a daemon that dies in between must not act a second time on a repeat.
        self._remember(command, command.reply(None, INTERRUPTED))
        await self.kept()
        self._refuse_overtaken(command)
        self._refuse_expired(expires)
        return await self.host.execute(request)

    def _refuse_retained(self, command: OperatorCommand) -> None:
        if command.retained:
            raise RefusedError(RETAINED)

    def _refuse_overtaken(self, command: OperatorCommand) -> None:
        if command.stops != self._stops:
            raise RefusedError(OVERTAKEN)

    def _refuse_expired(self, expires: datetime | None) -> None:
        now = self.wall()
        if expires is not None and expires <= now:
            raise RefusedError(
                f"expired at {expires.isoformat()}; the daemon's clock says {now.isoformat()}"
            )


def _clean(reason: str) -> str:
    """Return one line that any terminal and any JSON reader takes."""
    return commands.printable(reason)[:LONGEST_REASON]
