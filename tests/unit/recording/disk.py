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

from adaptdrive.recording import archiver
from adaptdrive.recording import log as log_module
from adaptdrive.recording.archive import ERRORS, archive
from adaptdrive.recording.log import Log
from adaptdrive.runtime.reports import Event, Severity
from adaptdrive.util.trends import HealthReport

RETRY_S = 0.5


class _NothingLeftError(Exception):
    """A thread would wait now."""


class _Queue(queue.SimpleQueue[Any]):
    def get(self, block: bool = True, timeout: float | None = None) -> Any:
        try:
            return super().get(block=False)
        except queue.Empty:
            raise _NothingLeftError from None


def _passed(log: Log, act: Callable[[Log], None]) -> None:
    act(log)


class Disk:
    """What the logs of a test are written to."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self._stalled = False
        self._logs: list[Log] = []
        patch.setattr(Log, "start", partialmethod(_passed, self._start))
        patch.setattr(Log, "_wake", partialmethod(_passed, self._wake))
        patch.setattr(log_module, "_PAUSE_S", 0.0)
        patch.setattr(log_module, "time", SimpleNamespace(sleep=lambda _: None))

    @contextmanager
    def stalled(self) -> Iterator[None]:
        """Have it take nothing meanwhile, and refuse nothing."""
        self._stalled = True
        yield
        self._stalled = False
        for log in tuple(self._logs):
            self._wake(log)

    def _start(self, log: Log) -> None:
        self._logs.append(log)
        log._loop = asyncio.get_running_loop()
        log._wakes, log._syncs = _Queue(), _Queue()
        self._wake(log)

    def _wake(self, log: Log) -> None:
        if self._stalled or log not in self._logs:
            return
        log._wakes.put(None)
        with suppress(_NothingLeftError):
            log._write_for_ever()
            self._logs.remove(log)
        with suppress(_NothingLeftError):
            log._sync_for_ever()
        if not log._idle:
            asyncio.get_running_loop().call_later(RETRY_S, self._wake, log)


def archive_in_process(patch: pytest.MonkeyPatch) -> None:
    """Run the archiver here; its time is that of the event loop."""
    loop = asyncio.get_running_loop()

    def run(command: Sequence[str], notify: archiver.Report) -> str:
        def publish(found: Event | HealthReport) -> None:
            if isinstance(found, Event):
                notify((found.severity, found.detail, found.kind))
            else:
                notify(found)

        def report(severity: Severity, detail: str) -> None:
            notify((severity, detail, archiver.EVENT_KIND))

        try:
            trips = archive(Path(command[4]), loop.time(), float(command[5]), report, publish)
        except ERRORS as problem:
            return str(problem)
        for directory in trips:
            report(Severity.INFO, f"the record of the trip is in {directory}")
        return ""

    def at_once(call: Callable[[], str], _: str) -> Future[str]:
        done: Future[str] = Future()
        done.set_result(call())
        return done

    patch.setattr(archiver, "_run", run)
    patch.setattr(archiver, "in_thread", at_once)
