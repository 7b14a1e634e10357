"""A stand-in for the control process: records ticks at 1 kHz until it is killed.

Run as `python control_process.py SESSIONS`; prints the session's directory.
"""

import asyncio
import sys
from datetime import UTC, datetime
from itertools import count
from pathlib import Path

from adaptdrive.recording.recorder import Feed, Pace, Recorder
from adaptdrive.recording.session import create_session
from adaptdrive.runtime.hub import Hub
from tests.recording.material import INFO, make_tick


async def publish(hub: Hub) -> None:
    for sequence in count():
        hub.publish(make_tick(sequence))
        await asyncio.sleep(0.001)


async def main(sessions: Path) -> None:
    hub = Hub()
    session = create_session(sessions, INFO, "")
    feed = Feed.of(hub, flush_s=0.1)
    recorder = Recorder(session, feed, hub.publish, lambda: datetime.now(UTC), Pace(flush_s=0.1))
    print(session.directory, flush=True)  # noqa: T201
    async with asyncio.TaskGroup() as group:
        group.create_task(recorder.run())
        group.create_task(publish(hub))


asyncio.run(main(Path(sys.argv[1])))
