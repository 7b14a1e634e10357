"""The recorder process: reads batches from its standard input and puts them on disk.

It ends when its input ends, which it does in every way that the control process can go. It is
started by the recorder service as `python -m adaptdrive.recording.writer SESSIONS`.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sqlite3
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

import msgspec
import pyarrow as pa

from adaptdrive.errors import escaped
from adaptdrive.recording import reserve
from adaptdrive.recording.batches import STOPPED, UNBEGUN, Batch, Header, News, read_frames
from adaptdrive.recording.housekeeping import ERRORS, Housekeeper
from adaptdrive.recording.recovery import left_batches, recover
from adaptdrive.recording.session import Dropped, Ending, SessionLock
from adaptdrive.recording.session_writer import SessionWriter
from adaptdrive.recording.spool import spool_path
from adaptdrive.runtime.reports import Severity

SendNews = Callable[[News], None]

_LONGEST_PAUSE_S = 10.0
_ORPHAN_PATIENCE_S = 60.0
"""Time for which a recorder without a control process tries to write its remaining data."""


class PatientWriter:
    """Writes a session; what fails is tried again, in a new segment, until it succeeds."""

    def __init__(self, header: Header, send: SendNews, *, pause_s: float = 0.5) -> None:
        """Prepare to write.

        Args:
            header: The session.
            send: Passes news to the control process.
            pause_s: Pause after the first failure; each further one is twice as long.
        """
        self._header = header
        self._send = send
        self._pause_s = pause_s
        self._writer: SessionWriter | None = None
        self._claim: SessionLock | None = None  # between two attempts, when no writer has it
        self._was_full = False
        self._housekeeper = Housekeeper(lambda detail: self._report(Severity.WARNING, detail))
        self._parent = os.getppid()
        self._housekeeper.submit(self._recover)

    def write(self, batch: Batch) -> None:
        """Put one batch on disk, however long that takes; the last one closes the session.

        A batch is acknowledged once all that it asks for is done.

        Raises:
            OSError: The control process is gone, and the disk has failed for long.
        """
        self._insist(lambda writer: self._write(writer, batch))
        self._was_full = False
        if batch.last:
            self.close(Ending.ORDERLY, batch.dropped)
        self._send(News(written=batch.number))

    def close(self, ending: Ending, dropped: Dropped) -> None:
        """Close the session.

        Raises:
            OSError: The control process is gone, and the disk has failed for long.
        """
        self._insist(lambda writer: writer.close(ending, dropped))

    def leave(self) -> None:
        """Leave the session as it is, to be gone on with at the next start."""
        self._interrupt()
        if self._claim is not None:
            self._claim.release()
            self._claim = None

    def finish(self) -> None:
        """Wait until the closed session is in order."""
        self._housekeeper.finish()

    def _recover(self) -> None:
        own = spool_path(Path(self._header.sessions), self._header.info)
        recover(own, self._report, self._housekeeper)

    def _write(self, writer: SessionWriter, batch: Batch) -> None:
        if self._was_full and batch.tick_rows:
            # what the record of a trip has just released is not for ticks
            reserve.set_aside(writer.directory.parent)
        writer.write(batch)

    def _insist(self, act: Callable[[SessionWriter], None]) -> None:
        pause_s, waited_s, reported = self._pause_s, 0.0, ""
        while (problem := self._try(act)) is not None:
            self._give_up(problem, waited_s)
            if str(problem) != reported:  # another one may follow the first, such as a full disk
                reported = str(problem)
                detail = f"{STOPPED if self._header.directory else UNBEGUN}: {problem}"
                self._send(News(severity=Severity.ALARM.value, detail=detail, failing=True))
            time.sleep(pause_s)
            waited_s += pause_s
            pause_s = min(2.0 * pause_s, _LONGEST_PAUSE_S)
        if waited_s and self._writer is not None:
            self._report(Severity.INFO, f"recording goes on in segment {self._writer.segment}")

    def _try(self, act: Callable[[SessionWriter], None]) -> Exception | None:
        try:
            act(self._opened())
        except ERRORS as problem:
            return problem
        return None

    def _opened(self) -> SessionWriter:
        if self._writer is None:
            self._writer = SessionWriter(
                self._header, self._report, self._housekeeper, self._held_claim()
            )
            self._claim = None
            directory = str(self._writer.directory)
            self._header = msgspec.structs.replace(self._header, directory=directory)
            self._send(News(directory=directory))
        return self._writer

    def _held_claim(self) -> SessionLock | None:
        """Return the lock of the session that is gone on with, None where its folder is gone."""
        if self._claim is not None and not self._claim.covers(Path(self._header.directory)):
            self._claim.release()
            self._claim = None
        return self._claim

    def _interrupt(self) -> None:
        """Leave the files as they are; the lock keeps others from pruning or closing them."""
        if self._writer is not None:
            self._claim = self._writer.interrupt()
            self._writer = None

    def _give_up(self, problem: Exception, waited_s: float) -> None:
        """Leave the files as they are; end when the control process has ended."""
        self._was_full |= reserve.is_full(problem)
        self._interrupt()
        if os.getppid() != self._parent and waited_s > _ORPHAN_PATIENCE_S:
            raise problem

    def _report(self, severity: Severity, detail: str) -> None:
        self._send(News(severity=severity.value, detail=detail))


def record(source: BinaryIO, send: SendNews) -> None:
    """Record one session from a stream of messages until that ends.

    Args:
        source: Messages; nothing is made of a source without any.
        send: Passes news to the control process.
    """
    frames = read_frames(source)
    first = next(frames, None)
    if first is None:
        return
    header = msgspec.msgpack.decode(first, type=Header)
    writer = PatientWriter(header, send)
    last = _write_new(writer, _batches(frames), None)
    if last is None or not last.last:
        _write_rest(writer, spool_path(Path(header.sessions), header.info), last)
    writer.finish()


def _batches(frames: Iterator[bytes]) -> Iterator[Batch]:
    decoder = msgspec.msgpack.Decoder(Batch)
    return map(decoder.decode, frames)


def _write_new(writer: PatientWriter, batches: Iterable[Batch], last: Batch | None) -> Batch | None:
    """Write the batches after the last one; return the last one written."""
    for batch in batches:
        if last is None or not batch.number or batch.number > last.number:
            writer.write(batch)
            last = batch
    return last


def _write_rest(writer: PatientWriter, spool: Path, last: Batch | None) -> None:
    """Write what a control process that was killed had not put into the pipe, and close.

    What cannot be read is left to the next start, and the end of the session with it.
    """
    left = left_batches(spool)
    if left is None:
        writer.leave()
        return
    last = _write_new(writer, left, last)
    if last is None or not last.last:
        writer.close(Ending.CUT, Dropped() if last is None else last.dropped)
    spool.unlink(missing_ok=True)


def step_aside() -> None:
    """Leave the processor and the signals to the control process, whose child this is."""
    # A service manager and a terminal signal every process; this one ends with its input.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGABRT):
        signal.signal(number, signal.SIG_IGN)
    # A file larger than allowed is an error of the disk like others.
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    # Real-time priority is inherited. Where the system forbids a change, it records all the same.
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        os.nice(5)


def send_to_parent(news: News) -> None:
    """Report to the control process, if it is still there."""
    news = msgspec.structs.replace(news, detail=escaped(news.detail))
    with contextlib.suppress(OSError):
        os.write(sys.stdout.fileno(), msgspec.json.encode(news) + b"\n")


def main() -> None:
    """Run the recorder process."""
    step_aside()
    try:
        record(sys.stdin.buffer, send_to_parent)
    except (OSError, sqlite3.Error, pa.ArrowException, msgspec.MsgspecError) as problem:
        # Leave at once: closing what cannot be written would only fail again.
        print(f"{sys.argv[1]}: {problem}", file=sys.stderr, flush=True)  # noqa: T201
        os._exit(1)


if __name__ == "__main__":
    main()
