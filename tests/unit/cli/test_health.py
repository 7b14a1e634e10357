"""`adaptdrive health`: what it prints, draws and refuses."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from adaptdrive.cli import main
from adaptdrive.recording.health import append_rows, health_path
from tests.unit.recording.months import months

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
    assert lines[-1].startswith("dry friction and load torque up ")
    assert lines[-1].endswith(" % a week")
    trend, deviation = map(float, re.findall(r"([-+\d.]+) ± ([\d.]+) %", lines[2])[1])
    assert abs(trend - 2.0) < 4.0 * deviation
    week = shown(sessions, capsys, "--weeks", "1").splitlines()[2]
    assert float(re.findall(r"± ([\d.]+) %", week)[1]) > 3.0 * deviation


def test_it_draws_a_picture(sessions: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = sessions / "health.png"
    assert str(picture) in shown(sessions, capsys, "--plot", str(picture))
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_drive_without_hours_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["health", "motor", "--directory", str(tmp_path)]) == 1
    assert "it has no hour yet" in capsys.readouterr().err
