"""Log lines, and what the journal makes of them."""

from __future__ import annotations

import io
import json
import logging
import subprocess
import sys
from contextvars import copy_context
from pathlib import Path

import pytest

from adaptdrive.util.lines import bind, configured, leads_to_journal, line, write_line


def log_lines(path: Path, journal: Path | None) -> list[str]:
    """What is logged into a file while the environment names another one, or it, as the journal."""
    with path.open("w") as stderr, pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.stderr", stderr)
        patch.delenv("JOURNAL_STREAM", raising=False)
        if journal is not None:
            journal.touch()
            place = journal.stat()
            patch.setenv("JOURNAL_STREAM", f"{place.st_dev}:{place.st_ino}")
        write_line("info", "starting", drive="motor")
        write_line("warning", "broker lost")
        write_line("error", "over-voltage")
    return path.read_text().splitlines()


def test_lines_are_json(tmp_path: Path) -> None:
    lines = [json.loads(line) for line in log_lines(tmp_path / "log", None)]
    assert [line["event"] for line in lines] == ["starting", "broker lost", "over-voltage"]
    assert [line["level"] for line in lines] == ["info", "warning", "error"]
    assert lines[0]["drive"] == "motor"


def test_the_journal_is_told_how_much_a_line_matters(tmp_path: Path) -> None:
    lines = log_lines(tmp_path / "log", tmp_path / "log")
    assert [line[:3] for line in lines] == ["<6>", "<4>", "<3>"]
    assert json.loads(lines[0][3:])["event"] == "starting"


def test_a_stream_that_was_led_elsewhere_is_not_the_journal(tmp_path: Path) -> None:
    lines = log_lines(tmp_path / "log", tmp_path / "journal")
    assert all(line.startswith("{") for line in lines)
    assert not leads_to_journal(io.StringIO(), {"JOURNAL_STREAM": "1:2"})


def test_what_is_bound_is_in_each_line_while_it_has_a_value(tmp_path: Path) -> None:
    """The session is named from the moment that it has a folder."""
    folder: list[str] = []

    def lines() -> list[str]:
        bind(drive="motor", session=lambda: folder[0] if folder else None)
        before = log_lines(tmp_path / "before", None)
        folder.append("0007")
        return before[:1] + log_lines(tmp_path / "after", None)[1:2]

    before, after = (json.loads(line) for line in copy_context().run(lines))
    assert "session" not in before
    assert (after["session"], after["drive"]) == ("0007", "motor")


def test_warnings_of_libraries_are_lines_too(tmp_path: Path) -> None:
    path = tmp_path / "log"
    with path.open("w") as stderr, pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.stderr", stderr)
        configured()
        logging.getLogger("pymodbus").warning("no reply of %d", 7)
    (entry,) = [json.loads(line) for line in path.read_text().splitlines()]
    assert (entry["event"], entry["level"]) == ("no reply of 7", "warning")
    assert entry["logger"] == "pymodbus"


def test_a_line_can_be_made_without_being_written() -> None:
    entry = json.loads(line("warning", "lines lost", lost=3))
    assert (entry["event"], entry["level"], entry["lost"]) == ("lines lost", "warning", 3)


def test_a_client_of_the_broker_does_not_import_structlog(outside: None) -> None:
    """It has this module, and writes no line."""
    program = "import sys, adaptdrive.mqtt.client; print('structlog' in sys.modules)"
    answer = subprocess.run(
        [sys.executable, "-c", program], check=True, capture_output=True, text=True
    )
    assert answer.stdout == "False\n"
