import json
from datetime import UTC, datetime
from pathlib import Path

import msgspec
import pytest

from adaptdrive.errors import RecordingError
from adaptdrive.recording.session import (
    Dropped,
    Ending,
    NewSession,
    create_session,
    find_session,
    read_info,
    sessions_directory,
    write_info,
)
from tests.recording.material import INFO


@pytest.mark.parametrize(
    ("configured", "environment", "expected"),
    [
        (Path("/data"), {"STATE_DIRECTORY": "/var/lib/a"}, Path("/data")),
        (None, {"STATE_DIRECTORY": "/var/lib/a"}, Path("/var/lib/a/sessions")),
        (None, {"STATE_DIRECTORY": "/var/lib/a:/var/lib/b"}, Path("/var/lib/a/sessions")),
        (None, {}, Path("sessions")),
    ],
)
def test_sessions_lie_where_the_configuration_or_the_service_manager_says(
    configured: Path | None, environment: dict[str, str], expected: Path
) -> None:
    assert sessions_directory(configured, environment) == expected


def test_a_session_is_named_by_its_start_and_its_drive(session: NewSession) -> None:
    assert session.directory.name == "20261121T012209Z_motor"
    assert session.directory.is_dir()


def test_sessions_of_one_second_do_not_share_a_directory(tmp_path: Path) -> None:
    names = [create_session(tmp_path, INFO, "").directory.name for _ in range(3)]
    first = "20261121T012209Z_motor"
    assert names == [first, f"{first}-2", f"{first}-3"]


def test_a_file_in_the_way_is_an_error_that_names_it(tmp_path: Path) -> None:
    (tmp_path / "sessions").write_text("")
    with pytest.raises(RecordingError, match=str(tmp_path / "sessions")):
        create_session(tmp_path / "sessions", INFO, "")


def test_a_session_is_found_by_path_and_by_name(session: NewSession) -> None:
    write_info(session.directory, session.info)
    sessions = session.directory.parent
    assert find_session(str(session.directory), sessions) == session.directory
    assert find_session(session.directory.name, sessions) == session.directory
    with pytest.raises(RecordingError, match="nowhere: no such session"):
        find_session("nowhere", sessions)


def test_the_facts_about_a_session_come_back(session: NewSession) -> None:
    info = msgspec.structs.replace(
        session.info, ended=Ending.CUT, dropped=Dropped(ticks=3, slow=2, events=1)
    )
    write_info(session.directory, info)
    assert read_info(session.directory) == info
    stored = json.loads((session.directory / "session.json").read_text())
    assert datetime.fromisoformat(stored["started"]) == datetime(2026, 11, 21, 1, 22, 9, tzinfo=UTC)
    assert stored["ended"] == "cut"
    assert stored["line_frequency_Hz"] == 60


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "truncated"),
        ("[]", "Expected `object`"),
        ('{"format": 99}', "format 99 is not 1"),
        ('{"format": 1, "drive": "motor"}', "missing required field `version`"),
    ],
)
def test_damaged_facts_are_an_error_that_says_where(
    session: NewSession, text: str, problem: str
) -> None:
    (session.directory / "session.json").write_text(text)
    with pytest.raises(RecordingError, match=rf"session\.json: .*{problem}"):
        read_info(session.directory)


def test_a_directory_without_a_session_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="No such file"):
        read_info(tmp_path)
