"""Log lines, and what the journal makes of them."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest

from adaptdrive.util.lines import leads_to_journal, log


def log_lines(path: Path, journal: Path | None) -> list[str]:
    """What is logged into a file while the environment names another one, or it, as the journal."""
    with path.open("w") as stderr, pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.stderr", stderr)
        patch.delenv("JOURNAL_STREAM", raising=False)
        if journal is not None:
            journal.touch()
            place = journal.stat()
            patch.setenv("JOURNAL_STREAM", f"{place.st_dev}:{place.st_ino}")
        log("info", "starting", drive="motor")
        log("warning", "broker lost")
        log("error", "over-voltage")
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
