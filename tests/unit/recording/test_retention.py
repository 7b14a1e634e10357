"""What is removed, what is closed later, and what is reported of it."""

import errno
import fcntl
import shutil
from datetime import timedelta
from pathlib import Path

import msgspec
import pytest

from adaptdrive.recording.records import Header, Keep
from adaptdrive.recording.segments import prune
from adaptdrive.recording.session import (
    Ending,
    create_session,
    read_info,
    session_directories,
    write_info,
)
from adaptdrive.util.errors import RecordingError
from tests.unit.recording.material import INFO, make_batch, make_tick, record_messages, write_log

NOW = INFO.started + timedelta(days=10)


def recorded(sessions: Path, age_days: float, ticks: int = 50) -> Path:
    info = msgspec.structs.replace(INFO, started=NOW - timedelta(days=age_days))
    directory = create_session(sessions, info, "")
    batch = make_batch([make_tick(number) for number in range(ticks)], last=True)
    record_messages(directory, Header(info, ""), batch)
    return directory


def names(sessions: Path) -> list[str]:
    return [path.name for path in session_directories(sessions)]


def test_sessions_older_than_allowed_are_removed(tmp_path: Path) -> None:
    old, young = recorded(tmp_path, 8.0), recorded(tmp_path, 6.0)
    told = list(prune(tmp_path, Keep(days=7.0), NOW))
    assert names(tmp_path) == [young.name]
    assert told == [f"session {old.name} removed: it is older than 7 days"]


def test_a_link_to_a_session_elsewhere_is_neither_counted_nor_removed(tmp_path: Path) -> None:
    sessions = tmp_path / "sessions"
    moved = recorded(tmp_path / "archive", 9.0, ticks=20_000)
    kept = recorded(sessions, 1.0)
    (sessions / moved.name).symlink_to(moved)
    (sessions / "latest").symlink_to(kept)
    assert list(prune(sessions, Keep(days=7.0, bytes=200_000), NOW, kept)) == []
    assert (kept / "ticks-0001.parquet").exists()
    assert names(sessions) == [moved.name, kept.name, "latest"]


@pytest.mark.parametrize("leap_days", [0.0, 400.0])
def test_a_clock_that_has_leapt_ahead_makes_no_session_too_old(
    tmp_path: Path, leap_days: float
) -> None:
    """The recorder starts with the machine, before anybody or any server has set the clock."""
    past = [recorded(tmp_path, age_days) for age_days in (8.0, 6.0)]
    current = recorded(tmp_path, -leap_days)
    removals = list(prune(tmp_path, Keep(days=7.0), NOW + timedelta(days=leap_days), current))
    kept = past if leap_days else past[1:]
    assert names(tmp_path) == [*(path.name for path in kept), current.name]
    assert len(removals) == len(past) - len(kept)


def test_after_a_day_a_clock_is_believed(tmp_path: Path) -> None:
    old, current = recorded(tmp_path, 400.0), recorded(tmp_path, 0.0)
    for hours, count in ((23.9, 2), (24.1, 1)):
        list(prune(tmp_path, Keep(days=7.0), NOW + timedelta(hours=hours), current))
        assert len(names(tmp_path)) == count
    assert names(tmp_path) == [current.name] != [old.name]


def test_a_person_may_remove_what_is_old_by_any_clock(tmp_path: Path) -> None:
    recorded(tmp_path, 400.0)
    assert len(list(prune(tmp_path, Keep(days=7.0), NOW))) == 1


def test_the_oldest_go_until_the_rest_fits(tmp_path: Path) -> None:
    directories = [recorded(tmp_path, age) for age in (5.0, 4.0, 3.0)]
    size = sum(path.stat().st_size for path in directories[2].iterdir())
    list(prune(tmp_path, Keep(bytes=2 * size + 100), NOW))
    assert names(tmp_path) == [path.name for path in directories[1:]]


def test_files_beside_the_sessions_remove_none(tmp_path: Path) -> None:
    """As an export, the reserve for a full disk, and what could not be read of a recorder."""
    directories = [recorded(tmp_path, age) for age in (5.0, 4.0, 0.5)]
    size = sum(path.stat().st_size for one in directories for path in one.iterdir())
    for name in ("20261121T012209Z_motor_ticks.csv", ".reserve", "damaged.unwritten-motor"):
        (tmp_path / name).write_bytes(bytes(2 * size))
    (tmp_path / "exports").mkdir()
    (tmp_path / "exports" / "ticks.csv").write_bytes(bytes(2 * size))
    assert list(prune(tmp_path, Keep(bytes=size), NOW, directories[-1])) == []
    (removal,) = prune(tmp_path, Keep(bytes=size - 1), NOW, directories[-1])
    assert removal.startswith(f"session {directories[0].name} removed")
    assert list(directories[-1].glob("ticks-*.parquet"))


def test_a_session_that_cannot_be_removed_keeps_no_other_from_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As one that another user has put there."""
    foreign, old, young = [recorded(tmp_path, age_days) for age_days in (9.0, 8.0, 6.0)]
    remove = shutil.rmtree

    def removed(directory: Path) -> None:
        if directory == foreign:
            raise PermissionError(errno.EACCES, "Permission denied", str(directory / "config.toml"))
        remove(directory)

    removals = prune(tmp_path, Keep(days=7.0), NOW)
    with monkeypatch.context() as system:
        system.setattr(shutil, "rmtree", removed)
        assert next(removals).startswith(f"session {old.name} removed")
        with pytest.raises(RecordingError, match=rf"{foreign.name}.*Permission denied"):
            next(removals)
    assert names(tmp_path) == [foreign.name, young.name]


def test_a_session_in_progress_loses_its_oldest_segments_only(tmp_path: Path) -> None:
    directory = recorded(tmp_path, 0.5)
    later = make_batch([make_tick(number) for number in range(50, 100)], last=True)
    record_messages(directory, Header(INFO, ""), later)
    list(prune(tmp_path, Keep(bytes=1), NOW, directory))
    assert names(tmp_path) == [directory.name]
    assert not list(directory.glob("ticks-*.parquet"))
    second = recorded(tmp_path, 0.4)
    info = msgspec.structs.replace(read_info(second), ended=Ending.OPEN, log="../motor.log")
    write_info(second, info)
    log = write_log(tmp_path.parent / "motor.log", Header(info, ""), part=2)
    with log.path.open("rb") as held:
        fcntl.flock(held, fcntl.LOCK_EX)  # as its daemon does
        list(prune(tmp_path, Keep(bytes=1), NOW))
    assert names(tmp_path) == [second.name]


@pytest.mark.parametrize("days", [1e6, 1e300])
def test_a_limit_of_more_days_than_a_calendar_has_removes_nothing(
    tmp_path: Path, days: float
) -> None:
    directory = recorded(tmp_path, 3000.0)
    assert list(prune(tmp_path, Keep(days=days), NOW)) == []
    assert names(tmp_path) == [directory.name]
