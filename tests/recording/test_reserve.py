"""The reserve on a full disk belongs to the record of a trip and to the end of a session."""

from __future__ import annotations

import shutil
import threading
from pathlib import Path

from adaptdrive.recording import reserve
from adaptdrive.recording.batches import Header, News
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
