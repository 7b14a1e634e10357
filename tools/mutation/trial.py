"""Tests that are collected once and run again for each mutant, in a process of its own."""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

TraceFunction = Callable[[FrameType, str, Any], Any]

Lines = dict[str, dict[str, list[int]]]
"""Executed lines of each file, by test."""

KILLED, SURVIVED = 1, 0
WALL_s = 120.0
"""After which a process hangs whose tests need no processor."""

BUSY = 20.0
"""Wall time over processor time on a busy machine."""


class Trials:
    """Takes the place of pytest's loop over the tests.

    Attributes:
        lines: Executed lines of the watched files, by test, without any mutant.
        failed: The test that failed last.
    """

    def __init__(self, watched: Collection[str], work: Callable[[Trials], None]) -> None:
        """Prepare.

        Args:
            watched: Files whose executed lines are noted.
            work: Called once, when the tests are collected.
        """
        self._watched, self._work = frozenset(watched), work
        self._items: list[pytest.Item] = []
        self._failed = ""
        self._covers: dict[str, set[int]] = {}
        self.lines: Lines = {}
        self.took_s = 0.0
        self._took_s: dict[str, float] = {}

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Run what takes the place of the loop."""
        self._items = session.items
        self.lines = self._trace()
        self._work(self)
        return True

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note a failure."""
        if report.failed:
            self._failed = report.nodeid

    def covering(self, file: str, lines: tuple[int, int]) -> list[str]:
        """Return the tests that execute one of some lines."""
        span = set(range(lines[0], lines[1] + 1))
        return [
            name for name, files in self.lines.items() if span.intersection(files.get(file, ()))
        ]

    def survives(self, put: Callable[[], None], names: Sequence[str]) -> bool:
        """Return whether all of some tests pass with a change; too slow is not passed."""
        chosen = set(names)
        items = [item for item in self._items if item.nodeid in chosen]
        items.sort(key=lambda item: self._took_s.get(item.nodeid, 0.0))
        limit_s = int(10.0 + 10.0 * self.took_s)
        wall_s = WALL_s + BUSY * self.took_s
        return self._fork(lambda: self._run(items, put), limit_s, wall_s) == SURVIVED

    def _fork(self, work: Callable[[], int], limit_s: int, wall_s: float) -> int:
        sys.stdout.flush()
        child = os.fork()
        if child == 0:
            status = KILLED
            try:
                os.setpgrp()
                resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s))
                quiet = os.open(os.devnull, os.O_WRONLY)
                os.dup2(quiet, 1)
                os.dup2(quiet, 2)
                status = work()
            finally:
                os._exit(status)
        return _wait(child, wall_s)

    def _run(self, items: Sequence[pytest.Item], put: Callable[[], None]) -> int:
        put()
        for number, item in enumerate(items):
            following = items[number + 1] if number + 1 < len(items) else None
            # the signal ends the process: a test that has become endless has noticed
            usual_s = self._took_s.get(item.nodeid, 0.0)
            signal.setitimer(signal.ITIMER_VIRTUAL, 3.0 + 10.0 * usual_s)
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            if self._failed:
                return KILLED
        return SURVIVED

    def _trace(self) -> Lines:
        """Run all tests once, and return which lines each of them executes."""
        began_s = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        with tempfile.TemporaryDirectory(prefix="trials-") as folder:
            note = Path(folder) / "lines.json"
            status = self._fork(lambda: self._note(note), 3600, BUSY * 3600.0)
            assert status == SURVIVED, f"fails without a mutant: {note.read_text()}"
            lines: Lines
            lines, self._took_s = json.loads(note.read_text())
        self.took_s = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - began_s
        return lines

    def _note(self, note: Path) -> int:
        found: Lines = {}
        took_s: dict[str, float] = {}
        for number, item in enumerate(self._items):
            following = self._items[number + 1] if number + 1 < len(self._items) else None
            self._covers, began_s = {}, time.process_time()
            sys.settrace(self._enter)
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            sys.settrace(None)
            took_s[item.nodeid] = time.process_time() - began_s
            found[item.nodeid] = {file: sorted(lines) for file, lines in self._covers.items()}
            if self._failed:
                note.write_text(self._failed)
                return KILLED
        note.write_text(json.dumps([found, took_s]))
        return SURVIVED

    def _enter(self, frame: FrameType, _event: str, _argument: object) -> TraceFunction | None:
        file = frame.f_code.co_filename
        if file not in self._watched:
            return None
        lines = self._covers.setdefault(file, set())

        def line(inner: FrameType, _event: str, _argument: object) -> TraceFunction:
            lines.add(inner.f_lineno)
            return line

        return line


def _wait(child: int, wall_s: float) -> int:
    """Wait for a process; one that hangs is ended with all that it started."""
    end_s = time.monotonic() + wall_s
    while time.monotonic() < end_s:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return KILLED if status else SURVIVED
        time.sleep(0.01)
    os.killpg(child, 9)
    os.waitpid(child, 0)
    return KILLED
