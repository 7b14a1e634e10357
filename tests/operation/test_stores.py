"""What outlives a restart: replies and unsent events, with a sound disk and without."""

from __future__ import annotations

import asyncio
import contextlib
import os
import random
import shutil
import sqlite3
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from adaptdrive.operation.archive import Archive
from adaptdrive.operation.desk import INTERRUPTED, Desk
from adaptdrive.operation.journal import Journal
from adaptdrive.operation.memory import LIFETIME_S, ReplyMemory
from adaptdrive.operation.messages import LastTrip, Reply, encode
from adaptdrive.operation.outbox import Outbox
from adaptdrive.operation.pace import LogRation
from adaptdrive.operation.trip_memory import TripMemory
from adaptdrive.runtime.hub import Hub
from adaptdrive.runtime.reports import Severity, State
from adaptdrive.runtime.requests import Request

HOUR_S = 3600.0


@dataclass
class Time:
    """Two clocks that go together unless one is set."""

    wall: datetime = datetime(2026, 1, 1, tzinfo=UTC)
    running_s: float = 1000.0

    def pass_by(self, seconds: float) -> None:
        self.wall += timedelta(seconds=seconds)
        self.running_s += seconds


def wall() -> datetime:
    return datetime(2026, 1, 1, tzinfo=UTC)


def _reply(identity: str) -> Reply:
    return Reply(identity, "enable", accepted=True, reason="", state=State.RUNNING)


@asynccontextmanager
async def open_journal(path: Path) -> AsyncIterator[Journal]:
    journal = Journal(path)
    await journal.open()
    yield journal
    await journal.close(20.0)


@asynccontextmanager
async def remembering(path: Path, time: Time, limit: int = 1000) -> AsyncIterator[ReplyMemory]:
    async with open_journal(path) as journal:
        memory = ReplyMemory(journal, lambda: time.wall, lambda: time.running_s, limit)
        await memory.load()
        memory.begin()
        yield memory


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "below" / "drive.sqlite3"


async def test_the_last_replies_are_remembered_across_restarts(path: Path) -> None:
    for start in (0, 6):
        async with remembering(path, Time(), limit=10) as memory:
            for number in range(start, start + 6):
                await memory.keep(f"id-{number}", _reply(f"id-{number}"))
    async with remembering(path, Time(), limit=10) as memory:
        known = [number for number in range(12) if memory.recall(f"id-{number}")]
    assert known == list(range(2, 12))


async def test_what_was_asked_is_remembered_across_restarts_and_a_disk_that_failed(
    path: Path,
) -> None:
    async with remembering(path, Time()) as memory:
        await memory.keep("a", _reply("a"), "3.0")
    async with remembering(path, Time()) as memory:
        assert memory.asked("a") == "3.0"
        memory.rewrite()
    async with remembering(path, Time()) as memory:
        assert (memory.recall("a"), memory.asked("a")) == (_reply("a"), "3.0")


async def test_a_reply_that_an_older_version_wrote_is_remembered(path: Path) -> None:
    async with open_journal(path) as journal:
        row = "a", wall().timestamp(), encode(_reply("a"))
        journal.post("INSERT INTO reply VALUES (?, ?, ?)", row)
    async with remembering(path, Time()) as memory:
        assert (memory.recall("a"), memory.asked("a")) == (_reply("a"), None)


@pytest.mark.parametrize(("idle_s", "known"), [(LIFETIME_S - 1.0, True), (LIFETIME_S + 1.0, False)])
@pytest.mark.parametrize("restart", [False, True])
async def test_a_reply_is_remembered_for_a_day(
    path: Path, idle_s: float, *, known: bool, restart: bool
) -> None:
    time = Time()
    async with remembering(path, time) as memory:
        await memory.keep("a", _reply("a"))
        if not restart:
            time.pass_by(idle_s)
            assert (memory.recall("a") is not None) is known
    if restart:
        time.pass_by(idle_s)
        async with remembering(path, time) as memory:
            assert (memory.recall("a") is not None) is known


