"""`adaptdrive health`: what it prints, draws and refuses, and rows made anew of sessions."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from adaptdrive.cli import main
from adaptdrive.recording.health import append_rows, health_path, read_rows
from adaptdrive.recording.records import Header
from adaptdrive.recording.session import INFO_FILE
from tests.unit.recording.material import INFO, make_batch, make_tick, record_messages
from tests.unit.recording.months import months, motor_hours

EXAMPLE = Path(__file__).parents[3] / "deploy" / "examples" / "motor.toml"


@pytest.fixture
def sessions(tmp_path: Path) -> Path:
    """Nine weeks in which friction rises by 2 % a week."""
    append_rows(health_path(tmp_path, "motor"), months(9.0, 5, lambda week: 1.0 + 0.02 * week))
    return tmp_path


def shown(sessions: Path, capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(["health", "motor", "--directory", str(sessions), *words]) == 0
    return capsys.readouterr().out


def test_it_prints_the_trend_and_what_it_means(
    sessions: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = shown(sessions, capsys).splitlines()
    assert lines[0] == "motor: 450.0 h fed, 0 starts, until 2026-03-06 17:00Z"
    assert lines[2].startswith("friction ")
    assert lines[-1].startswith("  dry friction and load torque up ")
    assert lines[-1].endswith(" % a week")
    found = json.loads(shown(sessions, capsys, "--json"))["quantities"]["friction"]
    assert abs(found["trend_percent"] - 2.0) < 4.0 * found["trend_std"]
    week = json.loads(shown(sessions, capsys, "--json", "--weeks", "1"))["quantities"]["friction"]
    assert week["trend_std"] > 3.0 * found["trend_std"]


def test_it_draws_a_picture(sessions: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = sessions / "health.png"
    assert str(picture) in shown(sessions, capsys, "--plot", str(picture))
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_drive_without_hours_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["health", "motor", "--directory", str(tmp_path)]) == 1
    assert "it has no hour yet" in capsys.readouterr().err


def test_rows_are_made_anew_of_the_sessions_that_exist(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session = tmp_path / "20261121T012209Z_motor"
    session.mkdir()
    header = Header(INFO, EXAMPLE.read_text(encoding="utf-8"))
    batch = make_batch([make_tick(1)], motor_hours(0.2, seed=1), last=True)
    record_messages(session, header, batch)
    assert (session / INFO_FILE).exists()
    printed = shown(tmp_path, capsys, "--rebuild")
    assert "inertia" in printed
    rows = read_rows(health_path(tmp_path, "motor"))
    assert len(rows) == 1
    shown(tmp_path, capsys, "--rebuild")
    assert read_rows(health_path(tmp_path, "motor")) == rows
