"""A log for the operators' side, as the daemon opens it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import msgspec

from adaptdrive.app.run import operator_log
from adaptdrive.mqtt.desk import ReplyMemory
from adaptdrive.mqtt.service import OperatorLog
from adaptdrive.recording.log import Log
from adaptdrive.recording.log_files import Recalled, recall
from adaptdrive.recording.recorder import Recorder
from adaptdrive.recording.records import Header, Kind, Pace
from adaptdrive.runtime.reports import Hub
from tests.unit.recording.material import INFO

PATIENCE_S = 60.0


@dataclass
class Time:
    """Two clocks that go together unless one is set."""

    wall: datetime = datetime(2026, 1, 1, tzinfo=UTC)
    running_s: float = 1000.0

    def pass_by(self, seconds: float) -> None:
        self.wall += timedelta(seconds=seconds)
        self.running_s += seconds

    def both(self) -> tuple[float, float]:
        return self.running_s, self.wall.timestamp()


@asynccontextmanager
async def open_log(folder: Path, clocks: Time | None = None) -> AsyncIterator[tuple[Log, Recalled]]:
    """A log, and what it held before."""
    clocks = clocks or Time()
    recalled = recall(folder, clocks.wall)
    header, pace = Header(INFO, ""), Pace()
    log = Log(folder, header, recalled, clocks.both, pace, on_problem=lambda *_: None)
    log.start()
    yield log, recalled
    await log.close(PATIENCE_S)


def memory_of(log: Log, recalled: Recalled, clocks: Time, limit: int = 1000) -> ReplyMemory:
    """The memory of replies that a log keeps."""

    def post(identity: str, body: bytes) -> None:
        log.append(Kind.REPLY, msgspec.msgpack.encode((identity, body)))

    return ReplyMemory(recalled.replies, post, lambda: clocks.running_s, limit)


@asynccontextmanager
async def remembering(folder: Path, clocks: Time, limit: int = 1000) -> AsyncIterator[ReplyMemory]:
    """The memory of replies in a log."""
    async with open_log(folder, clocks) as (log, recalled):
        yield memory_of(log, recalled, clocks, limit)


@asynccontextmanager
async def keeping(folder: Path, hub: Hub) -> AsyncIterator[OperatorLog]:
    """The log of a daemon that records no session."""
    recalled, loop = recall(folder, datetime.now(UTC)), asyncio.get_running_loop()
    recorder = Recorder(
        folder,
        None,
        Header(INFO, ""),
        hub,
        lambda: (loop.time(), datetime.now(UTC).timestamp()),
        recalled=recalled,
    )
    hub.kept = recorder.kept
    running = asyncio.create_task(recorder.run())
    try:
        yield operator_log(recalled, recorder)
    finally:
        running.cancel()
        await asyncio.wait([running])
