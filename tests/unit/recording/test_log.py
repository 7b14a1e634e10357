"""The log while a disk works, fails or hangs: who waits, what is bounded, and what is written."""

from __future__ import annotations

import asyncio
import errno
import os
import threading
import zlib
from pathlib import Path

import msgspec
import pytest

from adaptdrive.recording import log as log_module
from adaptdrive.recording.log import Log
from adaptdrive.recording.log_files import is_live, log_files, recall, records
from adaptdrive.recording.records import EventRow, Header, Kind, Pace
from adaptdrive.recording.session import Dropped
from tests.unit.recording.disk import Disk
from tests.unit.recording.material import INFO
from tests.virtual_time import held

PATIENCE_S = 5.0


class Bench:
    """A log and what it reports."""

    def __init__(self, folder: Path, backlog_bytes: int = 1 << 20, segment_s: float = 3600) -> None:
        self.folder = folder
        self.told: list[tuple[str, str]] = []
        self.segments: list[int] = []
        header = Header(INFO, "", segment_s=segment_s)
        self.now_s = 100.0
        self.log = Log(
            folder,
            header,
            recall(folder, INFO.started),
            lambda: (self.now_s, 1.7e9),
            Pace(backlog_bytes=backlog_bytes),
            on_problem=lambda *told: self.told.append(told),
            on_segment=self.segments.append,
        )
        self.log.start()
        self.log.let_rows_in()

    def event(self, number: int) -> None:
        row = EventRow(INFO.started, number, "mode", "info", f"number {number}", 1.0, number)
        self.log.append(Kind.EVENT, msgspec.msgpack.encode(row))

    def ticks(self, number: int, size: int = 100) -> None:
        self.log.append(Kind.TICKS, number.to_bytes(4, "little") * (size // 4), rows=30)

    async def problems(self) -> str:
        await asyncio.sleep(0)
        return "; ".join(why for _, why in self.told)

    def events(self) -> list[int]:
        found = records(log_files(self.folder))
        rows = [msgspec.msgpack.decode(one.payload) for one in found if one.kind is Kind.EVENT]
        return [row["number"] for row in rows]

    def written(self) -> list[int]:
        """Numbers of the batches of ticks."""
        found = records(log_files(self.folder))
        ticks = [zlib.decompress(one.payload) for one in found if one.kind is Kind.TICKS]
        return [int.from_bytes(payload[:4], "little") for payload in ticks]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "state" / "motor.log"


@pytest.fixture
def syncs(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Descriptors that were synced."""
    found: list[int] = []
    monkeypatch.setattr(os, "fdatasync", found.append)
    return found


async def test_whoever_waits_goes_on_when_the_disk_keeps_what_was_appended(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the threads of the log: a sync that hangs keeps nothing from being written."""
    answers = threading.Event()
    monkeypatch.setattr(os, "fdatasync", lambda _: answers.wait(PATIENCE_S))
    bench = Bench(folder)
    bench.event(1)
    waiting = asyncio.ensure_future(held(bench.log.kept)(PATIENCE_S))
    for _ in range(1000):  # a kill leaves it, if not a power cut
        if bench.events() == [1]:
            break
        answers.wait(0.005)
    await asyncio.sleep(0)
    assert bench.events() == [1]
    assert not waiting.done()
    answers.set()
    await waiting
    assert bench.log._notes_synced == 1
    assert await held(bench.log.close)(PATIENCE_S)


async def test_rows_are_never_synced(folder: Path, disk: Disk, syncs: list[int]) -> None:
    bench = Bench(folder)
    bench.ticks(0)
    assert len(syncs) == 1  # the beginning of the file
    for number in range(1, 20):
        bench.ticks(number)
    assert len(syncs) == 1
    assert len(bench.written()) == 20
    await bench.log.close(PATIENCE_S)


async def test_many_events_share_a_sync(folder: Path, disk: Disk, syncs: list[int]) -> None:
    with disk.stalled():
        bench = Bench(folder)
        for number in range(200):
            bench.event(number)
    await bench.log.kept(PATIENCE_S)
    assert len(syncs) == 1
    assert bench.events() == list(range(200))
    await bench.log.close(PATIENCE_S)


async def test_a_disk_that_hangs_is_waited_for_once(folder: Path, disk: Disk) -> None:
    now_s = asyncio.get_running_loop().time
    with disk.stalled():
        bench = Bench(folder)
        bench.event(1)
        for patience_s, waits_s in ((0.05, 0.05), (0.05, 0.0), (0.01, 0.0), (0.2, 0.2), (0.2, 0.0)):
            began_s = now_s()  # a command is worth more than an event
            await bench.log.kept(patience_s)
            assert now_s() - began_s == pytest.approx(waits_s)
    assert await bench.log.close(PATIENCE_S)


async def test_what_a_hanging_disk_leaves_waiting_is_bounded_and_the_oldest_ticks_go(
    folder: Path, disk: Disk
) -> None:
    with disk.stalled():
        bench = Bench(folder, backlog_bytes=10_000)
        for number in range(1000):
            bench.ticks(number)
            if number % 10 == 0:
                bench.event(number)
    assert bench.log.dropped == Dropped(ticks=30 * 900)
    assert await bench.log.close(PATIENCE_S)
    assert bench.events() == list(range(0, 1000, 10))
    assert bench.written() == list(range(900, 1000))


async def test_a_full_disk_takes_events_into_its_reserve_and_ticks_wait(
    folder: Path, disk: Disk
) -> None:
    bench = Bench(folder)
    bench.ticks(0)
    kept = folder / ".reserve"
    assert kept.exists()
    write = Log._write

    def refuse(log: Log, content: bytes) -> None:
        if kept.exists():
            raise OSError(errno.ENOSPC, "No space left on device")
        write(log, content)

    def no_room(_: Path) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Log, "_write", refuse)
        patch.setattr(log_module, "set_aside", no_room)
        bench.ticks(1)
        assert "No space left" in await bench.problems()
        assert bench.log.failing
        bench.event(1)
        assert bench.events() == [1]
        assert not kept.exists()
        bench.ticks(2)
        assert len(bench.written()) == 1
    bench.ticks(3)
    assert kept.exists()
    assert len(bench.written()) == 4
    assert await bench.log.close(PATIENCE_S)
    assert not bench.log.failing


@pytest.mark.parametrize("undone", [True, False])
async def test_a_write_that_is_cut_short_loses_and_repeats_nothing_whether_or_not_it_is_undone(
    folder: Path, disk: Disk, *, undone: bool
) -> None:
    bench = Bench(folder)
    bench.event(1)
    write = os.write

    def refuse(descriptor: int, content: bytes) -> int:
        if len(content) > 60:
            return write(descriptor, content[: len(content) // 2])
        raise OSError(errno.EIO, "Input/output error")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "write", refuse)
        if not undone:
            patch.setattr(os, "ftruncate", lambda *_: refuse(0, b""))
        bench.event(2)
        bench.event(3)
    assert "Input/output error" in await bench.problems()
    assert await bench.log.close(PATIENCE_S)
    assert bench.events() == [1, 2, 3]
    recalled = recall(folder, INFO.started)
    assert ([one.number for one in recalled.unsent], recalled.flaws) == ([1, 2, 3], ())


async def test_a_file_that_is_long_enough_is_followed_by_one_that_knows_what_it_left(
    folder: Path, disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(log_module, "_LARGEST_FILE_BYTES", 2000)
    bench = Bench(folder)
    for number in range(100):
        bench.event(number)
    assert await bench.log.close(PATIENCE_S)
    files = log_files(folder)
    assert len(files) > 3
    for file in files[:-1]:
        file.path.unlink()
    assert [one.number for one in recall(folder, INFO.started).unsent] == list(range(100))


async def test_a_segment_of_the_session_begins_in_a_file_of_its_own(
    folder: Path, disk: Disk
) -> None:
    bench = Bench(folder, segment_s=10.0)
    for number, passed_s in enumerate((9.9, 0.1, 10.0)):
        bench.event(number)
        bench.now_s += passed_s
    bench.event(3)
    assert await bench.log.close(PATIENCE_S)
    assert [file.part for file in log_files(folder)] == [1, 2, 3]
    await asyncio.sleep(0)
    assert bench.segments == [1, 2, 3]


async def test_a_log_is_live_while_its_daemon_is(folder: Path, disk: Disk) -> None:
    assert not is_live(folder)
    bench = Bench(folder)
    bench.event(1)
    assert is_live(folder)
    assert await bench.log.close(PATIENCE_S)
    assert not is_live(folder)
