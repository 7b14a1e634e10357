"""From the log to the folders of sessions: the same result however often it runs."""

from __future__ import annotations

import fcntl
import hashlib
import shutil
from pathlib import Path

import msgspec
import pytest

from adaptdrive.recording.log_files import log_files
from adaptdrive.recording.reader import Session, read_session, verify
from adaptdrive.recording.records import EventRow, Header
from adaptdrive.recording.session import (
    Ending,
    create_session,
    read_info,
    session_directories,
)
from adaptdrive.safety.trips import ADVICES, TripKind, remedy
from adaptdrive.util.errors import RecordingError
from tests.unit.recording.material import (
    INFO,
    Batch,
    archive_all,
    make_batch,
    make_tick,
    write_log,
)

LATER = INFO.started.replace(year=2027)


def event(number: int, kind: str = "mode", monotonic_s: float = 50.0) -> EventRow:
    return EventRow(INFO.started, number, kind, "info", f"number {number}", monotonic_s, number)


class Place:
    """A state directory with a log and sessions."""

    def __init__(self, folder: Path) -> None:
        self.log = folder / "motor.log"
        self.sessions = folder / "sessions"

    def header(self, **facts: object) -> Header:
        info = msgspec.structs.replace(INFO, log="../motor.log", **facts)
        return Header(info, "# as configured\n", sessions="sessions")

    def write(self, first: int, count: int = 10, part: int = 1, *, last: bool = False) -> Path:
        """A file of the log with ticks and an event."""
        batch = make_batch([make_tick(number) for number in range(first, first + count)], last=last)
        batch = msgspec.structs.replace(batch, events=[event(first + 1)])
        return write_log(self.log, self.header(), batch, part=part).path

    def add(self, batch: Batch, part: int = 1, **facts: object) -> Path:
        return write_log(self.log, self.header(**facts), batch, part=part).path

    def next_start(self) -> list[str]:
        """Another daemon starts; what its archiver reports."""
        self.add(make_batch([]), started=LATER)
        return archive_all(self.log)

    @property
    def session(self) -> Session:
        return read_session(next(session_directories(self.sessions)))

    def begin(self) -> Path:
        header = self.header()
        return create_session(self.sessions, header.info, header.config_text)


@pytest.fixture
def place(tmp_path: Path) -> Place:
    return Place(tmp_path)


def sequences(session: Session) -> list[int]:
    return [int(number) for number in session.ticks["sequence"].to_pylist()]


