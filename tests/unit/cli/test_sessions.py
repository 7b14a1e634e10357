"""The commands on recorded sessions."""

from __future__ import annotations

import fcntl
import json
import os
import re
import shutil
import subprocess
from datetime import timedelta
from pathlib import Path

import msgspec
import pyarrow.parquet as pq
import pytest

import adaptdrive
from adaptdrive.recording.archiver import EVENT_KIND
from adaptdrive.recording.records import EventRow, Header
from adaptdrive.recording.session import Dropped, create_session
from adaptdrive.runtime.reports import EVENT_KINDS
from tests.unit.cli.here import run_here
from tests.unit.recording.material import INFO, make_batch, make_tick, record_messages, write_log

NAME = "20261121T012209Z_motor"
TICKS_FILE = "ticks-0001.parquet"


def run(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return run_here(*words, STATE_DIRECTORY=str(folder))


@pytest.fixture
def state(tmp_path: Path) -> Path:
    """A state directory with a session that lacks three ticks at its end."""
    return recorded(tmp_path, Dropped(ticks=3))


def recorded(tmp_path: Path, dropped: Dropped) -> Path:
    event = EventRow(
        INFO.started, 7, "trip", "alarm", "over-voltage: 431 V", 1.0, 1, "over-voltage"
    )
    return recorded_events(tmp_path, dropped, [event])


def recorded_events(tmp_path: Path, dropped: Dropped, events: list[EventRow]) -> Path:
    directory = create_session(tmp_path / "sessions", INFO, "")
    ticks = make_batch([make_tick(number) for number in range(1000)])
    last = msgspec.structs.replace(make_batch([], last=True), events=events, dropped=dropped)
    record_messages(directory, Header(INFO, ""), ticks, last)
    return tmp_path


def test_sessions_are_listed_with_what_they_lack(state: Path) -> None:
    answer = run(state, "sessions", "list")
    assert answer.returncode == 0
    assert answer.stdout.startswith(f"{NAME}  orderly")
    assert "3 ticks" in answer.stdout


def test_a_session_is_shown(state: Path) -> None:
    answer = run(state, "sessions", "show", NAME)
    assert "last tick     1970-01-01T00:00:58.325000+00:00" in answer.stdout


def test_trips_of_a_session_whose_events_cannot_be_read_are_not_none(state: Path) -> None:
    (state / "sessions" / NAME / "events-0001.parquet").write_bytes(b"no table" * 100)
    answer = run(state, "sessions", "show", NAME)
    assert "trips         damaged" in answer.stdout


def test_a_whole_session_passes_and_a_damaged_one_fails(tmp_path: Path) -> None:
    state = recorded(tmp_path, Dropped())
    assert run(state, "sessions", "verify", NAME).returncode == 0
    path = state / "sessions" / NAME / "ticks-0001.parquet"
    group = pq.read_metadata(path).row_group(0)
    columns = [group.column(i) for i in range(group.num_columns)]
    largest = max(columns, key=lambda one: one.total_compressed_size)
    # the headers of pages and the footer have no checksum
    content = bytearray(path.read_bytes())
    content[largest.data_page_offset + largest.total_compressed_size // 2] ^= 0x10
    path.write_bytes(content)
    answer = run(state, "sessions", "verify", NAME)
    assert answer.returncode == 1
    assert "ticks-0001.parquet" in answer.stderr


@pytest.mark.parametrize("lost", [["session.json"], ["session.json", "events-0001.parquet"]])
def test_a_session_without_its_facts_is_named_and_not_passed_over(
    state: Path, lost: list[str]
) -> None:
    for name in lost:
        (state / "sessions" / NAME / name).unlink()
    listed = run(state, "sessions", "list")
    assert listed.stdout.startswith(f"{NAME}  damaged: ")
    for command in ("verify", "show"):
        answer = run(state, "sessions", command, *([NAME] if command == "show" else []))
        assert answer.returncode == 1
        assert "session.json: No such file" in answer.stderr
        assert "Traceback" not in answer.stderr


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (TICKS_FILE, "1000 ticks are missing"),
        ("events-0001.parquet", "1 of 1 rows of the table events are missing"),
    ],
)
@pytest.mark.parametrize("remains", [False, True])
def test_what_a_file_held_that_is_gone_or_empty_is_missing(
    tmp_path: Path, name: str, message: str, *, remains: bool
) -> None:
    state = recorded(tmp_path, Dropped())
    (state / "sessions" / NAME / name).unlink()
    if remains:
        (state / "sessions" / NAME / name).touch()
    answer = run(state, "sessions", "verify", NAME)
    assert answer.returncode == 1
    assert message in answer.stdout + answer.stderr or name in answer.stderr
    assert "whole" not in answer.stdout


