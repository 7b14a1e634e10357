"""Memory of the replies, so that a repeated command acts once and gets the same reply."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import InitVar, dataclass

import msgspec

from adaptdrive.errors import NOT_JSON
from adaptdrive.operation.clock import Monotonic
from adaptdrive.operation.messages import Reply

LIMIT = 1000
LIFETIME_S = 24 * 3600.0
UNREADABLE = "the reply to the first command with this id cannot be read any more"

Recalled = tuple[str, float, bytes]
"""Id, age in seconds and contents of a reply of an earlier run."""


@dataclass(frozen=True, slots=True)
class _Entry:
    reply: Reply
    born_s: float
    asked: str | None = None


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
    monotonic: Monotonic
    limit: int = LIMIT

    def __post_init__(self, recalled: Iterable[Recalled]) -> None:
        now_s = self.monotonic()
        self._entries = OrderedDict(
            (identity, _entry(identity, now_s - age_s, body)) for identity, age_s, body in recalled
        )

    def recall(self, identity: str) -> Reply | None:
        """The first reply to a command with this id, None for a new one."""
        self._forget()
        entry = self._entries.get(identity)
        return entry.reply if entry else None

    def asked(self, identity: str) -> str | None:
        """Return the content of the first command with this id, None where it is not known."""
        entry = self._entries.get(identity)
        return entry.asked if entry else None

    def note(self, identity: str, reply: Reply, asked: str | None = None) -> None:
        """Remember the reply to a command; returns at once, the disk follows.

        Args:
            identity: Id of the command.
            reply: The reply.
            asked: What the command asked for with its verb, None where nobody compares it.
        """
        self._entries.pop(identity, None)
        self._entries[identity] = _Entry(reply, self.monotonic(), asked)
        self.post(identity, msgspec.json.encode((reply, asked)))
        self._forget()

    def _forget(self) -> None:
        oldest_s = self.monotonic() - LIFETIME_S
        while self._entries:
            identity, entry = next(iter(self._entries.items()))
            if len(self._entries) <= self.limit and entry.born_s >= oldest_s:
                return
            del self._entries[identity]


def _entry(identity: str, born_s: float, body: bytes) -> _Entry:
    try:
        reply, asked = msgspec.json.decode(body, type=tuple[Reply, str | None])
        return _Entry(reply, born_s, asked)
    except NOT_JSON:
        reply = Reply(identity, "an earlier command", accepted=False, reason=UNREADABLE, state=None)
        return _Entry(reply, born_s)