async def test_setting_the_clock_makes_nobody_forget(path: Path) -> None:
    time = Time(wall=datetime(1970, 1, 1, tzinfo=UTC))
    async with remembering(path, time) as memory:
        await memory.keep("a", _reply("a"))
        time.wall = datetime(2026, 1, 1, tzinfo=UTC)
        assert memory.recall("a") == _reply("a")


async def test_a_reply_from_before_the_clock_was_set_outlives_an_orderly_end(path: Path) -> None:
    time = Time(wall=datetime(1970, 1, 1, tzinfo=UTC))
    archive, recalled = (
        Archive(Journal(path), lambda: time.wall, lambda: time.running_s),
        asyncio.Event(),
    )
    keeping = asyncio.create_task(archive.run(lambda *_: None, recalled.set))
    await recalled.wait()
    await archive.replies.keep("a", _reply("a"))
    time.wall = datetime(2026, 1, 1, tzinfo=UTC)
    keeping.cancel()
    await asyncio.wait([keeping])
    await archive.close()
    async with remembering(path, time) as memory:
        assert memory.recall("a") == _reply("a")


async def test_a_reply_from_before_the_clock_was_set_outlives_a_kill(path: Path) -> None:
    time = Time(wall=datetime(1970, 1, 1, tzinfo=UTC))
    async with remembering(path, time) as memory:
        await memory.keep("a", _reply("a"))
        time.wall = datetime(2026, 1, 1, tzinfo=UTC)
        memory.follow_clock()
        await memory.written()
        left = Path(shutil.copytree(path.parent, path.parent.with_name("left"))) / path.name
    time.pass_by(LIFETIME_S - 1.0)
    async with remembering(left, time) as memory:
        assert memory.recall("a") == _reply("a")
    time.pass_by(2.0)
    async with remembering(left, time) as memory:
        assert memory.recall("a") is None


async def test_events_leave_in_order_and_only_when_acknowledged(path: Path) -> None:
    async with open_journal(path) as journal:
        outbox = Outbox(journal, wall)
        for number in range(3):
            outbox.append(b"%d" % number)
        sequence, body = await outbox.oldest()
        assert body == b"0"
        outbox.sent(sequence)
    async with open_journal(path) as journal:
        outbox = Outbox(journal, wall)
        await outbox.load()
        outbox.append(b"3")
        left = []
        while len(outbox):
            sequence, body = await outbox.oldest()
            outbox.sent(sequence)
            left.append(body)
    assert left == [b"1", b"2", b"3"]


async def test_a_full_outbox_drops_the_oldest_on_disk_too(path: Path) -> None:
    async with open_journal(path) as journal:
        outbox = Outbox(journal, wall, limit=5)
        for number in range(12):
            outbox.append(b"%d" % number)
            if number == 0:
                first, _ = await outbox.oldest()
        assert outbox.dropped == 7
        outbox.sent(first)  # acknowledged after it was dropped
    rows = sqlite3.connect(path).execute("SELECT body FROM event ORDER BY sequence").fetchall()
    assert [body for (body,) in rows] == [b"7", b"8", b"9", b"10", b"11"]


def _garbage(path: Path) -> None:
    path.parent.mkdir()
    path.write_bytes(b"this is no database" * 100)


def _folder(path: Path) -> None:
    (path / "in the way").mkdir(parents=True)


def _no_folder(path: Path) -> None:
    path.parent.write_text("a file where a folder should be")


@pytest.mark.parametrize("damage", [_garbage, _folder, _no_folder])
async def test_a_damaged_disk_stops_nobody(path: Path, damage: Callable[[Path], None]) -> None:
    damage(path)
    async with remembering(path, Time()) as memory:
        await memory.keep("a", _reply("a"))
        assert memory.recall("a") == _reply("a")