def fingerprint(folder: Path) -> dict[str, str]:
    """Contents of all files but the database, whose header counts its changes."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_a_session_is_the_same_however_often_it_is_archived(place: Place) -> None:
    place.begin()
    for part in (1, 2, 3):
        place.write(10 * (part - 1), part=part, last=part == 3)
    before = {path.name: path.read_bytes() for path in place.log.iterdir()}
    assert archive_all(place.log) == []
    session, first = place.session, fingerprint(place.sessions)
    assert sequences(session) == list(range(30))
    assert [one.number for one in session.events] == [1, 11, 21]
    assert session.info.ended is Ending.ORDERLY
    assert verify(session).whole
    for name, content in before.items():  # as where it was killed before it removed them
        (place.log / name).write_bytes(content)
    assert archive_all(place.log) == []
    assert fingerprint(place.sessions) == first
    assert place.session.events == session.events


def test_what_is_in_the_log_only_is_read_from_there(place: Place) -> None:
    directory = place.begin()
    for part in (1, 2):
        place.write(10 * (part - 1), part=part)
    session = place.session
    assert sequences(session) == list(range(20))
    assert [one.number for one in session.events] == [1, 11]
    assert session.info.ended is Ending.OPEN
    assert list(directory.glob("*.parquet")) == []
    assert verify(session).whole


def test_a_killed_session_is_closed_and_reported_once(place: Place) -> None:
    directory = place.begin()
    place.write(0)
    (told,) = place.next_start()
    assert told.startswith(f"session {directory.name} ended without its close")
    assert "1970-01-01T00:00:50.075000Z" in told  # 50 s and 9 ticks after the start of the clock
    assert place.session.info.ended is Ending.CUT
    assert place.next_start() == []


@pytest.mark.parametrize("tail", [b"\x00" * 4096, b"\x05", b"aDl\x01\x08\x00\x00\x00\xc1\xc1"])
def test_a_file_that_breaks_off_gives_its_whole_records_and_the_loss_has_its_place(
    place: Place, tail: bytes
) -> None:
    place.begin()
    path = place.write(0)
    size = path.stat().st_size
    path.write_bytes(path.read_bytes() + tail)
    told = place.next_start()
    loss = f"{path.name}: bytes {size} to {size + len(tail)} cannot be read"
    assert any(loss in sentence for sentence in told)
    assert sequences(place.session) == list(range(10))
    assert verify(place.session).problems == (loss,)


def test_a_file_of_the_log_that_cannot_be_read_is_kept_and_named(place: Place) -> None:
    place.begin()
    place.write(0)
    foreign = place.log / "00000009-20250101T000000000000Z-0001.log"
    foreign.write_bytes(b"no log")
    told = place.next_start()
    kept = foreign.with_name(f"damaged-{foreign.name}")
    assert kept.read_bytes() == b"no log"
    assert any(str(kept) in sentence for sentence in told)
    assert sequences(place.session) == list(range(10))
    assert not any(str(kept) in sentence for sentence in place.next_start())


def test_a_session_that_cannot_be_written_keeps_no_other_from_it(place: Place) -> None:
    first = place.begin()
    place.write(0, last=True)
    second = place.header(started=LATER)
    create_session(place.sessions, second.info, "")
    place.add(make_batch([make_tick(0)], last=True), started=LATER)
    (first / "ticks-0001.parquet").mkdir()
    with pytest.raises(RecordingError, match="stays in the log"):
        archive_all(place.log)
    endings = [read_info(path).ended for path in session_directories(place.sessions)]
    assert endings == [Ending.OPEN, Ending.ORDERLY]
    (first / "ticks-0001.parquet").rmdir()
    archive_all(place.log)
    assert sequences(read_session(first)) == list(range(10))


def test_a_session_that_was_removed_is_made_again_from_the_log(place: Place) -> None:
    shutil.rmtree(place.begin())
    place.write(0, last=True)
    archive_all(place.log)
    assert sequences(place.session) == list(range(10))
    assert place.session.config_text == "# as configured\n"


def test_a_session_that_never_began_is_not_made(place: Place) -> None:
    batch = msgspec.structs.replace(make_batch([], last=True), events=[event(1)])
    place.add(batch)
    assert place.next_start() == []
    assert not place.sessions.exists()


def test_a_state_directory_that_was_moved_takes_the_rest_of_its_session(tmp_path: Path) -> None:
    old, new = tmp_path / "old", tmp_path / "new"
    old.mkdir()
    place = Place(old)
    place.begin()
    place.write(0)
    old.rename(new)
    assert sequences(Place(new).session) == list(range(10))
    Place(new).next_start()
    assert sequences(Place(new).session) == list(range(10))
    assert not old.exists()


@pytest.mark.parametrize("copied", ["{}-copy", "backup"])
def test_a_copy_of_a_session_does_not_get_the_rest_of_it(copied: str, place: Place) -> None:
    directory = place.begin()
    shutil.copytree(directory, place.sessions / copied.format(directory.name))
    place.write(0)
    place.next_start()
    assert sequences(read_session(directory)) == list(range(10))


def test_the_file_that_knows_what_the_others_left_is_never_removed(place: Place) -> None:
    place.begin()
    first = place.write(0, last=True)
    archive_all(place.log)
    assert first.exists()
    place.next_start()
    assert not first.exists()
    assert len(log_files(place.log)) == 1


def test_a_segment_that_ends_while_the_archiver_runs_stays_in_the_log(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    place.begin()
    first = place.write(0)
    with first.open("rb") as held, monkeypatch.context() as daemon:
        fcntl.flock(held, fcntl.LOCK_EX)  # as its daemon does
        daemon.setattr(
            "adaptdrive.recording.segments.prune", lambda *_: [str(place.write(10, part=2))]
        )
        archive_all(place.log)
    assert sequences(place.session) == list(range(20))


# -- records of trips --------------------------------------------------------------------------


def trip_in(place: Place, trip_s: float = 100.0, ticks: int = 12_000, part: int = 1) -> None:
    batch = make_batch([make_tick(number) for number in range(ticks)])
    trip = event(1, "trip", trip_s)
    place.add(msgspec.structs.replace(batch, events=[trip]), part=part)


def trips_of(place: Place) -> list[Path]:
    return sorted(place.sessions.glob("*/trip-*"))


def test_the_record_of_a_trip_has_a_minute_before_it_and_ten_seconds_after(place: Place) -> None:
    place.begin()
    trip_in(place, trip_s=120.0)
    place.next_start()
    (trip,) = trips_of(place)
    times_s = read_session(trip).ticks["monotonic_s"].to_pylist()
    assert (times_s[0], times_s[-1]) == pytest.approx((60.0, 130.0), abs=1 / 120)
    assert len(times_s) == pytest.approx(70 * 120, abs=1)
    assert read_info(trip).first_sequence == 1200
    assert verify(read_session(trip)).whole
    assert (trip / "trip.txt").read_text().startswith("number 1\n")


def test_the_record_of_a_trip_names_its_kind_its_remedy_and_a_page(place: Place) -> None:
    place.begin()
    trip = msgspec.structs.replace(event(1, "trip", 100.0), trip_kind="over-voltage")
    batch = make_batch([make_tick(number) for number in range(10)])
    place.add(msgspec.structs.replace(batch, events=[trip]))
    place.next_start()
    (record,) = trips_of(place)
    lines = (record / "trip.txt").read_text(encoding="utf-8").splitlines()
    advice = ADVICES[TripKind.OVER_VOLTAGE]
    assert "kind: over-voltage" in lines
    assert f"remedy: {remedy(TripKind.OVER_VOLTAGE)}" in lines
    assert f"page: {advice.page}" in lines


def test_a_trip_whose_time_is_in_two_segments_has_one_record(place: Place) -> None:
    place.begin()
    place.write(0, 6000)
    later = make_batch([make_tick(number) for number in range(6000, 12_000)], last=True)
    trip = msgspec.structs.replace(later, events=[event(2, "trip", 105.0)])
    place.add(trip, part=2)
    archive_all(place.log)
    (record,) = trips_of(place)
    times_s = read_session(record).ticks["monotonic_s"].to_pylist()
    assert (times_s[0], times_s[-1]) == pytest.approx((50.0, 115.0), abs=1 / 120)
    assert archive_all(place.log) == []
    assert trips_of(place) == [record]
