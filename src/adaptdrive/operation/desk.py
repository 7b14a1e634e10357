"""Where commands are answered: refuse, repeat, or carry out, and always remember."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from datetime import datetime

import structlog
from msgspec.structs import replace

from adaptdrive.errors import AdaptdriveError, RefusedError
from adaptdrive.operation.clock import WallClock
from adaptdrive.operation.commands import LONGEST_ID, Payload
from adaptdrive.operation.memory import ReplyMemory
from adaptdrive.operation.messages import Reply
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import Host, Request

INTERRUPTED = "the daemon stopped while it carried this out; it may or may not have taken effect"
LONGEST_REASON = 500


class Desk:
    """Answers commands, one after another."""

    def __init__(
        self,
        host: Host,
        memory: ReplyMemory,
        present_state: Callable[[], State | None],
        wall: WallClock,
    ) -> None:
        self._host = host
        self._memory = memory
        self._present_state = present_state
        self._wall = wall
        self._turn = asyncio.Lock()
        self._log = structlog.get_logger()

    async def answer(self, verb: str, raw: bytes, retained: bool) -> Reply | None:
        """Carry out a command unless a rule forbids it.

        Args:
            verb: Last part of the topic.
            raw: Payload as it came.
            retained: Whether the broker says that it was published as a retained message.

        Returns:
            The reply, None where no id can be read to reply to.
        """
        payload = Payload(raw)
        if payload.id is None:
            self._log.debug("command without a readable id", verb=verb, size=len(raw))
            return None
        async with self._turn:
            if not _memorable(payload.id):
                return await self._decide(verb, payload, retained)
            known = self._memory.recall(str(payload.id))
            return known or await self._decide_and_keep(verb, payload, retained)

    async def _decide_and_keep(self, verb: str, payload: Payload, retained: bool) -> Reply:
        reply = await self._decide(verb, payload, retained)
        await self._memory.keep(str(payload.id), reply)
        self._log.info("command", id=reply.id, verb=verb, refused=reply.reason or None)
        return reply

    async def _decide(self, verb: str, payload: Payload, retained: bool) -> Reply:
        reply = Reply(id=payload.id or "", verb=verb, accepted=False, reason="", state=None)
        try:
            _refuse_retained(retained=retained)
            request, expires = payload.request(verb)
            self._refuse_expired(expires)
            state = await self._carry_out(request, replace(reply, reason=INTERRUPTED))
        except AdaptdriveError as problem:
            return replace(reply, reason=_clean(str(problem)), state=self._present_state())
        return replace(reply, accepted=True, state=state)

    async def _carry_out(self, request: Request, doubt: Reply) -> State:
        # Written first: a daemon that dies in between must not act a second time on a repeat.
        await self._memory.keep(str(doubt.id), doubt)
        return await self._host.execute(request)

    def _refuse_expired(self, expires: datetime | None) -> None:
        now = self._wall()
        if expires is not None and expires <= now:
            raise RefusedError(
                f"expired at {expires.isoformat()}; the daemon's clock says {now.isoformat()}"
            )


def _memorable(identity: str | int) -> bool:
    return isinstance(identity, str) and 1 <= len(identity) <= LONGEST_ID


def _refuse_retained(*, retained: bool) -> None:
    if retained:
        raise RefusedError("retained commands are not carried out; publish without retain")


def _clean(reason: str) -> str:
    """One line that any terminal and any JSON reader takes."""
    shown = "".join(letter if letter.isprintable() else "?" for letter in reason)
    return shown[:LONGEST_REASON]
