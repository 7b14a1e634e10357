"""Memory of the replies, so that a repeated command acts once and gets the same reply."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from contextlib import suppress
from dataclasses import dataclass

import msgspec

from adaptdrive.errors import NOT_JSON
from adaptdrive.operation.clock import Monotonic, WallClock
from adaptdrive.operation.journal import Journal
from adaptdrive.operation.messages import Reply, encode

LIMIT = 1000
LIFETIME_S = 24 * 3600.0
PATIENCE_S = 1.0
CLOCK_STEP_S = 60.0
"""Change of the difference of the two clocks that is no drift: the wall clock was set."""
UNREADABLE = "the reply to the first command with this id cannot be read any more"


@dataclass(frozen=True, slots=True)
class _Entry:
    reply: Reply
    born_s: float
    asked: str | None = None


class _Asked(msgspec.Struct):
    """The part of a row beside the reply; the rows of older versions have none."""

    asked: str | None = None


class ReplyMemory:
    """The last replies by id, across restarts.

    Ages run on the monotonic clock, so that a wall clock which is set right after start does not
    make the daemon forget; only the time between two runs is taken from the wall clock. The
    times in the file are of the wall clock, and are written anew after it was set.
    """

    def __init__(
        self, journal: Journal, wall: WallClock, monotonic: Monotonic, limit: int = LIMIT
    ) -> None:
        self._journal = journal
        self._wall = wall
        self._monotonic = monotonic
        self._limit = limit
        self._entries: OrderedDict[str, _Entry] = OrderedDict()
        self._loaded = asyncio.Event()
        self._written_ahead_s: float | None = None

    async def load(self) -> int:
        """Recall what an earlier run replied, as older than what this one has.

        Returns:
            Rows that cannot be read; an id that still can be is refused when it comes again.
        """
        rows = await self._journal.rows("SELECT id, time_s, body FROM reply ORDER BY rowid")
        kept = [(identity, time_s, _kept(identity, body)) for identity, time_s, body in rows]
        held, self._entries = self._entries, OrderedDict()
        for identity, time_s, known in kept:
            if isinstance(identity, str):
                reply, asked = known or (_unreadable(identity), None)
                self._entries[identity] = _Entry(reply, self._born_s(time_s), asked)
        self._entries.update(held)
        self._forget()
        self._written_ahead_s = self._wall_ahead_s()
        return sum(known is None for _, _, known in kept)

    def rewrite(self) -> None:
        """Write all that is remembered; the disk has missed some of it."""
        self._journal.post("DELETE FROM reply")
        ahead_s = self._written_ahead_s = self._wall_ahead_s()
        for identity, entry in self._entries.items():
            self._post(identity, ahead_s + entry.born_s, entry)

    def follow_clock(self) -> None:
        """Write all that is remembered where the wall clock was set since it was recalled."""
        known_ahead_s = self._written_ahead_s
        if known_ahead_s is not None and abs(self._wall_ahead_s() - known_ahead_s) > CLOCK_STEP_S:
            self.rewrite()

    def begin(self) -> None:
        """Let commands in: what an earlier run replied is known, or cannot be."""
        self._loaded.set()

    async def ready(self) -> None:
        """Wait until earlier replies are known; once, and not for long, as the disk may hang."""
        with suppress(TimeoutError):
            async with asyncio.timeout(PATIENCE_S):
                await self._loaded.wait()
        self.begin()

    def recall(self, identity: str) -> Reply | None:
        """The first reply to a command with this id, None for a new one."""
        self._forget()
        entry = self._entries.get(identity)
        return entry.reply if entry else None

    def asked(self, identity: str) -> str | None:
        """Return the content of the first command with this id, None where it is not known."""
        entry = self._entries.get(identity)
        return entry.asked if entry else None

    async def keep(self, identity: str, reply: Reply, asked: str | None = None) -> None:
        """Remember the reply to a command; returns when it is on disk, or the disk too slow."""
        self.note(identity, reply, asked)
        await self.written()

    async def written(self) -> None:
        """Wait until all that was noted is on disk, or the disk too slow."""
        await self._journal.written(PATIENCE_S)

    def note(self, identity: str, reply: Reply, asked: str | None = None) -> None:
        """Remember the reply to a command; returns at once, the disk follows.

        Args:
            identity: Id of the command.
            reply: The reply.
            asked: What the command asked for beside its verb, None where nobody compares it.
        """
        entry = self._entries[identity] = _Entry(reply, self._monotonic(), asked)
        self._post(identity, self._wall().timestamp(), entry)
        self._forget()

    def _post(self, identity: str, time_s: float, entry: _Entry) -> None:
        body = encode(msgspec.structs.asdict(entry.reply) | {"asked": entry.asked})
        row = identity, time_s, body
        self._journal.post("INSERT OR REPLACE INTO reply VALUES (?, ?, ?)", row)

    def _wall_ahead_s(self) -> float:
        """Return the difference of the wall clock from the monotonic one."""
        return self._wall().timestamp() - self._monotonic()

    def _born_s(self, time_s: object) -> float:
        """Return the monotonic time of a row."""
        now_s, wall_s = self._monotonic(), self._wall().timestamp()
        return now_s - (max(0.0, wall_s - time_s) if isinstance(time_s, int | float) else 0.0)

    def _forget(self) -> None:
        oldest_s = self._monotonic() - LIFETIME_S
        while self._entries:
            identity, entry = next(iter(self._entries.items()))
            if len(self._entries) <= self._limit and entry.born_s >= oldest_s:
                return
            del self._entries[identity]
            self._journal.post("DELETE FROM reply WHERE id = ?", (identity,))


def _kept(identity: object, body: object) -> tuple[Reply, str | None] | None:
    """Return the reply in a row and what was asked, None where they cannot be read."""
    if not isinstance(identity, str) or not isinstance(body, bytes | str):
        return None
    try:
        return msgspec.json.decode(body, type=Reply), msgspec.json.decode(body, type=_Asked).asked
    except NOT_JSON:
        return None


def _unreadable(identity: str) -> Reply:
    return Reply(identity, "an earlier command", accepted=False, reason=UNREADABLE, state=None)