@pytest.mark.parametrize("name", ["session.json", "config.toml", "events-0001.parquet", TICKS_FILE])
def test_a_fifo_in_a_session_hangs_nothing_and_hides_no_other(tmp_path: Path, name: str) -> None:
    state = recorded(tmp_path, Dropped())
    foreign = state / "sessions" / "20260101T000000Z_motor"
    shutil.copytree(state / "sessions" / NAME, foreign)
    (foreign / name).unlink()
    os.mkfifo(foreign / name)
    answer = run(state, "sessions", "verify")
    assert answer.returncode == 1
    assert f"{NAME}: 1000 ticks; whole\n" in answer.stdout
    assert name in answer.stderr
    assert "it is a FIFO, not a file" in answer.stderr
    listed = run(state, "sessions", "list")
    assert NAME in listed.stdout
    assert "Traceback" not in listed.stderr


def test_what_a_killed_daemon_has_left_unwritten_is_named(tmp_path: Path) -> None:
    info = msgspec.structs.replace(INFO, log="../motor.log")
    directory = create_session(tmp_path / "sessions", info, "")
    batch = make_batch([make_tick(number) for number in range(10)])
    left = write_log(tmp_path / "motor.log", Header(info, ""), batch)
    answer = run(tmp_path, "sessions", "verify")
    assert answer.returncode == 1
    assert f"{directory.name}: data and events that the next start" in answer.stderr
    assert f"{directory.name}: 10 ticks; whole\n" in answer.stdout
    with left.path.open("rb") as held:
        fcntl.flock(held, fcntl.LOCK_EX)  # as the daemon does that still writes it
        assert run(tmp_path, "sessions", "verify").returncode == 0


def test_what_a_stop_had_no_room_for_is_whole_in_the_log(tmp_path: Path) -> None:
    info = msgspec.structs.replace(INFO, log="../motor.log")
    directory = create_session(tmp_path / "sessions", info, "")
    batch = make_batch([make_tick(number) for number in range(10)], last=True)
    write_log(tmp_path / "motor.log", Header(info, ""), batch)
    answer = run(tmp_path, "sessions", "verify")
    assert (answer.returncode, answer.stdout) == (0, f"{directory.name}: 10 ticks; whole\n")
    assert f"{directory.name}: data and events that the next start" in answer.stderr


def test_ticks_lost_at_the_end_are_missing_in_whichever_session(state: Path) -> None:
    answer = run(state, "sessions", "verify")
    assert answer.returncode == 1
    assert answer.stdout == f"{NAME}: 1000 ticks; 3 ticks are missing\n"


def test_missing_ticks_are_counted(state: Path) -> None:
    directory = state / "sessions" / NAME
    later = make_batch([make_tick(number) for number in range(1010, 1020)], last=True)
    record_messages(directory, Header(INFO, ""), later)
    answer = run(state, "sessions", "verify", NAME)
    assert answer.returncode == 1
    assert "1010 ticks; 10 ticks are missing" in answer.stdout


@pytest.mark.parametrize("verb", ["list", "verify", "prune"])
def test_a_folder_that_is_not_there_is_no_folder_without_sessions(
    tmp_path: Path, verb: str
) -> None:
    answer = run(tmp_path, "sessions", verb, "--directory", str(tmp_path / "typo"))
    assert answer.returncode == 1
    assert "typo: there is no such folder" in answer.stderr


def test_old_sessions_are_pruned_on_request(state: Path) -> None:
    kept = run(state, "sessions", "prune", "--keep-days", "1e6")
    assert (kept.returncode, kept.stdout, kept.stderr) == (0, "", "")
    assert f"session {NAME} removed" in run(state, "sessions", "prune", "--keep-MB", "0.001").stdout
    assert run(state, "sessions", "list").stdout == ""


