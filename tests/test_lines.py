"""Log lines, and what the journal makes of them."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from adaptdrive.lines import leads_to_journal

pytestmark = pytest.mark.usefixtures("outside")

PROGRAM = """
import sys
from adaptdrive.lines import log
log("info", "starting", drive="motor")
log("warning", "broker lost")
log("error", "over-voltage")
"""


def log_lines(log: Path, journal_stream: str | None) -> list[str]:
    """What a process logs into a file that the environment names as the journal, or does not."""
    environment = {name: text for name, text in os.environ.items() if name != "JOURNAL_STREAM"}
    if journal_stream is not None:
        environment["JOURNAL_STREAM"] = journal_stream
    with log.open("w") as stderr:
        command = [sys.executable, "-c", PROGRAM]
        subprocess.run(command, stderr=stderr, env=environment, check=True, timeout=60)
    return log.read_text().splitlines()


def place_of(log: Path) -> str:
    log.touch()
    place = log.stat()
    return f"{place.st_dev}:{place.st_ino}"


def test_lines_are_json(tmp_path: Path) -> None:
    lines = [json.loads(line) for line in log_lines(tmp_path / "log", None)]
    assert [line["event"] for line in lines] == ["starting", "broker lost", "over-voltage"]
    assert [line["level"] for line in lines] == ["info", "warning", "error"]
    assert lines[0]["drive"] == "motor"


def test_the_journal_is_told_how_much_a_line_matters(tmp_path: Path) -> None:
    log = tmp_path / "log"
    lines = log_lines(log, place_of(log))
    assert [line[:3] for line in lines] == ["<6>", "<4>", "<3>"]
    assert json.loads(lines[0][3:])["event"] == "starting"


def test_a_stream_that_was_led_elsewhere_is_not_the_journal(tmp_path: Path) -> None:
    lines = log_lines(tmp_path / "log", place_of(tmp_path / "journal"))
    assert all(line.startswith("{") for line in lines)
    assert not leads_to_journal(io.StringIO(), {"JOURNAL_STREAM": "1:2"})
