import json
import shutil
from datetime import UTC, datetime
from pathlib import Path

import msgspec
import pytest

from adaptdrive.recording.reader import find_session
from adaptdrive.recording.session import (
    Dropped,
    Ending,
    create_session,
    read_info,
    session_directories,
    sessions_directory,
    write_info,
)
from adaptdrive.util.errors import RecordingError
from tests.unit.recording.material import INFO


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


def test_a_session_is_named_by_its_start_and_its_drive(directory: Path) -> None:
    assert directory.name == "20261121T012209Z_motor"
    assert directory.is_dir()


def test_a_new_session_holds_its_facts_at_once(directory: Path) -> None:
    assert sorted(path.name for path in directory.iterdir()) == ["config.toml", "session.json"]
    assert [path.name for path in directory.parent.iterdir()] == [directory.name]


def test_sessions_of_one_second_do_not_share_a_directory(sessions: Path) -> None:
    names = [create_session(sessions, INFO, "").name for _ in range(3)]
    first = "20261121T012209Z_motor"
    assert names == [first, f"{first}-2", f"{first}-3"]


def test_a_session_is_found_by_path_and_by_name(directory: Path) -> None:
    sessions = directory.parent
    assert find_session(str(directory), sessions) == directory
    assert find_session(directory.name, sessions) == directory
    with pytest.raises(RecordingError, match="nowhere: no such session"):
        find_session("nowhere", sessions)


def test_the_last_session_is_taken_where_none_is_named(directory: Path) -> None:
    sessions = directory.parent
    later = msgspec.structs.replace(INFO, started=datetime.now(UTC))
    newest = create_session(sessions, later, "")
    assert find_session(None, sessions) == newest
    with pytest.raises(RecordingError, match="empty: it holds no session"):
        find_session(None, sessions / "empty")


@pytest.mark.parametrize("name", [".", "../{}", "trip-1/.."])
def test_a_session_has_its_name_wherever_the_operator_is(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    directory = create_session(tmp_path, INFO, "")
    (directory / "trip-1").mkdir()
    monkeypatch.chdir(directory)
    assert find_session(name.format(directory.name), tmp_path).name == directory.name


def test_the_facts_about_a_session_come_back(directory: Path) -> None:
    dropped = Dropped(ticks=3, slow=2, events=1)
    info = msgspec.structs.replace(INFO, ended=Ending.CUT, dropped=dropped)
    write_info(directory, info)
    assert read_info(directory) == info
    stored = json.loads((directory / "session.json").read_text())
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
    directory: Path, text: str, problem: str
) -> None:
    (directory / "session.json").write_text(text)
    with pytest.raises(RecordingError, match=rf"session\.json: .*{problem}"):
        read_info(directory)


@pytest.mark.parametrize(
    ("fact", "value"),
    [("ticks_per_period", 0), ("ticks_per_period", 10**30), ("line_frequency_Hz", 0.0)],
)
def test_facts_that_give_no_clock_are_damage(directory: Path, fact: str, value: float) -> None:
    facts = json.loads((directory / "session.json").read_text()) | {fact: value}
    (directory / "session.json").write_text(json.dumps(facts))
    with pytest.raises(RecordingError, match=fact):
        read_info(directory)


def test_a_folder_in_the_making_is_no_session(sessions: Path, directory: Path) -> None:
    shutil.copytree(directory, directory.with_name(".new-1"))
    assert list(session_directories(sessions)) == [directory]