@pytest.mark.parametrize("limit", ["nan", "inf", "0", "-5"])
@pytest.mark.parametrize("option", ["--keep-days", "--keep-MB"])
def test_a_limit_that_is_none_removes_nothing(state: Path, option: str, limit: str) -> None:
    answer = run(state, "sessions", "prune", f"{option}={limit}")
    assert answer.returncode == 2
    (line,) = answer.stderr.splitlines()
    assert option in line
    assert (state / "sessions" / NAME).is_dir()


def test_a_folder_that_cannot_be_made_is_one_line(state: Path) -> None:
    (state / "file").touch()
    answer = run(state, "export", NAME, "--to", "csv", "--into", str(state / "file" / "below"))
    assert answer.returncode == 1
    (line,) = answer.stderr.splitlines()
    assert str(state / "file") in line


def test_what_is_pruned_is_listed_for_programs(state: Path) -> None:
    (removal,) = json.loads(run(state, "sessions", "prune", "--keep-MB", "0.001", "--json").stdout)
    assert NAME in removal


def test_files_of_a_session_are_listed_for_programs(state: Path, tmp_path: Path) -> None:
    words = ("export", NAME, "--to", "csv", "--into", str(tmp_path / "out"), "--json")
    files = json.loads(run(state, *words).stdout)
    assert files
    assert all(Path(file).is_file() for file in files)


def test_events_of_the_last_session_are_shown(state: Path) -> None:
    answer = run(state, "events", "--kind", "trip")
    assert "alarm    trip         over-voltage: 431 V" in answer.stdout
    assert run(state, "events", "--kind", "mode").stdout == ""


def test_counts_of_late_ticks_hide_no_trip(tmp_path: Path) -> None:
    times = [INFO.started + timedelta(minutes=number) for number in range(4)]
    kinds = ("latency", "trip", "latency", "latency")
    rows = [
        EventRow(time, 7, kind, "warning", f"number {k}", 1.0, k + 1)
        for k, (time, kind) in enumerate(zip(times, kinds, strict=True))
    ]
    state = recorded_events(tmp_path, Dropped(), rows)
    shown = run(state, "events").stdout.splitlines()
    assert [line.rpartition(" ")[2] for line in shown] == ["1", "3"]
    assert run(state, "events", "--kind", "latency").stdout.count("\n") == 3


def test_an_unknown_kind_of_event_is_refused_with_the_known_ones(state: Path) -> None:
    answer = run(state, "events", "--kind", "bus", "--kind", "tripp")
    assert (answer.returncode, answer.stdout) == (2, "")
    assert answer.stderr.count("\n") == 1
    said = "adaptdrive: --kind: tripp: no event is of this kind (did you mean 'trip'?); known: "
    assert answer.stderr.startswith(said)
    assert all(kind in answer.stderr for kind in EVENT_KINDS)


def test_every_kind_of_event_is_known() -> None:
    event = re.compile(
        r'\b(?:(?:publish_event|report|Event)\(\s*"([^"]+)",\s*(?:\w+\.)*[Ss]everity|'
        r'(?:publish_alarm|_?warn)\W\s*"([^"]+)")'
    )
    sources = [path.read_text() for path in Path(adaptdrive.__file__).parent.rglob("*.py")]
    found = {kind for source in sources for kinds in event.findall(source) for kind in kinds}
    assert {*found, EVENT_KIND} - {""} == set(EVENT_KINDS)


def test_sessions_and_events_are_read_by_programs(state: Path) -> None:
    listed = json.loads(run(state, "sessions", "list", "--json").stdout)
    assert [(one["session"], one["info"]["ended"]) for one in listed] == [(NAME, "orderly")]
    assert listed[0]["info"]["dropped"]["ticks"] == 3
    assert json.loads(run(state, "sessions", "show", NAME, "--json").stdout) == listed[0]
    verdict = json.loads(run(state, "sessions", "verify", NAME, "--json").stdout)[NAME]
    assert (verdict["whole"], verdict["rows"]["ticks"]) == (False, 1000)
    events = json.loads(run(state, "events", "--json").stdout)
    assert [(one["kind"], one["detail"]) for one in events] == [("trip", "over-voltage: 431 V")]
    assert events[0]["trip_kind"] == "over-voltage"


def test_the_events_name_the_remedy_of_a_trip(state: Path) -> None:
    first, second = run(state, "events", "--kind", "trip").stdout.splitlines()
    assert first.endswith("over-voltage: 431 V  [over-voltage]")
    assert "remedy" in second
    assert "wrong capacitance" in second
