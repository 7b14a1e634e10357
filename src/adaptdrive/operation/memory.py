"""Memory of the replies given, so that a repeated command acts once and hears the same."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

import msgspec

from adaptdrive.operation.clock import Monotonic, WallClock
from adaptdrive.operation.journal import Journal
from adaptdrive.operation.messages import Reply, encode

LIMIT = 1000
LIFETIME_S = 24 * 3600.0
PATIENCE_S = 1.0


@dataclass(frozen=True, slots=True)
class _Entry:
    reply: Reply
    born_s: float


class ReplyMemory:
    """The last replies by id, across restarts.

    Ages run on the monotonic clock, so that a wall clock which is set right after start does not
    make the daemon forget; only the time between two runs is taken from the wall clock.
    """

    def __init__(
        self, journal: Journal, wall: WallClock, monotonic: Monotonic, limit: int = LIMIT
    ) -> None:
        self._journal = journal
        self._wall = wall
        self._monotonic = monotonic
        self._limit = limit
        self._entries: OrderedDict[str, _Entry] = OrderedDict()

    async def load(self) -> None:
        """Recall what an earlier run replied."""
        now_s, wall_s = self._monotonic(), self._wall().timestamp()
        for identity, time_s, body in await self._journal.rows(
            "SELECT id, time_s, body FROM reply ORDER BY rowid"
        ):
            age_s = max(0.0, wall_s - time_s)
            reply = msgspec.json.decode(body, type=Reply)
            self._entries[identity] = _Entry(reply, now_s - age_s)
        self._forget()

    def recall(self, identity: str) -> Reply | None:
        """The first reply to a command with this id, None for a new one."""
        self._forget()
        entry = self._entries.get(identity)
        return entry.reply if entry else None

    async def keep(self, identity: str, reply: Reply) -> None:
        """Remember the reply to a command; returns when it is on disk, or the disk too slow."""
        self.note(identity, reply)
        await self._journal.written(PATIENCE_S)

    def note(self, identity: str, reply: Reply) -> None:
        """Remember the reply to a command; returns at once, the disk follows."""
        self._entries[identity] = _Entry(reply, self._monotonic())
        self._journal.post(
            "INSERT OR REPLACE INTO reply VALUES (?, ?, ?)",
            (identity, self._wall().timestamp(), encode(reply)),
        )
        self._forget()

    def _forget(self) -> None:
        oldest_s = self._monotonic() - LIFETIME_S
        while self._entries:
            identity, entry = next(iter(self._entries.items()))
            if len(self._entries) <= self._limit and entry.born_s >= oldest_s:
                return
            del self._entries[identity]
            self._journal.post("DELETE FROM reply WHERE id = ?", (identity,))
