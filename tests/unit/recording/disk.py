"""A disk that has written all when it is asked, unless a test stalls or fills it.

The log is written and synced, and the archiver works, in the thread of the event loop: what was
appended is in the file when the call returns, and the clock is the test's.
"""

from __future__ import annotations

import asyncio
import queue
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from functools import partialmethod
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from adaptdrive.recording import recorder
from adaptdrive.recording import writer as writing
from adaptdrive.recording.archive import ERRORS, archive
from adaptdrive.recording.writer import LogWriter, sync_for_ever
from adaptdrive.runtime.reports import Severity

RETRY_S = 0.5


class _NothingLeftError(Exception):
    """A thread would wait now."""


class _Queue(queue.SimpleQueue[Any]):
    def get(self, block: bool = True, timeout: float | None = None) -> Any:
        try:
            return super().get(block=False)
        except queue.Empty:
            raise _NothingLeftError from None


def _passed(writer: LogWriter, act: Callable[[LogWriter], None]) -> None:
    act(writer)


class Disk:
    """What the logs of a test are written to."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self._stalled = False
        self._writers: list[LogWriter] = []
        patch.setattr(LogWriter, "start", partialmethod(_passed, self._start))
        patch.setattr(LogWriter, "wake", partialmethod(_passed, self._wake))
        patch.setattr(writing, "_PAUSE_S", 0.0)
        patch.setattr(writing, "time", SimpleNamespace(sleep=lambda _: None))

    @contextmanager
    def stalled(self) -> Iterator[None]:
        """Have it take nothing meanwhile, and refuse nothing."""
        self._stalled = True
        yield
        self._stalled = False
        for writer in tuple(self._writers):
            self._wake(writer)

    def _start(self, writer: LogWriter) -> None:
        self._writers.append(writer)
        writer._wakes, writer._syncs = _Queue(), _Queue()
        self._wake(writer)

    def _wake(self, writer: LogWriter) -> None:
        if self._stalled or writer not in self._writers:
            return
        writer._wakes.put(None)
        with suppress(_NothingLeftError):
            writer._write_for_ever()
            self._writers.remove(writer)
        with suppress(_NothingLeftError):
            sync_for_ever(writer._syncs, writer._notify)
        if not writer._idle:
            asyncio.get_running_loop().call_later(RETRY_S, self._wake, writer)


def archive_in_process(patch: pytest.MonkeyPatch) -> None:
    """Run the archiver here; its time is that of the event loop."""
    loop = asyncio.get_running_loop()

    def run(command: Sequence[str], notify: Callable[[Severity, str], None]) -> str:
        try:
            trips = archive(Path(command[4]), loop.time(), float(command[5]), notify)
        except ERRORS as problem:
            return str(problem)
        for directory in trips:
            notify(Severity.INFO, f"the record of the trip is in {directory}")
        return ""

    def at_once(call: Callable[[], str], _: str) -> Future[str]:
        done: Future[str] = Future()
        done.set_result(call())
        return done

    patch.setattr(recorder, "_run", run)
    patch.setattr(recorder, "in_thread", at_once)
