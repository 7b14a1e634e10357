"""Output through a queue, in a process of its own whose pipe is read late or never."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from adaptdrive.app.run import LINES_HELD

pytestmark = pytest.mark.usefixtures("outside")

LINES = 3000
PROGRAM = f"""
import sys
from pathlib import Path
from adaptdrive.app.run import unblocked_output
with unblocked_output():
    for number in range({LINES}):
        print('{{"number": %d}}' % number, file=sys.stderr)
    Path(sys.argv[1]).touch()
    sys.stdin.read()
    print('{{"number": -1}}', file=sys.stderr)
"""


def start(done: Path, stderr: int) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-c", PROGRAM, str(done)]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stderr=stderr)


def wait_for(done: Path, process: subprocess.Popen[bytes]) -> None:
    while not done.exists():
        assert process.poll() is None


def test_what_a_late_reader_lost_is_counted(tmp_path: Path) -> None:
    reader, writer = os.pipe()
    process = start(tmp_path / "done", writer)
    os.close(writer)
    wait_for(tmp_path / "done", process)
    assert process.stdin is not None
    process.stdin.close()
    with os.fdopen(reader) as lines:
        entries = [json.loads(line) for line in lines]
    assert process.wait() == 0
    numbers = [entry["number"] for entry in entries if "number" in entry]
    lost = sum(entry.get("lost", 0) for entry in entries)
    assert lost > 0
    assert len(numbers) + lost == LINES + 1
    assert numbers[-LINES_HELD // 2 :] == [*range(LINES - LINES_HELD // 2 + 1, LINES), -1]


def test_a_reader_that_left_is_no_error(tmp_path: Path) -> None:
    reader, writer = os.pipe()
    process = start(tmp_path / "done", writer)
    os.close(writer)
    os.close(reader)
    wait_for(tmp_path / "done", process)
    assert process.stdin is not None
    process.stdin.close()
    assert process.wait() == 0
