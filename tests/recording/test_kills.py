"""A control process that is killed: what left it is in the session, and few ticks are lost."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from adaptdrive.recording.reader import Session, read_session
from adaptdrive.recording.session import Ending, session_directories
from adaptdrive.recording.verify import verify
from tests.recording.material import archive_all, wait_until
from tests.support import Process, slow_disk

FLUSH_S = 0.1
"""Of `control_process.py`."""


@contextmanager
def started(sessions: Path, **environment: str) -> Iterator[Process]:
    program = Path(__file__).with_name("control_process.py")
    path = os.pathsep.join(filter(None, sys.path))
    process = subprocess.Popen(
        [sys.executable, program, sessions],
        env={**os.environ, "PYTHONPATH": path, **environment},
        stderr=subprocess.PIPE,
    )
    with process:
        try:
            yield process
        finally:
            process.kill()


def killed(sessions: Path, process: Process, lines: int) -> tuple[list[str], float]:
    """Kill a process after so many lines of its log; its events there, and when it was."""
    log = process.stderr
    assert log is not None
    said = [log.readline() for _ in range(lines)]
    process.kill()
    killed_s = time.monotonic()
    said += log.read().splitlines(keepends=True)
    process.wait()
    return [json.loads(line)["event"] for line in said if line.endswith(b"\n")], killed_s


def session_of(sessions: Path) -> Session:
    return read_session(next(session_directories(sessions)))


@pytest.mark.parametrize("round_", range(6))
def test_an_event_is_in_the_session_before_it_is_in_the_log(tmp_path: Path, round_: int) -> None:
    """Each write to a file takes 10 ms, and each sync 50 ms."""
    environment = slow_disk(tmp_path, 0.05)
    if environment is None:
        pytest.skip("no C compiler")
    sessions = tmp_path / "sessions"
    with started(sessions, **environment, SLOW_WRITE_S="0.01") as process:
        logged, _ = killed(sessions, process, 5 + 3 * round_)
    assert len(logged) >= 5 + 3 * round_
    recorded = {event.detail for event in session_of(sessions).events}
    assert set(logged) <= recorded
    archive_all(sessions.with_name("motor.log"))
    assert {event.detail for event in session_of(sessions).events} == recorded


def test_a_kill_costs_what_was_not_flushed(tmp_path: Path) -> None:
    chance = random.Random(3)
    for number in range(3):
        sessions = tmp_path / str(number) / "sessions"
        sessions.parent.mkdir()
        with started(sessions) as process:
            wait_until(lambda at=sessions: bool(list(session_directories(at))))  # type: ignore[misc]
            time.sleep(1.0 + chance.random())
            _, killed_s = killed(sessions, process, 1)
        archive_all(sessions.with_name("motor.log"))
        session = session_of(sessions)
        times_s = session.ticks["monotonic_s"].to_pylist()
        sequences = session.ticks["sequence"].to_pylist()
        assert session.info.ended is Ending.CUT
        assert sequences == list(range(len(sequences)))
        assert killed_s - times_s[-1] < FLUSH_S + 0.4  # of a busy machine
        assert verify(session).whole
