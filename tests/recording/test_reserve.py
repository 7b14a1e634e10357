"""The reserve on a full disk belongs to the record of a trip and to the end of a session."""

from __future__ import annotations

import os
import shutil
import threading
from pathlib import Path

from adaptdrive.recording import reserve
from adaptdrive.recording.batches import Header, News
from adaptdrive.recording.reader import read_session
from adaptdrive.recording.session import session_directories
from adaptdrive.recording.writer import PatientWriter
from tests.recording.material import INFO, fill, make_batch, make_tick, wait_until

PATIENCE_S = 60.0


def test_a_recorder_leaves_the_released_reserve_to_the_record_of_a_trip(small_disk: Path) -> None:
    sessions = small_disk / "sessions"
    news: list[News] = []
    writer = PatientWriter(Header(INFO, "", str(sessions)), news.append, pause_s=0.01)
    writer.write(make_batch([make_tick(0)]))
    fill(small_disk)
    rows = make_batch([make_tick(number) for number in range(1, 1000)])
    waiting = threading.Thread(target=writer.write, args=(rows,))
    waiting.start()
    wait_until(lambda: any(one.failing for one in news))
    reserve.release(sessions)
    released_bytes = shutil.disk_usage(small_disk).free
    waiting.join(1.0)  # tries several times meanwhile
    assert waiting.is_alive()
    assert shutil.disk_usage(small_disk).free == released_bytes
    (small_disk / "fill").unlink()
    waiting.join(PATIENCE_S)
    assert not waiting.is_alive()


def test_a_fifo_in_place_of_the_reserve_is_reported_and_waited_for(tmp_path: Path) -> None:
    news: list[News] = []
    writer = PatientWriter(Header(INFO, "", str(tmp_path)), news.append, pause_s=0.01)
    fifo = tmp_path / ".reserve"
    os.mkfifo(fifo)
    waiting = threading.Thread(target=writer.write, args=(make_batch([make_tick(0)]),), daemon=True)
    waiting.start()
    wait_until(lambda: any(one.failing for one in news))
    assert f"it is a FIFO, not a file: '{fifo}'" in news[0].detail
    fifo.unlink()
    waiting.join(PATIENCE_S)
    assert not waiting.is_alive()
    assert read_session(next(session_directories(tmp_path))).ticks.num_rows == 1


def test_each_new_cause_of_a_failure_is_reported(tmp_path: Path) -> None:
    news: list[News] = []
    sessions = tmp_path / "sessions"
    writer = PatientWriter(Header(INFO, "", str(sessions)), news.append, pause_s=0.01)
    sessions.touch()
    waiting = threading.Thread(target=writer.write, args=(make_batch([make_tick(0)]),), daemon=True)
    waiting.start()
    wait_until(lambda: any("File exists" in one.detail for one in news))
    (sessions.with_name("other")).mkdir()
    (sessions.with_name("other") / ".reserve").mkdir()
    sessions.unlink()
    sessions.with_name("other").rename(sessions)
    wait_until(lambda: any(".reserve" in one.detail for one in news))
    assert sum("File exists" in one.detail for one in news) == 1
    (sessions / ".reserve").rmdir()
    waiting.join(PATIENCE_S)
    assert not waiting.is_alive()
