"""Batches on their way to the recorder process: each is kept until that has written it.

They are kept in memory for a recorder process that dies, and in a file for the end of this process.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec

from adaptdrive.recording.batches import STOPPED, UNBEGUN, Batch, Header, News, framed
from adaptdrive.recording.session import Dropped
from adaptdrive.recording.spool import Spool, spool_path
from adaptdrive.recording.writer_process import WriterProcess
from adaptdrive.runtime.reports import Severity

_SHORTEST_PAUSE_S, _LONGEST_PAUSE_S = 0.1, 30.0
_LARGEST_SPOOL_BYTES = 4 << 20
_FAILING_CLOSE_S = 2.0
"""Patience at the end with a recorder that has been failing already."""


@dataclass(frozen=True, slots=True)
class _Sent:
    number: int
    message: bytes
    rows: Dropped


class Delivery:
    """Keeps a recorder process running, and repeats what one that died had not written.

    Attributes:
        directory: Folder of the session, empty until there is one.
        failing: Whether what is handed over is not written now.
    """

    def __init__(
        self,
        header: Header,
        backlog_bytes: int,
        report: Callable[[Severity, str], None],
        start_thread: Callable[[], None] = lambda: None,
    ) -> None:
        """Prepare to deliver.

        Args:
            header: The session.
            backlog_bytes: Bytes that may wait to be written before batches are refused.
            report: Reports an event.
            start_thread: What a thread does first.
        """
        self._spool = Spool(spool_path(Path(header.sessions), header.info), start_thread)
        self.directory = ""
        self._header = header
        self._backlog_bytes = backlog_bytes
        self._report = report
        self._writer: WriterProcess | None = None
        self._unwritten: deque[_Sent] = deque()
        self._waiting_bytes = 0
        self.failing = False
        self._cause: str | None = None
        self._number = 0

    @property
    def full(self) -> bool:
        """True while batches with rows of tables are refused."""
        return self._is_full(1)

    def _is_full(self, times: int) -> bool:
        return self._waiting_bytes >= times * self._backlog_bytes

    def offer(self, batch: Batch, *, urgent: bool = False) -> bool:
        """Hand over a batch at once; False when too much waits already.

        Args:
            batch: What to hand over; one without rows of tables may double the backlog.
            urgent: Add it to the backlog however long that is.
        """
        few = not (batch.tick_rows or batch.slow or batch.sensors)
        if not urgent and (self._is_full(2) if few else self.full):
            return False
        self._number += 1
        message = framed(msgspec.structs.replace(batch, number=self._number))
        rows = Dropped(batch.tick_rows, len(batch.slow), len(batch.events), len(batch.commands))
        self._unwritten.append(_Sent(self._number, message, rows))
        self._waiting_bytes += len(message)
        self._keep(message)
        if self._writer is not None:
            self._writer.send(message)
        return True

    def _keep(self, message: bytes) -> None:
        """Append a message to the file; one that has grown, lacks a message or is lost begins anew.

        It then has all that is unwritten.
        """
        spool = self._spool
        if (
            spool.lost
            or not spool.sound
            or spool.size > 2 * self._backlog_bytes + _LARGEST_SPOOL_BYTES
        ):
            spool.clear()
        if self._spool.size:
            self._spool.append(message)
            return
        self._spool.append(framed(self._header))
        for sent in self._unwritten:
            self._spool.append(sent.message)

    async def kept(self, patience_s: float) -> None:
        """Wait until the file has all that was offered.

        Args:
            patience_s: Longest wait.
        """
        await self._spool.kept(patience_s)

    async def run(self) -> None:
        """Keep a recorder process running until cancelled."""
        pause_s = _SHORTEST_PAUSE_S
        while True:
            before = self._number_written
            cause = await self._serve()
            if self._number_written > before:
                pause_s = _SHORTEST_PAUSE_S
            self._fail(cause)
            await asyncio.sleep(pause_s)
            pause_s = min(2.0 * pause_s, _LONGEST_PAUSE_S)

    async def finish(self, dropped: Dropped, timeout_s: float) -> Dropped:
        """Have everything written and the session closed; `run` must have ended.

        Args:
            dropped: What was lost before.
            timeout_s: Longest wait for each of three: the recorder process, another one in its
                place, and the file that keeps the rest for the next start.

        Returns:
            What was lost now: it is reported.
        """
        cause = await self._drain(min(timeout_s, _FAILING_CLOSE_S) if self.failing else timeout_s)
        if self._unwritten and not self.failing:
            cause = await self._drain(timeout_s)  # a new process, for one that died or stood still
        if self._unwritten:
            return await self._give_up(dropped, cause or "the recorder process ended", timeout_s)
        self._spool.remove()
        if cause is not None:
            self._report(Severity.WARNING, f"the next start completes the session's files: {cause}")
        return Dropped()

    async def finish_again(self, timeout_s: float) -> Dropped:
        """Have what was offered after `finish` written, or left to the next start with the rest.

        Args:
            timeout_s: Longest wait for a recorder process, which has to be started.

        Returns:
            What was lost now: it is reported.
        """
        cause: str | None = "the disk does not answer"
        if len(self._unwritten) > 1:  # the end of the session is left to the next start
            kept = await self._flushed(timeout_s)
        else:
            cause = await self._drain(timeout_s)
            kept = not self._unwritten
        if kept:
            return Dropped()
        lost = self._unwritten[-1].rows
        self._report(Severity.ALARM, f"not recorded after the end of the session, {lost}: {cause}")
        return lost

    async def _give_up(self, dropped: Dropped, cause: str, timeout_s: float) -> Dropped:
        left = sum((sent.rows for sent in self._unwritten), start=Dropped())
        if await self._flushed(timeout_s):
            detail = f"the next start records the end of the session, {left}: {cause}"
            self._report(Severity.WARNING, detail)
            return Dropped()
        self._report(Severity.ALARM, f"the end of the session is not recorded, {left}: {cause}")
        await self._close_short(dropped + left, timeout_s)
        return left

    async def _flushed(self, timeout_s: float) -> bool:
        """Return whether the file has everything; False, too, where no helper thread is free."""
        try:
            async with asyncio.timeout(2.0 * timeout_s):
                return await asyncio.to_thread(self._spool.flushed, timeout_s)
        except TimeoutError:
            return False

    @property
    def _number_written(self) -> int:
        return self._unwritten[0].number - 1 if self._unwritten else self._number

    async def _drain(self, timeout_s: float) -> str | None:
        """Close the pipe and wait for the process; what went wrong, None when nothing did."""
        try:
            async with asyncio.timeout(timeout_s):
                if self._writer is None:
                    self._writer = await self._started()
                self._writer.hang_up()
                await self._listen(self._writer)
                cause = await self._writer.ended()
        except TimeoutError:
            cause = f"the recorder process did not finish within {timeout_s:g} s"
        except OSError as problem:
            cause = str(problem)
        await self._dismiss()
        return cause

    async def _close_short(self, dropped: Dropped, timeout_s: float) -> None:
        """Have another process write how the session ended, and nothing else."""
        self._unwritten.clear()
        if not self.directory:
            return
        self.offer(Batch(0, {}, [], [], dropped, last=True), urgent=True)
        if (cause := await self._drain(timeout_s)) is not None:
            self._report(Severity.ALARM, f"session.json does not say how it ended: {cause}")

    async def _serve(self) -> str:
        """Run one process until it ends; why it did."""
        try:
            self._writer = await self._started()
        except OSError as problem:
            return str(problem)
        await self._listen(self._writer)
        cause = await self._writer.ended()
        self._writer = None
        return cause or "the recorder process ended"

    async def _started(self) -> WriterProcess:
        writer = await WriterProcess.start(Path(self._header.sessions))
        writer.send(framed(msgspec.structs.replace(self._header, directory=self.directory)))
        for sent in self._unwritten:
            writer.send(sent.message)
        return writer

    async def _listen(self, writer: WriterProcess) -> None:
        async for news in writer.news():
            self._take(news)

    def _take(self, news: News) -> None:
        self.directory = news.directory or self.directory
        while self._unwritten and self._unwritten[0].number <= news.written:
            self._waiting_bytes -= len(self._unwritten.popleft().message)
            if self._cause is not None:
                self._report(Severity.INFO, "recording goes on in another recorder process")
            self.failing, self._cause = False, None
            if not self._unwritten:
                self._spool.clear()
        if news.detail:
            self.failing = self.failing or news.failing
            self._report(Severity(news.severity), news.detail)

    def _fail(self, cause: str) -> None:
        """Report a failure, but not the same one with each attempt."""
        self.failing = True
        if cause != self._cause:
            self._report(Severity.ALARM, f"{STOPPED if self.directory else UNBEGUN}: {cause}")
        self._cause = cause

    async def _dismiss(self) -> None:
        if self._writer is not None:
            await self._writer.kill()
            self._writer = None