async def test_a_damaged_file_is_put_aside_and_replaced(path: Path) -> None:
    _garbage(path)
    async with remembering(path, Time()) as memory:
        await memory.keep("a", _reply("a"))
    async with remembering(path, Time()) as memory:
        assert memory.recall("a") == _reply("a")
    assert path.with_name(path.name + ".damaged").exists()


async def test_a_damaged_file_is_told_as_an_event(path: Path) -> None:
    _garbage(path)
    told: list[tuple[str, Severity, str]] = []
    archive = Archive(Journal(path), wall, lambda: 0.0)
    recalled = asyncio.Event()
    keeping = asyncio.create_task(archive.run(lambda *event: told.append(event), recalled.set))
    await recalled.wait()
    keeping.cancel()
    await asyncio.wait([keeping])
    await archive.close()
    ((kind, severity, detail),) = told
    assert (kind, severity) == ("journal", Severity.WARNING)
    assert f"{path.name}.damaged" in detail


async def test_a_file_that_opens_and_takes_nothing_is_told_once(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("adaptdrive.operation.archive.JOURNAL_RETRY_S", 0.02)
    async with open_journal(path):
        pass
    with contextlib.closing(sqlite3.connect(path)) as database:
        database.execute(
            "CREATE TRIGGER full BEFORE INSERT ON reply BEGIN SELECT RAISE(ABORT, 'full'); END"
        )
    reported: list[str] = []
    archive = Archive(Journal(path), wall, lambda: 0.0)
    keeping = asyncio.create_task(
        archive.run(lambda *event: reported.append(event[2]), lambda: None)
    )
    await archive.replies.ready()
    with capture_logs() as lines:
        await archive.replies.keep("a", _reply("a"))
        while sum(line["event"] == "operating without a journal" for line in lines) < 4:  # noqa: ASYNC110 - of a thread
            await asyncio.sleep(0.01)
    keeping.cancel()
    await asyncio.wait([keeping])
    await archive.close()
    (detail,) = reported
    assert "full" in detail


def _spoil_second_page(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[4096 : 4096 + 2048] = random.Random(1).randbytes(2048)
    path.write_bytes(content)


def _fifo(path: Path) -> None:
    path.parent.mkdir()
    os.mkfifo(path)


async def test_a_damaged_file_keeps_its_wal_beside_it(path: Path) -> None:
    _garbage(path)
    for suffix in ("-wal", "-shm"):
        path.with_name(path.name + suffix).write_bytes(b"what was not merged yet")
    async with open_journal(path):
        pass
    for suffix in ("", "-wal", "-shm"):
        assert path.with_name(f"{path.name}.damaged{suffix}").exists()


async def test_damage_below_a_sound_header_is_noticed(path: Path) -> None:
    async with remembering(path, Time()) as memory:
        for number in range(200):
            memory.note(f"id-{number}", _reply(f"id-{number}"))
    _spoil_second_page(path)
    async with remembering(path, Time()) as memory:
        await memory.keep("a", _reply("a"))
    async with remembering(path, Time()) as memory:
        assert memory.recall("a") == _reply("a")
    assert path.with_name(path.name + ".damaged").exists()


def _spoil_schema(path: Path) -> None:
    """Damage a word which SQLite quotes in a message that Python then cannot decode."""
    content = path.read_bytes()
    assert b"TABLE event" in content
    path.write_bytes(content.replace(b"TABLE event", b"TABL\xad event"))


async def test_damage_that_makes_an_error_no_text_is_damage(path: Path) -> None:
    async with remembering(path, Time()) as memory:
        await memory.keep("b", _reply("b"))
    _spoil_schema(path)
    async with remembering(path, Time()) as memory:
        await memory.keep("a", _reply("a"))
    async with remembering(path, Time()) as memory:
        assert memory.recall("a") == _reply("a")
    assert path.with_name(path.name + ".damaged").exists()


async def test_a_file_that_is_in_use_is_kept_and_tried_again(path: Path) -> None:
    async with remembering(path, Time()) as memory:
        await memory.keep("a", _reply("a"))
    holder = sqlite3.connect(path, isolation_level=None)
    holder.execute("PRAGMA locking_mode = EXCLUSIVE")
    holder.execute("BEGIN EXCLUSIVE")
    journal = Journal(path)
    assert not await journal.open()
    assert "locked" in journal.problem
    holder.close()
    assert await journal.open()
    assert journal.problem == ""
    assert len(await journal.rows("SELECT id FROM reply")) == 1
    await journal.close(20.0)
    assert not path.with_name(path.name + ".damaged").exists()


@pytest.mark.parametrize("obstacle", [_fifo, _folder, _no_folder])
async def test_what_is_in_the_way_is_named_and_tried_again(
    path: Path, obstacle: Callable[[Path], None]
) -> None:
    obstacle(path)
    journal = Journal(path)
    with capture_logs() as lines:
        for _ in range(3):
            async with asyncio.timeout(20.0):
                assert not await journal.open()
            journal.post("DELETE FROM event")
    assert journal.problem
    assert len(lines) == 1
    await journal.close(20.0)


async def test_a_failing_disk_is_logged_once_and_then_caught_up(path: Path) -> None:
    async with remembering(path, Time()) as memory:
        await memory.keep("before", _reply("before"))
        journal = memory._journal
        with capture_logs() as lines:
            journal.post("INSERT INTO nowhere VALUES (1)")
            for number in range(50):
                await memory.keep(f"id-{number}", _reply(f"id-{number}"))
        assert [line["event"] for line in lines] == ["operating without a journal"]
        assert await journal.open()
        memory.rewrite()
    async with remembering(path, Time()) as memory:
        assert memory.recall("before") is not None
        assert memory.recall("id-49") is not None


async def test_a_state_folder_deleted_during_the_run_is_named_and_made_anew(path: Path) -> None:
    async with remembering(path, Time()) as memory:
        await memory.keep("a", _reply("a"))
        journal = memory._journal
        assert not await journal.open()
        assert journal.problem == ""
        shutil.rmtree(path.parent)
        assert not await journal.open()
        assert "deleted" in journal.problem
        assert await journal.open()
        assert journal.problem == ""
        memory.rewrite()
    async with remembering(path, Time()) as memory:
        assert memory.recall("a") == _reply("a")


async def test_rows_that_cannot_be_read_cost_only_themselves(path: Path) -> None:
    async with remembering(path, Time()) as memory:
        await memory.keep("sound", _reply("sound"))
    with contextlib.closing(sqlite3.connect(path, isolation_level=None)) as database:
        for row in (
            ("torn", 0.0, b'{"id": "torn", "ver'),
            ("empty", None, None),
            (b"\xff\xfe", "yesterday", b"{}"),
            ("text", 1e308, "not json \ud7ff"),
        ):
            database.execute("INSERT INTO reply VALUES (?, ?, ?)", row)
        database.execute("INSERT INTO event VALUES (1, NULL)")
        database.execute("INSERT INTO event VALUES (2, ?)", (b"sound",))
    async with open_journal(path) as journal:
        memory = ReplyMemory(journal, wall, lambda: 0.0)
        assert await memory.load() == 4
        assert memory.recall("sound") == _reply("sound")
        unreadable = memory.recall("empty")
        assert unreadable is not None
        assert not unreadable.accepted
        outbox = Outbox(journal, wall)
        assert await outbox.load() == 1
        assert (await outbox.oldest())[1] == b"sound"


@pytest.mark.parametrize("sequence", [None, "first", 1.5, 2**63 - 1])
async def test_an_event_without_a_usable_number_costs_only_itself(
    path: Path, sequence: object
) -> None:
    """The table of a damaged file need not be the one that was made."""
    async with open_journal(path):
        pass
    with contextlib.closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("DROP TABLE event")
        database.execute("CREATE TABLE event (sequence, body)")
        for row in ((sequence, b"odd"), (1, b"sound")):
            database.execute("INSERT INTO event VALUES (?, ?)", row)
    async with open_journal(path) as journal:
        outbox = Outbox(journal, wall)
        assert await outbox.load() == 1
        outbox.append(b"new")
        kept = [await outbox.oldest()]
        outbox.sent(kept[0][0])
        kept.append(await outbox.oldest())
        assert [body for _, body in kept] == [b"sound", b"new"]
        assert await journal.written(20.0)
        assert journal.problem == ""


async def test_events_from_before_a_late_disk_are_kept(path: Path) -> None:
    async with open_journal(path) as journal:
        Outbox(journal, wall).append(b"first run")
    journal = Journal(path)
    outbox = Outbox(journal, lambda: wall() + timedelta(seconds=1))
    outbox.append(b"before the disk")
    await journal.open()
    await outbox.load()
    outbox.rewrite()
    await journal.close(20.0)
    rows = sqlite3.connect(path).execute("SELECT body FROM event ORDER BY sequence").fetchall()
    assert [body for (body,) in rows] == [b"first run", b"before the disk"]


class DyingHost:
    """Dies while it carries out a command."""

    async def execute(self, request: Request) -> State:
        raise SystemError("power failure")

    def stop(self) -> State:
        return State.STANDBY

    def trip(self, cause: str) -> None:
        raise AssertionError(cause)


def dying_desk(memory: ReplyMemory, time: Time) -> Desk:
    hub, ration = Hub(), LogRation(lambda: time.running_s)
    return Desk(DyingHost(), memory, lambda: None, lambda: time.wall, ration,
                report=hub.publish, kept=hub.kept, shutting_down=lambda: False)  # fmt: skip


async def test_a_command_cut_short_by_a_crash_does_not_act_a_second_time(path: Path) -> None:
    time = Time()
    async with remembering(path, time) as memory:
        desk = dying_desk(memory, time)
        with pytest.raises(SystemError):
            await desk.answer(desk.receive("enable", b'{"id": "a"}', retained=False))
    async with remembering(path, time) as memory:
        desk = dying_desk(memory, time)
        reply = await desk.answer(desk.receive("enable", b'{"id": "a"}', retained=False))
    assert reply is not None
    assert not reply.accepted
    assert reply.reason == INTERRUPTED


async def test_an_unreadable_trip_is_counted_and_the_next_one_kept(path: Path) -> None:
    trip = LastTrip(wall(), "over-voltage: v_bst = 431.2 V, limit 430 V", "")
    async with open_journal(path) as journal:
        journal.post("INSERT INTO trip VALUES (1, ?)", (b'{"text": 5}',))
        memory = TripMemory(journal)
        assert await memory.load() == 1
        assert memory.last is None
        memory.note(trip)
    async with open_journal(path) as journal:
        memory = TripMemory(journal)
        assert await memory.load() == 0
        assert memory.last is not None
        assert (memory.last.time, memory.last.text) == (trip.time, trip.text)
        assert "wrong capacitance" in memory.last.remedy


async def test_a_trip_of_this_run_is_not_replaced_by_an_older_one(path: Path) -> None:
    newest = LastTrip(wall(), "stale: measurement is 54 ms old, limit 50 ms", "")
    async with open_journal(path) as journal:
        TripMemory(journal).note(LastTrip(wall(), "over-voltage", ""))
    async with open_journal(path) as journal:
        memory = TripMemory(journal)
        memory.note(newest)
        await memory.load()
        memory.rewrite()
        assert memory.last == newest
    async with open_journal(path) as journal:
        memory = TripMemory(journal)
        await memory.load()
        assert memory.last is not None
        assert memory.last.text == newest.text
